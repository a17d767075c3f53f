"""What one training of decoders is made of."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from me3bev_cli.errors import CheckpointError

U_BEV, GRID = "u_bev", "grid"
"""The policy's latent after its memory, and the bird's-eye grid before it."""
UNTRAINED, MOST_FREQUENT = "untrained", "most_frequent"
"""Baselines: u_BEV of the same network with the weights that its seed gives; the most frequent class of each cell."""


@dataclass(frozen=True)
class Plan:
    """Which frames are learned from, and how long."""

    maps: tuple[str, ...]
    density: str
    weather: tuple[str, ...]
    """Of live episodes; they take turns."""
    episodes: int = 40
    """Live episodes; a fifth is held out."""
    logs: Path | None = None
    """Learn from these in place of live episodes."""
    mapping: Path | None = None
    """Topics of logs that are not ours."""
    sources: tuple[str, ...] = (U_BEV,)
    untrained: bool = True
    """Whether an untrained encoder is decoded beside it."""
    varied: bool = True
    """Whether live episodes that are learned from are seen in other sizes, mirrored and turned: one town alone has
    roads of one width."""
    steps: int = 1000
    batch: int = 8
    every: int = 4
    """Of so many frames one is kept: neighbours are nearly the same picture."""
    check: int = 50
    """Gradient steps of a round; after each the held-out episodes are scored."""
    patience: int = 8
    """Rounds without a better score after which it stops."""
    learning_rate: float = 2e-3
    memory: int = 1000
    """Megabytes of latents that are kept, at most."""
    autocast: str | None = None
    """The type in which decoders learn where torch's autocast allows it; None: float32."""
    pretrained: bool | str = False
    seed: int = 0

    def identity(self) -> dict[str, Any]:
        """What decides the result, for the file: another plan must not go on with this one's training."""
        values = asdict(self).items()
        return {k: str(v) if isinstance(v, Path) else list(v) if isinstance(v, tuple) else v for k, v in values}

    @classmethod
    def of_identity(cls, identity: dict[str, Any]) -> Plan:
        """The plan that `identity` tells of.

        Raises:
            CheckpointError: it is of another make.
        """
        values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in identity.items()}
        try:
            for key in ("logs", "mapping"):
                values[key] = None if values[key] is None else Path(values[key])
            return cls(**values)
        except (KeyError, TypeError) as error:
            raise CheckpointError(
                f"the decoder that is there is of another make ({error})", hint="--overwrite trains one anew"
            ) from None
