"""The stages of a recipe: what is learned, where, for how long. They run in order."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from me3bev_cli.recipe_alarms import Alarms
from me3bev_cli.recipe_base import Block, Names, Width
from me3bev_cli.recipe_training import StageRewardWeights


class LearningRate(Block):
    """Step decay in environment steps of the stage; a plain number stays constant."""

    initial: float = Field(gt=0, le=1)
    drop: float = Field(default=1.0, gt=0, le=1, description="factor applied after every `every` steps")
    every: int = Field(default=100_000, gt=0, description="environment steps")

    @model_validator(mode="before")
    @classmethod
    def _plain_number(cls, data: Any) -> Any:
        if isinstance(data, int | float) and not isinstance(data, bool):
            return {"initial": data}
        return data

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        full = handler(schema)
        handler.resolve_ref_schema(full)
        return {"anyOf": [{"type": "number", "exclusiveMinimum": 0, "maximum": 1}, full]}

    def at(self, step: int) -> float:
        """The rate after `step` environment steps of the stage."""
        return self.initial * self.drop ** (step // self.every)


class SimulatedStage(Block):
    """What all stages share: where they take place, how long, what learns and how fast."""

    steps: int = Field(gt=0, description="environment steps")
    map: str | None = Field(default=None, description="instead of the simulator block's")
    density: str | None = Field(default=None, description="instead of the simulator block's")
    weather: Names | None = Field(default=None, description="instead of the weather block's training set")
    simulator: dict[str, Any] = Field(default={}, description="the simulator's own keys that differ in this stage")
    envs: int = Field(default=4, ge=1, le=256, description="environments side by side")
    workers: int | None = Field(
        default=None, ge=1, le=256, description="processes for them, at most envs; 1: this one; null: one per core"
    )
    worker_timeout: float | None = Field(
        default=300.0, gt=0, description="seconds without an answer before a process is started again; null: never"
    )
    learning_rate: LearningRate = LearningRate(initial=3e-4)
    reward: StageRewardWeights | None = Field(default=None, description="weights that differ from the reward block's")
    freeze: tuple[Literal["spatial", "encoders", "temporal", "fusion"], ...] = Field(
        default=(), description="parts that do not learn in this stage"
    )
    checkpoint_every: int = Field(default=20_000, gt=0, description="environment steps")


class DrivenStage(SimulatedStage):
    """A stage that plays whole episodes."""

    busiest_of: int = Field(
        default=1,
        ge=1,
        le=256,
        description="each episode is that of so many in which somebody is ahead most often; the autopilot drives them "
        "beforehand, without pictures, and these steps are not counted",
    )


def _segments_fit(stage: PpoStage | ImitationStage) -> None:
    """Raises ValueError where rollouts or minibatches are not made of whole segments."""
    frames = stage.envs * stage.rollout
    for name, size in (("rollout", stage.rollout), ("minibatch", stage.minibatch)):
        if size % stage.segment:
            raise ValueError(f"{name} {size} is not a multiple of segment {stage.segment}")
    if stage.minibatch > frames:
        raise ValueError(f"minibatch {stage.minibatch} is more than envs x rollout = {frames} frames")


class Guidance(Block):
    """What a `ppo` stage may learn beside PPO's loss: to do as the simulator's autopilot would where the policy is."""

    weight: float = Field(gt=0, description="of the squared distance of the mean action from the autopilot's")
    steering_weight: float = Field(default=10.0, gt=0, description="of the steering's beside the longitudinal's")


class PpoStage(DrivenStage):
    """Proximal policy optimisation in the simulator."""

    kind: Literal["ppo"]
    rollout: int = Field(default=256, ge=2, description="steps per environment between two updates")
    segment: int = Field(default=16, ge=1, description="contiguous frames that are learned from together")
    minibatch: int = Field(default=128, ge=1, description="frames per gradient step; a multiple of segment")
    epochs: int = Field(default=4, ge=1, le=100, description="passes over a rollout")
    microbatch: int | None = Field(
        default=None,
        ge=1,
        description="frames whose images are encoded at a time, once more in the backward pass: the same gradients in "
        "less memory; null: all of a minibatch",
    )
    autocast: Literal["bfloat16"] | None = Field(
        default=None,
        description="computes the network in a shorter type, in collection and in the update; null: float32",
    )
    gamma: float = Field(default=0.99, gt=0, le=1)
    gae_lambda: float = Field(default=0.95, ge=0, le=1)
    clip: float = Field(default=0.2, gt=0, lt=1)
    entropy: float = Field(default=0.0, ge=0, description="weight of the entropy bonus")
    value: float = Field(default=0.5, ge=0, description="weight of the value loss")
    max_grad_norm: float = Field(default=0.5, gt=0)
    target_kl: float | None = Field(default=None, gt=0, description="an update stops early beyond 1.5 times this")
    normalise_advantage: bool = True
    reward_scale: float = Field(default=1.0, gt=0, description="applied to what is learned from, not to what is shown")
    guidance: Guidance | None = Field(default=None, description="by the simulator's autopilot; null: reward alone")
    alarms: Alarms = Alarms()

    @model_validator(mode="after")
    def _sizes_fit(self) -> PpoStage:
        _segments_fit(self)
        return self


class ImitationStage(DrivenStage):
    """Learning from the simulator's autopilot, in rounds: drive for a while, then learn what it would have done there.

    In the first round the autopilot drives, disturbed by noise; later the policy does, so that it is shown the way
    out of the states that it gets itself into.
    """

    kind: Literal["imitation"]
    rollout: int = Field(default=256, ge=2, description="steps per environment in a round")
    beta: float = Field(
        default=0.0, ge=0, lt=1, description="the autopilot drives a share beta^k of the episodes of round k, from 0"
    )
    steering_noise: float = Field(default=0.1, ge=0, le=1, description="deviation, added while the autopilot drives")
    longitudinal_noise: float = Field(default=0.3, ge=0, le=1, description="the same for throttle and brake")
    segment: int = Field(default=16, ge=1, description="contiguous frames that are learned from together")
    burn_in: int = Field(
        default=16, ge=0, description="frames before a segment that fill the memory, where the context is a stream"
    )
    minibatch: int = Field(default=128, ge=1, description="frames per gradient step; a multiple of segment")
    epochs: int = Field(default=4, ge=1, le=1000, description="learning of a round, in passes over as many frames")
    microbatch: int | None = Field(default=None, ge=1, description="as in a ppo stage")
    autocast: Literal["bfloat16"] | None = Field(default=None, description="as in a ppo stage")
    pool: int = Field(default=16_384, ge=1, description="frames of past rounds that are learned from; the oldest go")
    loss: Literal["l1", "mse"] = Field(default="mse", description="of the policy's mean action")
    steering_weight: float = Field(default=10.0, gt=0, description="of the steering's loss beside the longitudinal's")
    value: float = Field(default=0.5, ge=0, description="weight of the critic's loss; it reads, but does not shape")
    gamma: float = Field(default=0.99, gt=0, lt=1, description="of the returns that the critic learns")
    reward_scale: float = Field(default=1.0, gt=0, description="of the same: as in the ppo stage that follows")
    max_grad_norm: float = Field(default=1.0, gt=0, description="of the policy's gradient and of the critic's, each")

    @model_validator(mode="after")
    def _sizes_fit(self) -> ImitationStage:
        _segments_fit(self)
        frames = self.envs * self.rollout
        if self.pool < frames:
            raise ValueError(f"pool {self.pool} is less than one round, envs x rollout = {frames} frames")
        return self


class PerceptionStage(SimulatedStage):
    """Supervised learning of the bird's-eye map and of depth, from frames that the autopilot is driven past.

    In rounds: `envs` stretches of driving are drawn, then learned from together with those of the rounds before.
    """

    kind: Literal["perception"]
    logs: Path | None = Field(
        default=None,
        description="a folder of recorded episodes to learn from instead; some may hold no depth",
    )
    rollout: int = Field(default=256, ge=1, description="steps of each stretch; of a log, at most so many")
    every: int = Field(default=4, ge=1, description="of so many steps one frame is kept: neighbours are much the same")
    noise: float = Field(
        default=0.15, ge=0, le=1, description="disturbance of the autopilot's steering, twice that of its speed"
    )
    roam: float = Field(
        default=0.5, ge=0, le=1, description="share of frames seen from elsewhere near by, turned any way, if it can be"
    )
    dress: float = Field(
        default=0.0, ge=0, le=1, description="share of frames whose sidewalks, lines, houses and trees are others"
    )
    pool: int = Field(default=2048, ge=1, description="frames of the last rounds that are learned from; the oldest go")
    uses: float = Field(default=4.0, gt=0, description="how often a frame is learned from, on average")
    minibatch: int = Field(default=8, ge=1, description="frames per gradient step")
    learning_rate: LearningRate = LearningRate(initial=1e-3)
    warmup: int = Field(default=0, ge=0, description="environment steps over which the rate rises to its value")
    anneal: float = Field(
        default=0.02, gt=0, le=1, description="share of the rate left at the last step, along a half cosine; 1: all"
    )
    weight_decay: float = Field(default=1e-4, ge=0)
    max_grad_norm: float = Field(default=5.0, gt=0)
    balance: float = Field(
        default=0.5, ge=0, le=1, description="classes are weighted by their frequency to the power of minus this"
    )
    hidden: float = Field(
        default=0.5, ge=0, le=1, description="weight of far cells that no camera sees, beside 1 for the others"
    )
    dice: float = Field(default=1.0, ge=0, description="weight of the dice loss")
    tokens: float = Field(default=0.5, ge=0, description="weight of the same losses on a map made of the tokens alone")
    depth: float = Field(default=0.5, ge=0, description="weight of the depth loss, where there is depth to predict")
    mirror: bool = Field(default=True, description="mirror half of the frames, where the cameras stand symmetrically")
    colours: float = Field(default=0.0, ge=0, le=1, description="how strongly each frame's colours are shifted")
    stretch: float = Field(
        default=0.0, ge=0, le=1, description="share of the frames whose grid and truth are stretched, if it can be"
    )
    head_width: Width = Field(default=64, description="channels between the two layers of the segmentation head")
    autocast: Literal["bfloat16"] | None = Field(default=None, description="as in a ppo stage")
    held_out: int = Field(default=64, ge=0, description="frames of other episodes that are scored; 0: none")
    score_every: int = Field(default=10_000, gt=0, description="environment steps between two scores")

    @model_validator(mode="after")
    def _sizes_fit(self) -> PerceptionStage:
        if self.minibatch > self.pool:
            raise ValueError(f"minibatch {self.minibatch} is more than pool {self.pool} frames")
        return self


Stage = Annotated[PpoStage | ImitationStage | PerceptionStage, Field(discriminator="kind")]
"""What `stages` holds, told apart by `kind`."""
