"""From a recipe to the network it describes: loads the plugins that are named and joins them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from torch import nn

from me3bev_cli import registry
from me3bev_cli.api import ObservationConfig, Rig
from me3bev_cli.errors import UserError
from me3bev_cli.pipeline.heads import Actor, Critic, mlp
from me3bev_cli.pipeline.memory import Memory, NoMemory, StreamMemory, WindowMemory
from me3bev_cli.pipeline.network import Network, Parts
from me3bev_cli.pipeline.sensor import VECTOR_WIDTHS, Sensor

if TYPE_CHECKING:
    from me3bev_cli.recipe import PluginChoice, Recipe

ACTIVATIONS: dict[str, type[nn.Module]] = {
    "relu": nn.ReLU,
    "silu": nn.SiLU,
    "tanh": nn.Tanh,
    "elu": nn.ELU,
    "gelu": nn.GELU,
}


def pick_device(name: str) -> torch.device:
    """`auto`, `cpu`, `cuda` or `cuda:1` -> a device that is there.

    Raises:
        UserError: there is no such device.
    """
    count = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if name == "auto":
        return torch.device("cuda" if count else "cpu")
    known = ["cpu", *(["cuda"] if count else []), *(f"cuda:{index}" for index in range(count))]
    if name not in known:
        raise UserError(f"device '{name}' is not available here", allowed=", ".join(["auto", *known]))
    return torch.device(name)


def configured(kind: str, choice: PluginChoice) -> tuple[type[Any], Any]:
    """The plugin class that is named and its validated config."""
    cls = registry.load(kind, choice.name)
    return cls, cls.Config(**choice.settings)


def recipe_rig(recipe: Recipe) -> Rig:
    """Calibration of the recipe's cameras, as its simulator has them."""
    cls, config = configured("simulator", recipe.simulator)
    return cls(config).rig(recipe.observation)


def _vector_encoder(name: str, recipe: Recipe) -> nn.Sequential:
    encoder = getattr(recipe.encoders, name)
    return mlp([VECTOR_WIDTHS[name], *encoder.hidden, encoder.width], nn.SiLU)


def _memory(recipe: Recipe, widths: dict[str, int]) -> Memory:
    if recipe.temporal is None:
        return NoMemory()
    cls, config = configured("temporal", recipe.temporal)
    modules = {name: cls(config, width) for name, width in widths.items()}
    if recipe.context.kind == "stream":
        return StreamMemory(modules)
    return WindowMemory(modules, recipe.context.length)


def _parts(recipe: Recipe, observation: ObservationConfig) -> Parts:
    spatial: nn.Module | None = None
    tokens, projection = None, None
    widths: dict[str, int] = {}
    fused: dict[str, int] = {}
    if recipe.spatial is not None and "bev" in recipe.modalities:
        cls, config = configured("spatial", recipe.spatial)
        rig = recipe_rig(recipe)
        spatial, tokens = cls(config, rig), cls.output_spec(config, rig)
        widths["bev"], fused["bev"] = tokens.width, recipe.encoders.bev.width
        projection = mlp([tokens.total * tokens.width, fused["bev"]], nn.SiLU)
    encoders: dict[str, nn.Module] = {}
    for name in ("vr", "nav"):
        if name in recipe.modalities:
            encoders[name] = _vector_encoder(name, recipe)
            widths[name] = fused[name] = getattr(recipe.encoders, name).width
    fusion_class, fusion_config = configured("fusion", recipe.fusion)
    width = fusion_class.output_width(fusion_config, fused)
    head = (width, recipe.policy.hidden, ACTIVATIONS[recipe.policy.activation])
    return Parts(
        sensor=Sensor(observation),
        spatial=spatial,
        tokens=tokens,
        encoders=encoders,
        memory=_memory(recipe, widths),
        projection=projection,
        fusion=fusion_class(fusion_config, fused),
        actor=Actor(*head, recipe.policy.distribution, recipe.policy.initial_log_std),
        critic=Critic(*head),
    )


def build_network(recipe: Recipe, seed: int) -> Network:
    """The recipe's network with weights drawn from `seed`, on the CPU.

    The caller's random state is left as it was.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return Network(_parts(recipe, recipe.observation))
