"""What a `ppo` stage takes for a sign that its learning has gone astray."""

from __future__ import annotations

from pydantic import Field

from me3bev_cli.recipe_base import Block


class Alarms(Block):
    """Limits beyond which a run warns, or stops. A loss or gradient that is no finite number always stops it."""

    kl: float = Field(default=10.0, gt=1, description="an update is far off beyond this many times target_kl")
    updates: int = Field(default=3, ge=1, description="in a row that are far off before it is said")
    entropy: float = Field(default=-6.0, description="nats: with less, the policy hardly tries anything any more")
    stop: bool = Field(default=False, description="stop the run at such an alarm; otherwise it warns and goes on")
