"""The recipe: one frozen schema for everything that decides what is built, trained and compared.

Plugin blocks (`simulator`, `spatial`, `temporal`, `fusion`) hold a plugin's `name` and, beside it, that plugin's
own keys; those are checked against the plugin's `Config` by `recipe_check`. This module imports neither torch nor
numpy and knows no plugin.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, GetJsonSchemaHandler, model_validator
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema

from me3bev_cli.api import ObservationConfig

MODALITIES = ("bev", "vr", "nav")
"""The modalities in the order in which fusion takes them."""

Modality = Literal["bev", "vr", "nav"]
Width = Annotated[int, Field(gt=0, le=65536)]


def _each_once(names: tuple[str, ...]) -> tuple[str, ...]:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"names '{name}' twice")
    return names


Names = Annotated[
    tuple[str, ...], Field(min_length=1, json_schema_extra={"uniqueItems": True}), AfterValidator(_each_once)
]
"""A set of names, written as a list."""


class Block(BaseModel):
    """Base of the schema: unknown keys are refused, values do not change, numbers are finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


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


class PpoStage(Block):
    """Proximal policy optimisation in the simulator."""

    kind: Literal["ppo"]
    steps: int = Field(gt=0, description="environment steps")
    map: str | None = Field(default=None, description="instead of the simulator block's")
    density: str | None = Field(default=None, description="instead of the simulator block's")
    weather: Names | None = Field(default=None, description="instead of the weather block's training set")
    simulator: dict[str, Any] = Field(default={}, description="the simulator's own keys that differ in this stage")
    envs: int = Field(default=4, ge=1, le=256, description="environments side by side")
    workers: int | None = Field(
        default=None, ge=1, le=256, description="processes for them, at most envs; 1: this one; null: one per core"
    )
    rollout: int = Field(default=256, ge=2, description="steps per environment between two updates")
    segment: int = Field(default=16, ge=1, description="contiguous frames that are learned from together")
    minibatch: int = Field(default=128, ge=1, description="frames per gradient step; a multiple of segment")
    epochs: int = Field(default=4, ge=1, le=100, description="passes over a rollout")
    learning_rate: LearningRate = LearningRate(initial=3e-4)
    gamma: float = Field(default=0.99, gt=0, le=1)
    gae_lambda: float = Field(default=0.95, ge=0, le=1)
    clip: float = Field(default=0.2, gt=0, lt=1)
    entropy: float = Field(default=0.0, ge=0, description="weight of the entropy bonus")
    value: float = Field(default=0.5, ge=0, description="weight of the value loss")
    max_grad_norm: float = Field(default=0.5, gt=0)
    target_kl: float | None = Field(default=None, gt=0, description="an update stops early beyond 1.5 times this")
    normalise_advantage: bool = True
    reward_scale: float = Field(default=1.0, gt=0, description="applied to what is learned from, not to what is shown")
    freeze: tuple[Literal["spatial", "encoders", "temporal", "fusion"], ...] = Field(
        default=(), description="parts that do not learn in this stage"
    )
    checkpoint_every: int = Field(default=20_000, gt=0, description="environment steps")

    @model_validator(mode="after")
    def _sizes_fit(self) -> PpoStage:
        frames = self.envs * self.rollout
        if self.rollout % self.segment:
            raise ValueError(f"rollout {self.rollout} is not a multiple of segment {self.segment}")
        if self.minibatch % self.segment:
            raise ValueError(f"minibatch {self.minibatch} is not a multiple of segment {self.segment}")
        if self.minibatch > frames:
            raise ValueError(f"minibatch {self.minibatch} is more than envs x rollout = {frames} frames")
        return self


Stage = PpoStage
"""What `stages` holds, told apart by `kind`; a second kind makes this a union discriminated by `kind`."""


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
    stages: tuple[Stage, ...] = Field(min_length=1, description="run in order")
    seed: int = Field(default=0, ge=0, lt=2**31)
    device: Literal["auto", "cpu", "cuda"] = "auto"

    @model_validator(mode="after")
    def _modalities_fit(self) -> Recipe:
        if len(set(self.modalities)) < len(self.modalities):
            raise ValueError("modalities names one of them twice")
        if "bev" in self.modalities and self.spatial is None:
            raise ValueError("modalities hold bev but there is no spatial plugin")
        return self

    def simulator_in(self, stage: Stage) -> SimulatorChoice:
        """The simulator block as it stands in a stage."""
        place = {"map": stage.map or self.simulator.map, "density": stage.density or self.simulator.density}
        return SimulatorChoice.model_validate(self.simulator.model_dump() | stage.simulator | place)

    def weather_in(self, stage: Stage) -> tuple[str, ...] | None:
        """The kinds of weather that a stage's episodes draw from; None: the simulator's default one."""
        return stage.weather or self.weather.training
