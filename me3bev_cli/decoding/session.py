"""One `me3bev decode`: open the run, have its decoders trained, score and draw."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from me3bev_cli.decoding.decoder import SemanticDecoder
from me3bev_cli.decoding.latents import Probe, Reader, described, latent_spec
from me3bev_cli.decoding.learning import Scenes, Training
from me3bev_cli.decoding.moments import Episodes, check_logs, live_takes, log_takes
from me3bev_cli.decoding.plan import GRID, U_BEV, UNTRAINED, Plan
from me3bev_cli.decoding.store import (
    DECODER,
    TRAINING,
    Decoders,
    about_decoders,
    fingerprint,
    keep_decoders,
    load_decoders,
    load_training,
)
from me3bev_cli.errors import CheckpointError, UserError
from me3bev_cli.perception.model import HEAD, PerceptionModel, load_model
from me3bev_cli.pipeline.assemble import build_network, pick_device
from me3bev_cli.pipeline.network import Network
from me3bev_cli.recording.mapping import TopicMapping, load_mapping
from me3bev_cli.recording.reader import log_files
from me3bev_cli.seeding import derive_seed
from me3bev_cli.training.checkpoint import find_checkpoint, load_network

if TYPE_CHECKING:
    from me3bev_cli.recipe import Recipe

Say = Callable[[str], None]


@dataclass(frozen=True)
class Policy:
    """A frozen policy and what names it."""

    run: Path
    network: Network
    recipe: Recipe
    identity: dict[str, str]

    @property
    def device(self) -> torch.device:
        """Where it is."""
        return self.network.device

    def untrained(self) -> Network:
        """The same network with the weights that its seed gives."""
        return build_network(self.recipe, self.recipe.seed).to(self.device)

    def head(self) -> PerceptionModel | None:
        """The perception stage's head on the grid, if the run has one."""
        return load_model(self.network, self.run) if (self.run / HEAD).exists() else None


def open_policy(run: Path, checkpoint: str | None, out: Path, device: str = "auto") -> Policy:
    """The policy of a checkpoint; where none is named, that which the decoders in `out` are of, or the newest.

    Raises:
        CheckpointError: it is missing, damaged or of another architecture.
        UserError: the policy has no bird's-eye latent.
    """
    if checkpoint is None:
        found = identity_in(out)
        checkpoint = "last" if found is None else str(found["policy"]["checkpoint"])
    folder = find_checkpoint(run, checkpoint)
    network, recipe = load_network(folder, pick_device(device))
    latent_spec(network, recipe, U_BEV)
    return Policy(run, network.eval(), recipe, fingerprint(folder))


def identity_in(out: Path) -> dict[str, Any] | None:
    """Plan and policy of the decoders in a folder, whether their training is over or not; None where there are none.

    Raises:
        CheckpointError: a file is damaged.
    """
    state = load_training(out)
    if state is not None:
        begun: dict[str, Any] = json.loads(state["identity"])
        return begun
    about = about_decoders(out)
    return None if about is None else about["identity"]


def begin_anew(out: Path) -> None:
    """Remove the decoders in a folder."""
    for name in (TRAINING, DECODER):
        (out / name).unlink(missing_ok=True)


def probes_of(policy: Policy, sources: Sequence[str]) -> list[Probe]:
    """What is decoded, by the names of probes."""
    return [
        Probe(UNTRAINED, policy.untrained(), U_BEV) if name == UNTRAINED else Probe(name, policy.network, name)
        for name in sources
    ]


def have_decoders(policy: Policy, plan: Plan, out: Path, say: Say) -> Decoders:
    """The decoders in `out`, trained if they are not there or not ready.

    Raises:
        CheckpointError: those that are there are another policy's, or a file is damaged.
        UserError: there is one of another plan.
        StoppedError: Ctrl-C; the same command goes on.
    """
    identity = json.loads(json.dumps({"plan": plan.identity(), "policy": policy.identity}))
    found, state = identity_in(out), load_training(out)
    if found is not None:
        _check_identity(found, identity, out)
    if found is None or state is not None:
        _train(policy, plan, out, identity, state, say)
    return load_decoders(out, policy.device)


def _check_identity(found: dict[str, Any], wanted: dict[str, Any], out: Path) -> None:
    hint = "--overwrite trains one anew, --out keeps it elsewhere"
    if found["policy"] != wanted["policy"]:
        raise CheckpointError(
            f"the decoder in {out} is of {found['policy']['checkpoint']}, or of other weights of that name", hint=hint
        )
    for key, value in wanted["plan"].items():
        there = found["plan"].get(key)
        if there != value:
            raise UserError(f"{out} holds a decoder of another plan: {key} {there}, not {value}", hint=hint)


def opened_mapping(plan: Plan) -> TopicMapping | None:
    """The mapping that is named."""
    return None if plan.mapping is None else load_mapping(plan.mapping)


def scenes_of(policy: Policy, plan: Plan) -> Scenes:
    """The episodes to learn from and those to hold out: a fifth, one at least.

    Raises:
        UserError: there are fewer than two.
        LogError: logs are missing, damaged, or of other cameras than the policy's or each other's.
    """
    mapping = opened_mapping(plan)
    player = Episodes(policy.recipe, mapping)
    if plan.logs is None:
        takes = live_takes(plan.maps, plan.density, plan.weather, plan.episodes, plan.seed, "learn")
    else:
        files = log_files(plan.logs)
        check_logs(files, policy.recipe, mapping)
        takes = log_takes(files)
    if len(takes) < 2:
        raise UserError("decoding needs at least two episodes: one to learn from, one to score on")
    spared = max(1, len(takes) // 5)
    learned = [take._replace(varied=plan.varied and take.log is None) for take in takes[spared:]]
    return Scenes(player, learned, takes[:spared])


def _train(
    policy: Policy, plan: Plan, out: Path, identity: dict[str, Any], state: dict[str, Any] | None, say: Say
) -> None:
    names = [*plan.sources, *((UNTRAINED,) if plan.untrained else ())]
    specs = {name: latent_spec(policy.network, policy.recipe, GRID if name == GRID else U_BEV) for name in names}
    scenes, decoders = scenes_of(policy, plan), {}
    for name in names:
        # A trained latent and an untrained one are decoded from the same beginning.
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(derive_seed(plan.seed, "decoder"))
            decoders[name] = SemanticDecoder(specs[name], plan.pretrained).to(policy.device)
    training = Training(plan, scenes, Reader(probes_of(policy, names)), decoders, out, identity, say)
    note = described(specs[names[0]], policy.recipe)
    if note is not None:
        say(note)
    if state is not None:
        say(f"goes on at step {state['place'][2]}")
    try:
        ended = training.run(state)
    finally:
        scenes.player.close()
    about = {
        "identity": identity,
        "latents": {name: list(spec) for name, spec in specs.items()},
        "steps": training.step,
        "ended": ended,
        "scores": {name: own["score"] for name, own in training.best.items()},
        "note": note,
    }
    weights = {name: own["weights"] for name, own in training.best.items()}
    keep_decoders(out, weights, training.frequency.argmax(0).to(torch.uint8), about)
    (out / TRAINING).unlink(missing_ok=True)
    say(f"decoder: finished, {ended}")
