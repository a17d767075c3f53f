"""Checks of a spatial plugin: shapes, types, devices, memory, independence of frames, calibration."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils import _pytree as pytree
from torch.utils._python_dispatch import TorchDispatchMode

from me3bev_cli.api import Calibration, PluginConfig, Rig, TokenSpec
from me3bev_cli.testing import broken, require
from me3bev_cli.testing_models import Outputs, check_module, noise, require_equal, seeded

FRAMES = 3
TOLERANCE = 1e-4
"""As `testing_models.TOLERANCE`, for frames that are computed in batches of different size."""
HALF = 0.1
"""Largest error of bf16 autocast against float32, as a share of the output's norm."""
OTHER_DEVICE = ("out of meta tensor", "same device", "meets one on")
"""What is said when tensors of two devices meet."""


class Allocations(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Notes the memory behind every tensor that an operation gives, backward passes included; numbers, not bytes."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.sizes: set[int] = set()

    @property
    def largest(self) -> int:
        """Of all tensors."""
        return max(self.sizes, default=0)

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run the operation and note what it gives."""
        result = func(*args, **(kwargs or {}))
        for value in result if isinstance(result, tuple | list) else [result]:
            if isinstance(value, Tensor):
                self.sizes.add(value.untyped_storage().nbytes() // value.element_size())
        return result


class OneDevice(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Refuses operations between tensors of two devices, some of which torch lets pass where one has no memory."""

    def __init__(self, device: str) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.device = device

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        """Run the operation unless tensors meet that should not; numbers alone (no axes) and copies may."""
        inputs = [value for value in pytree.tree_leaves((args, kwargs)) if isinstance(value, Tensor) and value.ndim]
        kinds = {value.device.type for value in inputs}
        if len(kinds) > 1 and func not in (torch.ops.aten._to_copy.default, torch.ops.aten.copy_.default):
            raise RuntimeError(f"{func}: a tensor on {self.device} meets one on {(kinds - {self.device}).pop()}")
        return func(*args, **(kwargs or {}))


def rig_calibration(rig: Rig, frames: int) -> Calibration:
    """The rig's own calibration, for every frame: float64, on the CPU."""
    intrinsics = torch.tensor([camera.intrinsics() for camera in rig.cameras], dtype=torch.float64)
    extrinsics = torch.tensor([camera.camera_to_ego() for camera in rig.cameras], dtype=torch.float64)
    return Calibration(intrinsics.expand(frames, -1, -1, -1), extrinsics.expand(frames, -1, -1, -1))


def jittered(calibration: Calibration, seed: int) -> Calibration:
    """Each camera of each frame turned about z by some 2 degrees, moved by some 5 cm, its focal length off by 2 %."""
    generator = torch.Generator().manual_seed(seed)
    frames, cameras = calibration.extrinsics.shape[:2]
    drawn = torch.randn(frames, cameras, 5, generator=generator, dtype=torch.float64)
    angle, scale = 0.035 * drawn[..., 0], 1 + 0.02 * drawn[..., 1]
    turn = torch.eye(4, dtype=torch.float64).repeat(frames, cameras, 1, 1)
    turn[..., 0, 0] = turn[..., 1, 1] = angle.cos()
    turn[..., 1, 0], turn[..., 0, 1] = angle.sin(), -angle.sin()
    turn[..., :3, 3] = 0.05 * drawn[..., 2:]
    intrinsics = calibration.intrinsics.clone()
    intrinsics[..., :2, :2] *= scale[..., None, None]
    return Calibration(intrinsics, turn @ calibration.extrinsics)


def check_spatial(cls: Any, config: PluginConfig, rig: Rig, seed: int) -> None:
    """All of it, on three frames of noise."""
    spec = cls.output_spec(config, rig)
    require(cls, isinstance(spec, TokenSpec), "output_spec gives a TokenSpec", repr(spec))
    height, width = rig.image_size
    images = seeded(seed, lambda: torch.randn(FRAMES, len(rig.cameras), 3, height, width))
    module = check_module(cls, lambda: cls(config, rig), partial(_run, images=images), seed)
    _check_shapes(cls, module, images, spec)
    _check_grid(cls, config, rig, module, images)
    with torch.no_grad():
        whole = _run(module, images)
        _check_frames(cls, whole, lambda frame: _run(module, images[frame : frame + 1]))
        _check_types(cls, module, images, whole)
        _check_device(cls, module, images)
        if "calibration" in inspect.signature(cls.forward).parameters:
            _check_calibration(cls, module, images, rig, seed, whole)
    _check_memory(cls, module, images)


def _run(module: nn.Module, images: Tensor, *calibration: Calibration) -> Outputs:
    output = module(images, *calibration)._asdict()
    return {name: value for name, value in output.items() if value is not None}


def _check_shapes(cls: type, module: nn.Module, images: Tensor, spec: TokenSpec) -> None:
    """As output_spec promises."""
    outputs = _run(module, images)
    shape, promised = tuple(outputs["tokens"].shape), (FRAMES, spec.total, spec.width)
    require(cls, shape == promised, f"the tokens' shape is {promised}, as output_spec says", shape)
    for name, axes in (("grid", 4), ("depth_logits", 5)):
        if name in outputs:
            given = tuple(outputs[name].shape)
            require(cls, len(given) == axes and given[0] == FRAMES, f"{name} has {axes} axes, frames first", given)
    if "depth_logits" in outputs:
        given = tuple(outputs["depth_logits"].shape)
        require(cls, given[1] == images.shape[1], "depth_logits has the cameras as second axis", given)
        edges = getattr(module, "depth_edges", None)
        told = None if edges is None else tuple(edges.shape)
        require(cls, told == (given[2] + 1,), "a plugin with depth_logits has depth_edges, one more than bins", told)


def _check_grid(cls: Any, config: PluginConfig, rig: Rig, module: nn.Module, images: Tensor) -> None:
    """As grid_spec promises, which a plugin with a grid has."""
    outputs, tells = _run(module, images), getattr(cls, "grid_spec", None)
    require(cls, ("grid" in outputs) == (tells is not None), "a plugin has grid_spec if it gives a grid", tells)
    if tells is not None:
        spec, shape = tells(config, rig), tuple(outputs["grid"].shape[1:])
        promised = (spec.channels, spec.rows, spec.columns)
        require(cls, shape == promised, f"the grid's shape is {promised}, as grid_spec says", shape)


def _check_frames(cls: type, whole: Outputs, single: Callable[[int], Outputs]) -> None:
    for frame in range(FRAMES):
        among = {name: value[frame : frame + 1] for name, value in whole.items()}
        promise = "a frame's output does not depend on the others in the batch"
        require_equal(cls, promise, single(frame), among, TOLERANCE)


def _check_types(cls: type, module: nn.Module, images: Tensor, whole: Outputs) -> None:
    """float64 all through for those who test against formulas; bf16 autocast for those who have the hardware."""
    for name, value in _run(copy.deepcopy(module).double(), images.double()).items():
        require(cls, value.dtype == torch.float64, "float64 in, float64 out", f"{name} is {value.dtype}")
        error = _share(value, whole[name])
        require(cls, error < HALF, "float64 gives what float32 gives", f"{name}: an error of {error:.1e}")
    with torch.autocast("cpu", torch.bfloat16):
        half = _run(module, images)
    for name, value in half.items():
        error = _share(value, whole[name])
        require(cls, error < HALF, f"bf16 autocast stays within {HALF:.0%} of float32", f"{name}: {error:.1e}")


def _share(value: Tensor, right: Tensor) -> float:
    """The error's norm over the right value's; infinite where something is not finite."""
    gap = (value.double() - right.double()).norm() / right.double().norm().clamp(min=1e-12)
    return float(gap) if bool(gap.isfinite()) else float("inf")


def _check_device(cls: type, module: nn.Module, images: Tensor) -> None:
    """The module follows `.to(device)`: on torch's device without memory, and on a GPU where there is one."""
    for device in ("meta", *(["cuda"] if torch.cuda.is_available() else [])):
        moved = copy.deepcopy(module).to(device)
        for label, part in moved.named_modules():
            for key, value in vars(part).items():
                if isinstance(value, Tensor) and value.device.type != device:
                    raise broken(cls, "all tensors follow the module across devices", f"{label}.{key} does not")
        try:
            with OneDevice(device):
                outputs = _run(moved, images.to(device))
        except RuntimeError as error:
            text = str(error)
            if any(sign in text for sign in OTHER_DEVICE):
                raise broken(cls, "the module computes where it is", text.splitlines()[0]) from error
            if device == "meta":
                # An operation whose result depends on values has no shape without memory: nothing can be said.
                continue
            raise
        for name, value in outputs.items():
            require(cls, value.device.type == device, "outputs are where the images are", f"{name} on {value.device}")


def _check_calibration(cls: type, module: nn.Module, images: Tensor, rig: Rig, seed: int, whole: Outputs) -> None:
    """The rig's calibration given per frame changes nothing; each frame is seen by its own."""
    fixed = rig_calibration(rig, FRAMES)
    promise = "the rig's calibration given per frame changes nothing"
    require_equal(cls, promise, _run(module, images, fixed), whole, TOLERANCE)
    own = jittered(fixed, seed)

    def single(frame: int) -> Outputs:
        part = Calibration(*(table[frame : frame + 1] for table in own))
        return _run(module, images[frame : frame + 1], part)

    _check_frames(cls, _run(module, images, own), single)


def _check_memory(cls: type, module: nn.Module, images: Tensor) -> None:
    """Where depth is predicted: no tensor of frames x cameras x bins x h x w x channels, forward or backward."""
    with Allocations() as made:
        outputs = _run(module, images)
        total = sum((value * noise(value, 0)).sum() for value in outputs.values() if value.requires_grad)
        if isinstance(total, Tensor):
            torch.autograd.backward(total)
    module.zero_grad()
    if "depth_logits" not in outputs:
        return
    points = outputs["depth_logits"].numel()
    # Coordinates of the points may be held, four numbers each at most; a vector of features may not.
    lifted = [size for size in made.sizes if size % points == 0 and size // points > 4]
    seen = f"a tensor with {max(lifted, default=0) // points} numbers for each point"
    require(cls, not lifted, "the features of an image are never lifted to every depth bin", seen)
