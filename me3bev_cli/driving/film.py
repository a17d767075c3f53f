"""Turns what happens in an environment into a video's frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from me3bev_cli.api import LIGHT_STATES, StepRecord
from me3bev_cli.driving.frame import PLAN, Caption, Frames, View
from me3bev_cli.driving.video import RATE, Video
from me3bev_cli.evaluation.episode import Ending, Episode
from me3bev_cli.evaluation.metrics import driving_score

TITLE_FRAMES = RATE // 2
"""A title stands for half a second."""
HOLD_FRAMES = RATE
"""An outcome stands for a second."""
_LIGHT = slice(4, 9)
"""The one-hot of `LIGHT_STATES` in R."""

OUTCOMES: dict[Ending, str] = {
    "finished": "route finished",
    "collision": "collision",
    "timeout": "time is up",
    "stopped": "ended by the simulator",
}
"""Endings for people."""


class Film:
    """One video of several episodes.

    Args:
        video: where the frames go.
        cameras: names, in the order of the images.
    """

    def __init__(self, video: Video, cameras: Sequence[str]) -> None:
        self.video, self.frames = video, Frames(cameras)

    def begin(self, caption: Caption) -> None:
        """An episode begins; among several with a title."""
        self.frames.begin(caption)
        if caption.episodes > 1:
            self.video.add(self.frames.card(), TITLE_FRAMES)

    def step(self, env: Any, seen: Mapping[str, NDArray[Any]], record: StepRecord) -> None:
        """The environment has made a step and stands where the observation was taken."""
        world = env.unwrapped
        light = LIGHT_STATES[int(np.argmax(seen["road"][_LIGHT]))]
        view = View(seen["images"], world.bev_semantics(), world.plan_view(PLAN), record, light)
        self.last = self.frames.step(view)
        self.video.add(self.last)

    def end(self, episode: Episode) -> None:
        """The episode is over: hold its last frame, with the outcome."""
        text = f"{OUTCOMES[episode.ended]}  ·  driving score {driving_score(episode):.0f}"
        self.video.add(self.frames.end(self.last, episode.ended, text), HOLD_FRAMES)
