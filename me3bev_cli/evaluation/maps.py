"""Names of maps, densities and kinds of weather as a command takes them: lists, ranges, all."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from me3bev_cli.errors import MapError, unknown_name

_RANGE = re.compile(r"(?P<stem>.*?)(?P<first>\d+)\s*-\s*(?P<again>.*?)(?P<last>\d+)")


def parse_maps(text: str, available: Sequence[str], where: str = "--maps") -> list[str]:
    """`T1-T7`, `T1,T3`, `all` or a mixture -> names, each once, in the order written.

    Raises:
        MapError: a name that is not available, or nothing at all.
    """
    names = [name for part in _parts(text, where) for name in _expand(part, available, where)]
    return list(dict.fromkeys(names))


def parse_densities(text: str, available: Sequence[str], where: str = "--density") -> list[str]:
    """`low,high` or `all` -> names.

    Raises:
        MapError: a name that is not available, or nothing at all.
    """
    names: list[str] = []
    for part in _parts(text, where):
        names.extend(available if part == "all" else [_known("density", part, available, where)])
    return list(dict.fromkeys(names))


SETS = ("training", "evaluation")
"""A recipe's sets of weather, as `--weather` names them."""


def parse_weathers(
    text: str, available: Sequence[str], sets: Mapping[str, Sequence[str]], where: str = "--weather"
) -> list[str]:
    """`clear_noon,night`, `all`, `training`, `evaluation` or a mixture -> names, each once, in the order written.

    Args:
        sets: what the names of `SETS` stand for; empty without a recipe.

    Raises:
        MapError: a name that is not available, a set without a recipe, or nothing at all.
    """
    names: list[str] = []
    for part in _parts(text, where):
        if part in SETS and part not in sets and part not in available:
            hint = "Give --recipe or --run, or name the weather"
            raise MapError(f"there is no recipe that has a set for {part}", where=where, hint=hint)
        known = [*available, *sets, "all"]
        names.extend(sets.get(part) or (available if part == "all" else [_known("weather", part, known, where)]))
    return list(dict.fromkeys(names))


def shorten(names: Sequence[str]) -> str:
    """The names in as few words as `parse_maps` understands: `T1-T7` for T1, T2, ..., T7."""
    words = [re.fullmatch(r"(.*?)(\d+)", name) for name in names]
    if len(names) > 2 and all(words):
        stems = {word[1] for word in words if word}
        numbers = [int(word[2]) for word in words if word]
        if len(stems) == 1 and numbers == list(range(numbers[0], numbers[0] + len(numbers))):
            return f"{names[0]}-{names[-1]}"
    return ",".join(names)


def _parts(text: str, where: str) -> list[str]:
    parts = [part.strip() for part in text.split(",") if part.strip()]
    if not parts:
        raise MapError("no name is given", where=where)
    return parts


def _expand(part: str, available: Sequence[str], where: str) -> list[str]:
    if part == "all":
        return list(available)
    # A town's own name may hold a hyphen.
    found = None if part in available else _RANGE.fullmatch(part)
    if found is None:
        return [_known("map", part, available, where)]
    stem, first, last, digits = found["stem"], int(found["first"]), int(found["last"]), len(found["first"])
    if found["again"] not in ("", stem):
        raise MapError(f"the range '{part}' goes from one kind of name to another", where=where, allowed="as T1-T7")
    if last < first:
        raise MapError(
            f"the range '{part}' runs backwards",
            where=where,
            allowed=f"{found['again'] or stem}{found['last']}-{stem}{found['first']}",
        )
    return [_known("map", f"{stem}{number:0{digits}}", available, where) for number in range(first, last + 1)]


def _known(what: str, name: str, available: Sequence[str], where: str) -> str:
    if name in available:
        return name
    raise unknown_name(what, name, available, where=where, kind=MapError)
