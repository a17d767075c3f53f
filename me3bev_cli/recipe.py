"""The recipe: one frozen schema for everything that decides what is built, trained and compared.

Plugin blocks (`simulator`, `spatial`, `temporal`, `fusion`) hold a plugin's `name` and, beside it, that plugin's
own keys; those are checked against the plugin's `Config` by `recipe_check`. This module imports neither torch nor
numpy and knows no plugin.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from me3bev_cli.api import ObservationConfig
from me3bev_cli.recipe_base import Block, Names, Width
from me3bev_cli.recipe_stages import SimulatedStage, Stage
from me3bev_cli.recipe_training import PeriodicEvaluation, RewardWeights, effective

MODALITIES = ("bev", "vr", "nav")
"""The modalities in the order in which fusion takes them."""

Modality = Literal["bev", "vr", "nav"]


class PluginChoice(BaseModel):
    """A plugin by name, with the plugin's own keys beside it."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: str = Field(description="as `me3bev plugins` lists it")

    @property
    def settings(self) -> dict[str, Any]:
        """The plugin's own keys: what its `Config` is made from."""
        return dict(self.__pydantic_extra__ or {})


class SimulatorChoice(PluginChoice):
    """The world, and where in it training takes place unless a stage says otherwise."""

    map: str
    density: str


class Weather(Block):
    """Kinds of weather; each episode draws one of a set by its seed."""

    training: Names | None = Field(default=None, description="in which training takes place; null: the default one")
    evaluation: Names | None = Field(default=None, description="in which it is evaluated; null: the default one")


class VectorEncoder(Block):
    """A multi-layer perceptron from a feature vector to an embedding."""

    hidden: tuple[Width, ...] = Field(default=(64,), description="widths of the hidden layers")
    width: Width = Field(default=256, description="width of the embedding")


class GridProjection(Block):
    """What fusion is given of the token grid: all tokens, projected linearly to one vector."""

    width: Width = Field(default=256, description="width of the vector")


class Encoders(Block):
    """Width of each modality's vector at the fusion, and the encoders of the two that are vectors already."""

    bev: GridProjection = GridProjection()
    vr: VectorEncoder = Field(default=VectorEncoder(), description="vehicle (4) and road (9) features")
    nav: VectorEncoder = Field(default=VectorEncoder(), description="navigation (5) features")


class WindowContext(Block):
    """The temporal module reads the last `length` frames afresh at each step (the paper's is 4)."""

    kind: Literal["window"]
    length: int = Field(default=4, ge=1, le=256, description="frames")


class StreamContext(Block):
    """The temporal module carries one state along the whole episode."""

    kind: Literal["stream"]


Context = Annotated[WindowContext | StreamContext, Field(discriminator="kind")]


class Policy(Block):
    """Actor and critic: two perceptrons on the fused vector, and the distribution of actions."""

    distribution: Literal["gaussian", "beta"] = "gaussian"
    hidden: tuple[Width, ...] = Field(default=(256,), description="hidden layers, of the actor and of the critic")
    activation: Literal["tanh", "relu", "elu", "silu", "gelu"] = "tanh"
    initial_log_std: float = Field(default=-1.0, ge=-10, le=3, description="gaussian: log of the deviation at first")


class Recipe(Block):
    """A driving policy and how it is trained."""

    name: str = Field(min_length=1, pattern=r"^[\w.-]+$", description="names the run")
    simulator: SimulatorChoice
    weather: Weather = Weather()
    observation: ObservationConfig = ObservationConfig()
    modalities: tuple[Modality, ...] = Field(default=("bev", "vr", "nav"), min_length=1)
    spatial: PluginChoice | None = Field(default=None, description="needed when modalities hold bev")
    encoders: Encoders = Encoders()
    temporal: PluginChoice | None = Field(default=None, description="null: no memory")
    context: Context = WindowContext(kind="window")
    fusion: PluginChoice
    policy: Policy = Policy()
    reward: RewardWeights = RewardWeights()
    stages: tuple[Stage, ...] = Field(min_length=1, description="run in order")
    evaluation: PeriodicEvaluation = PeriodicEvaluation()
    keep_every: int | None = Field(
        default=None, gt=0, description="environment steps: a checkpoint out of each so many is kept for good"
    )
    seed: int = Field(default=0, ge=0, lt=2**31)
    device: Literal["auto", "cpu", "cuda"] = "auto"

    @model_validator(mode="after")
    def _modalities_fit(self) -> Recipe:
        if len(set(self.modalities)) < len(self.modalities):
            raise ValueError("modalities names one of them twice")
        if "bev" in self.modalities and self.spatial is None:
            raise ValueError("modalities hold bev but there is no spatial plugin")
        return self

    def simulator_in(self, stage: SimulatedStage) -> SimulatorChoice:
        """The simulator block as it stands in a stage."""
        place = {"map": stage.map or self.simulator.map, "density": stage.density or self.simulator.density}
        return SimulatorChoice.model_validate(self.simulator.model_dump() | stage.simulator | place)

    def weather_in(self, stage: SimulatedStage) -> tuple[str, ...] | None:
        """The kinds of weather that a stage's episodes draw from; None: the simulator's default one."""
        return stage.weather or self.weather.training

    def reward_in(self, stage: SimulatedStage) -> dict[str, float]:
        """The weights of the terms that a stage adds to the simulator's reward; empty: none."""
        return effective(self.reward, stage.reward)
