"""User errors: what is wrong, where, what is allowed, what to do next.

Anything a user can cause is a `UserError`; the command line prints its one message and exits with code 2.
Every other exception is a defect of the program and keeps its traceback.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class UserError(Exception):
    """A mistake that the user can mend; its text is the whole message.

    Args:
        what: one sentence that names the wrong value.
        where: file, line and key, or the option, that holds it.
        allowed: what would be accepted.
        hint: what to do next.
    """

    def __init__(
        self,
        what: str,
        *,
        where: str | None = None,
        allowed: str | None = None,
        hint: str | None = None,
    ) -> None:
        self.what = what
        self.where = where
        self.allowed = allowed
        self.hint = hint
        super().__init__(self.render())

    def render(self) -> str:
        """The message as shown to the user."""
        text = f"{self.where}: {self.what}" if self.where else self.what
        for more in (f"Allowed: {self.allowed}" if self.allowed else None, self.hint):
            if more:
                text += f" {more}" if text.endswith("?") else f". {more}"
        return text


class RecipeError(UserError):
    """One or more faults of a recipe, reported together."""

    def __init__(self, faults: Iterable[UserError]) -> None:
        self.faults = tuple(faults)
        super().__init__("\n".join(fault.render() for fault in self.faults))


class PluginError(UserError):
    """A plugin that is not installed, does not import or breaks its contract."""


class CheckpointError(UserError):
    """A checkpoint that is missing, truncated or belongs to another architecture."""


class RunError(UserError):
    """A run folder that is missing or incomplete."""


class MemoryShortError(UserError):
    """A recipe that needs more memory than there is; nothing of it has been taken yet."""


class MapError(UserError):
    """A map, density or weather that does not exist, or a map file that cannot be read."""


class LogError(UserError):
    """A recorded log that is missing, empty or damaged."""


def did_you_mean(word: str, options: Iterable[str]) -> str | None:
    """A question such as `did you mean 'mamba'?`, or None when nothing is near."""
    near = difflib.get_close_matches(word, list(options), n=1, cutoff=0.6)
    return f"did you mean '{near[0]}'?" if near else None


def unknown_name(
    what: str,
    word: str,
    options: Iterable[str],
    *,
    where: str | None = None,
    kind: type[UserError] = UserError,
) -> UserError:
    """The error for a name that is not among `options`, with the nearest one suggested."""
    names = sorted(options)
    question = did_you_mean(word, names)
    text = f"unknown {what} '{word}'"
    if question:
        text += f"; {question}"
    return kind(text, where=where, allowed=", ".join(names) if names else "none installed")
