"""Blocks of a recipe that say what training rewards and how it is watched."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field

from me3bev_cli.recipe_base import Block, Names
from me3bev_cli.reward_terms import TERMS

Weight = Annotated[float, Field(ge=0)]


def _weight(name: str, default: float | None) -> Any:
    term = TERMS[name]
    return Field(default=default, description=f"{term.summary}; reward per {term.unit}")


class RewardWeights(Block):
    """Weights of the terms that are added to the simulator's reward, which is the paper's; 0: the term is off."""

    progress: Weight = _weight("progress", 0.0)
    lane_keeping: Weight = _weight("lane_keeping", 0.0)
    comfort: Weight = _weight("comfort", 0.0)
    speeding: Weight = _weight("speeding", 0.0)
    red_light: Weight = _weight("red_light", 0.0)
    stop_sign: Weight = _weight("stop_sign", 0.0)
    lane_departure: Weight = _weight("lane_departure", 0.0)
    collision: Weight = _weight("collision", 0.0)


class StageRewardWeights(Block):
    """Weights that differ in a stage; null: the recipe's."""

    progress: Weight | None = _weight("progress", None)
    lane_keeping: Weight | None = _weight("lane_keeping", None)
    comfort: Weight | None = _weight("comfort", None)
    speeding: Weight | None = _weight("speeding", None)
    red_light: Weight | None = _weight("red_light", None)
    stop_sign: Weight | None = _weight("stop_sign", None)
    lane_departure: Weight | None = _weight("lane_departure", None)
    collision: Weight | None = _weight("collision", None)


def effective(weights: RewardWeights, stage: StageRewardWeights | None) -> dict[str, float]:
    """The weights that hold in a stage, by term; those that are 0 are left out."""
    chosen = weights.model_dump() | (stage.model_dump(exclude_none=True) if stage is not None else {})
    return {name: weight for name, weight in chosen.items() if weight}


class PeriodicEvaluation(Block):
    """Evaluation while training goes on: the same episodes each time; the best policy is kept as checkpoints/best."""

    every: int | None = Field(
        default=None, gt=0, description="environment steps between two evaluations; null: none at all"
    )
    episodes: int = Field(default=20, ge=1, le=10_000, description="for each map and density")
    maps: Names | None = Field(default=None, description="null: the simulator block's")
    densities: Names | None = Field(default=None, description="null: the simulator block's")
    envs: int = Field(default=8, ge=1, le=256, description="episodes side by side")
