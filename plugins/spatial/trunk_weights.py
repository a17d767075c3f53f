"""Files of weights for a trunk: tensors only, checked name by name and shape by shape before they are loaded."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from me3bev_cli.errors import PluginError

_WRAPPERS = ("state_dict", "model", "model_state_dict")
"""Keys under which training scripts are used to keep the weights."""
_SHOWN = 3
"""Names per kind of difference in a message."""

Tensors = dict[str, Tensor]


def read_weights(path: Path, expected: Mapping[str, Tensor], heads: Iterable[str] = ()) -> Tensors:
    """The tensors of a file; nothing is unpickled but tensors and plain containers.

    Args:
        path: .safetensors, or a file that `torch.save` wrote.
        expected: names and shapes of the whole network, on any device.
        heads: what classifies in it; those tensors may be missing or of any shape, and are left out.

    Raises:
        PluginError: when the file is missing, damaged or of another architecture.
    """
    if not path.is_file():
        raise PluginError(f"there are no weights at '{path}'", hint="Give the path of a file, or pretrained: false")
    kept = tuple(f"{head}." for head in heads)
    given = {name: tensor for name, tensor in _tensors(path).items() if not name.startswith(kept)}
    wanted = {name: tensor for name, tensor in expected.items() if not name.startswith(kept)}
    # Files of old have no counters; the networks do not read them.
    missing = [name for name in wanted if name not in given and not name.endswith("num_batches_tracked")]
    unexpected = [name for name in given if name not in wanted]
    shapes = [
        f"{name} {_shape(given[name])} for {_shape(tensor)}"
        for name, tensor in wanted.items()
        if name in given and given[name].shape != tensor.shape
    ]
    differences = {"missing": missing, "unexpected": unexpected, "of another shape": shapes}
    found = "; ".join(_listed(kind, names) for kind, names in differences.items() if names)
    if found:
        raise PluginError(
            f"the weights in '{path}' are of another network: {found}",
            hint="Name the trunk that the file was made with",
        )
    return given


def _tensors(path: Path) -> Tensors:
    try:
        if path.suffix == ".safetensors":
            from safetensors.torch import load_file

            found: Any = load_file(path)
        else:
            found = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise PluginError(
            f"the weights in '{path}' cannot be read: {reason}",
            allowed="a .safetensors file, or a state_dict written by torch.save",
        ) from error
    for wrapper in _WRAPPERS:
        if isinstance(found, Mapping) and isinstance(found.get(wrapper), Mapping):
            found = found[wrapper]
    if not isinstance(found, Mapping) or not all(isinstance(value, Tensor) for value in found.values()):
        raise PluginError(f"the weights in '{path}' are not a table of tensors", allowed="a model's state_dict")
    # What torch's wrapper for several devices puts before every name.
    return {str(name).removeprefix("module."): value for name, value in found.items()}


def _shape(tensor: Tensor) -> str:
    return " x ".join(map(str, tensor.shape)) or "()"


def _listed(kind: str, names: list[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return f"{kind}: {', '.join(names[:_SHOWN])}{more}"
