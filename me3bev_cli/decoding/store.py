"""Files of a decoding: the decoders, and what their training needs to go on exactly. Nothing of them is unpickled.

RUN/decode/
    decoder.safetensors    the best weights of every decoder, and how they came about as metadata
    training.pt            read with weights_only; gone when the training is over
    scores.json            the last scores
"""

from __future__ import annotations

import hashlib
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from me3bev_cli.decoding.decoder import LatentSpec, SemanticDecoder
from me3bev_cli.decoding.plan import MOST_FREQUENT
from me3bev_cli.errors import CheckpointError
from me3bev_cli.files import atomic_write_bytes

DECODER, TRAINING = "decoder.safetensors", "training.pt"


def fingerprint(checkpoint: Path) -> dict[str, str]:
    """What names a policy: its checkpoint, and a digest of its weights."""
    digest = hashlib.blake2b((checkpoint / "policy.safetensors").read_bytes(), digest_size=16).hexdigest()
    return {"checkpoint": checkpoint.name, "weights": digest}


@dataclass
class Decoders:
    """Trained decoders by probe."""

    modules: dict[str, SemanticDecoder]
    most_frequent: NDArray[np.uint8]
    """(200, 200), the most frequent class of each cell in what was learned from."""
    about: dict[str, Any]
    """`identity` of plan and policy, `steps`, `stopped`, `scores` by probe, `sources` by probe."""


def keep_decoders(folder: Path, weights: dict[str, dict[str, Tensor]], most_frequent: Tensor, about: Any) -> None:
    """Write the decoders' file, whole or not at all.

    Raises:
        UserError: it cannot be written.
    """
    tensors = {f"{name}.{key}": value.contiguous() for name, own in weights.items() for key, value in own.items()}
    atomic_write_bytes(folder / DECODER, save(tensors | {MOST_FREQUENT: most_frequent}, {"about": json.dumps(about)}))


def about_decoders(folder: Path) -> dict[str, Any] | None:
    """How the decoders in a folder came about; None where there are none.

    Raises:
        CheckpointError: the file is damaged.
    """
    path = folder / DECODER
    if not path.exists():
        return None
    try:
        with safe_open(path, framework="pt") as file:
            about: dict[str, Any] = json.loads((file.metadata() or {})["about"])
        if not {"identity", "latents"} <= set(about):
            raise KeyError("identity")
        return about
    except (SafetensorError, OSError, KeyError, ValueError, TypeError) as error:
        raise _damaged(path, error) from error


def load_decoders(folder: Path, device: torch.device) -> Decoders:
    """The decoders in a folder.

    Raises:
        CheckpointError: there are none, or the file is damaged.
    """
    path, about = folder / DECODER, about_decoders(folder)
    if about is None:
        raise CheckpointError(f"there is no decoder in {folder}", hint="`me3bev decode RUN` trains one")
    try:
        with safe_open(path, framework="pt") as file:
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
        modules = {}
        for name, spec in about["latents"].items():
            decoder = SemanticDecoder(LatentSpec(*spec))
            own = {key.removeprefix(f"{name}."): v for key, v in tensors.items() if key.startswith(f"{name}.")}
            decoder.load_state_dict(own)
            modules[name] = decoder.to(device).eval()
        return Decoders(modules, tensors[MOST_FREQUENT].numpy(), about)
    except (SafetensorError, OSError, KeyError, ValueError, TypeError, RuntimeError) as error:
        raise _damaged(path, error) from error


def keep_training(folder: Path, state: dict[str, Any]) -> None:
    """Write what `load_training` reads, whole or not at all.

    Raises:
        UserError: it cannot be written.
    """
    buffer = io.BytesIO()
    torch.save(state, buffer)
    atomic_write_bytes(folder / TRAINING, buffer.getvalue())


def load_training(folder: Path) -> dict[str, Any] | None:
    """Where a training was left; None where there is none.

    Raises:
        CheckpointError: the file is damaged.
    """
    path = folder / TRAINING
    if not path.exists():
        return None
    try:
        state: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        json.loads(state["identity"])
    except Exception as error:  # torch.load raises many types for a damaged file
        raise _damaged(path, error) from error
    return state


def _damaged(path: Path, error: Exception) -> CheckpointError:
    return CheckpointError(
        f"{path} is damaged or of another make ({type(error).__name__})", hint="--overwrite trains the decoder anew"
    )
