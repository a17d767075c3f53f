"""A plain image network over the cameras, without geometry: the baseline's view (Section IV)."""

from __future__ import annotations

from pydantic import Field, PositiveInt
from torch import Tensor, nn

from me3bev_cli.api import Calibration, Rig, SpatialOutput, TokenSpec
from me3bev_plugins.spatial.precision import ComputeConfig, arrange, computing, laid_out
from me3bev_plugins.spatial.trunks import Trunk, check_trunk


class FlatCNN(nn.Module):
    """One trunk shared by the cameras; each image's features are averaged, joined and led to one token."""

    class Config(ComputeConfig):
        """Settings of the flat network."""

        trunk: str = Field(
            default="shufflenet_v2_x1_0", description="`tiny`, a torchvision model, or `timm:` and a model of timm"
        )
        pretrained: bool | str = Field(
            default=False, description="published weights (true) or a file of weights for the trunk"
        )
        width: PositiveInt = Field(default=256, description="numbers of the token")

    def __init__(self, config: Config, rig: Rig) -> None:
        super().__init__()
        self.output_spec(config, rig)
        self.config = config
        self.cameras = len(rig.cameras)
        self.trunk = Trunk(config.trunk, pretrained=config.pretrained)
        self.linear = nn.Linear(self.cameras * self.trunk.channels, config.width)
        arrange(self, config.channels_last)

    @classmethod
    def output_spec(cls, config: Config, rig: Rig) -> TokenSpec:
        """One token of the configured width.

        Raises:
            ValueError: when the cameras' images differ in size or the trunk does not exist.
        """
        if len({(camera.height, camera.width) for camera in rig.cameras}) > 1:
            raise ValueError("the cameras' images must all have one size")
        check_trunk(config.trunk)
        return TokenSpec(1, 1, config.width)

    def forward(self, images: Tensor, calibration: Calibration | None = None) -> SpatialOutput:
        """Images (N, C, 3, H, W), ImageNet-normalised -> one token (N, 1, width), whatever the calibration."""
        flat = laid_out(images.flatten(0, 1), self.config.channels_last)
        with computing(self.config.precision, images.device):
            features = self.trunk(flat).mean((2, 3))
            token = self.linear(features.view(len(images), -1)).unsqueeze(1)
        return SpatialOutput(token.to(images.dtype))
