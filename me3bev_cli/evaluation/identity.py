"""What decides an evaluation's episodes: two evaluations with the same identity have the same logs, byte for byte."""

from __future__ import annotations

import hashlib
import inspect
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from me3bev_cli import registry
from me3bev_cli.errors import CheckpointError
from me3bev_cli.evaluation.crew import ROWS
from me3bev_cli.evaluation.player import Method
from me3bev_cli.evaluation.runner import World

IMAGE_KEYS = ("cameras", "height", "width")
"""Of the observation; drivers that do not look do not depend on them."""


def identity(method: Method, seed: int, maps: Sequence[str]) -> dict[str, Any]:
    """Everything that decides a method's episodes but the map's name, the density and the index.

    Args:
        maps: what is driven on; of imported ones the files count too.

    Raises:
        CheckpointError: the policy's weights are not there.
        PluginError: the simulator does not load.
    """
    spec, world = method.spec, method.world
    observation = world.observation.model_dump(mode="json")
    if not spec.looks:
        observation = {key: value for key, value in observation.items() if key not in IMAGE_KEYS}
    found: dict[str, Any] = {
        "driver": spec.name,
        "simulator": world.simulator.name,
        "simulator_settings": dict(world.simulator.settings),
        "simulator_code": code_digest(registry.load("simulator", world.simulator.name)),
        "observation": observation,
        "weather": list(world.weather or ()),
        "seed": seed,
    }
    imported = _imported(world, maps)
    if imported:
        found["maps"] = imported
    if spec.recipe is not None:
        from me3bev_cli.pipeline.assemble import pick_device
        from me3bev_cli.recipe_loading import dump

        text = dump(spec.recipe)
        found |= {"recipe": _digest(text.encode()), "device": pick_device(spec.device).type, "rows": ROWS}
    if spec.run is not None:
        found |= {"checkpoint": spec.checkpoint, "weights": _weights(spec.run, spec.checkpoint)}
    return found


def short(found: Mapping[str, Any]) -> str:
    """A few letters that stand for an identity."""
    return _digest(json.dumps(found, sort_keys=True).encode())[:12]


def code_digest(plugin: type[Any]) -> str:
    """What a plugin's own files say: its package, or its module where it is in none."""
    source = Path(inspect.getfile(plugin))
    alone = "." not in plugin.__module__
    files = [source] if alone else sorted(p for p in source.parent.rglob("*") if "__pycache__" not in p.parts)
    digest = hashlib.blake2b(digest_size=16)
    for path in files:
        if path.is_file():
            name = path.relative_to(source.parent).as_posix()
            digest.update(f"{name}\0".encode() + hashlib.blake2b(path.read_bytes(), digest_size=16).digest())
    return digest.hexdigest()


def _imported(world: World, maps: Sequence[str]) -> dict[str, str]:
    """What the files of imported maps hold; nothing where the simulator keeps no maps of its own."""
    digest_of = getattr(world.open(), "map_digest", None)
    if digest_of is None:
        return {}
    digests = {name: digest_of(name) for name in maps}
    return {name: digest for name, digest in digests.items() if digest is not None}


def _weights(run: Path, checkpoint: str) -> str:
    from me3bev_cli.training.checkpoint import WEIGHTS, find_checkpoint

    path = find_checkpoint(run, checkpoint) / WEIGHTS
    try:
        return _digest(path.read_bytes())
    except OSError as error:
        raise CheckpointError(f"cannot be read: {error.strerror}", where=str(path)) from error


def _digest(data: bytes) -> str:
    return hashlib.blake2b(data, digest_size=16).hexdigest()
