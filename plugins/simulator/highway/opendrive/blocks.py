"""Stretches of parallel driving lanes: lane sections and roads that follow one another one to one are one block."""

from __future__ import annotations

from dataclasses import dataclass

from me3bev_plugins.simulator.highway.opendrive.graph import Links
from me3bev_plugins.simulator.highway.opendrive.records import Document
from me3bev_plugins.simulator.highway.opendrive.shapes import Key, SectionShape

SHORTEST = 0.05
"""Metres; shorter pieces of lane are joined through."""
CLOSED = 0.6
"""Metres of width under which a lane has not opened yet, or has closed."""

Shapes = dict[tuple[str, int], SectionShape]


@dataclass(frozen=True)
class Block:
    """Parallel lanes of one direction, from the middle outwards: `chains[lane]` are its pieces in driving order."""

    chains: tuple[tuple[Key, ...], ...]


def predecessors(links: Links) -> Links:
    """The same links, seen from their ends."""
    before: Links = {key: [] for key in links}
    for key, targets in links.items():
        for target in targets:
            before[target].append(key)
    return before


def join_through_short(links: Links, shapes: Shapes) -> Links:
    """Take out pieces under 5 cm; what led to them leads to what they led to."""
    links = {key: list(targets) for key, targets in links.items()}
    before = predecessors(links)
    for key in list(links):
        if shapes[key[:2]].section.length >= SHORTEST:
            continue
        for source in before[key]:
            links[source].remove(key)
        for target in links[key]:
            before[target].remove(key)
        for source in before[key]:
            for target in links[key]:
                if source != key and target != key and target not in links[source]:
                    links[source].append(target)
                    before[target].append(source)
        del links[key], before[key]
    return links


Tapers = frozenset[tuple[Key, int]]
"""(piece, 0 for its start or -1 for its end) of the ends that were led into a neighbour."""


def branch_tapers(links: Links, shapes: Shapes) -> tuple[Links, Tapers]:
    """A lane that opens beside another branches from what leads to it; one that closes merges into what follows it.

    Without this a pocket that widens from nothing could be reached by a change of lane only.

    Returns:
        The links, and the ends that now lie beside their joint rather than at it.
    """
    tapers: set[tuple[Key, int]] = set()
    links = {key: list(targets) for key, targets in links.items()}
    before = predecessors(links)
    for key in list(links):
        shape, lane = shapes[key[:2]], key[2]
        width = shape.width(lane)
        first, last = (width[0], width[-1]) if lane < 0 else (width[-1], width[0])
        beside = [n for step in (-1, 1) if (n := (key[0], key[1], lane + step)) in links and n[2] * lane > 0]
        if not before[key] and first < CLOSED:
            for source in next((before[n] for n in beside if before[n]), []):
                links[source].append(key)
                before[key].append(source)
                tapers.add((key, 0))
        if not links[key] and last < CLOSED:
            for target in next((links[n] for n in beside if links[n]), []):
                links[key].append(target)
                before[target].append(key)
                tapers.add((key, -1))
    return links, frozenset(tapers)


def find_blocks(document: Document, links: Links) -> list[Block]:
    """Every driving lane in exactly one block."""
    groups: dict[tuple[str, int, int], list[Key]] = {}
    for key in sorted(links, key=lambda key: abs(key[2])):
        groups.setdefault(_group(key), []).append(key)
    groups = {group: groups[group] for group in dict.fromkeys(_group(key) for key in links)}
    before = predecessors(links)
    following = {
        group: after
        for group, keys in groups.items()
        if (after := _continues(document, keys, groups, links, before)) is not None
    }
    blocks: list[Block] = []
    done: set[tuple[str, int, int]] = set()
    led_to = set(following.values())
    heads = [group for group in groups if group not in led_to]
    # What no head leads to is a closed ring: a block for each of its roads, so that no lane follows itself.
    rings = [after for group, after in following.items() if after[0] != group[0]]
    for head in [*heads, *rings, *groups]:
        run: list[list[Key]] = []
        group: tuple[str, int, int] | None = head
        while group is not None and group not in done:
            done.add(group)
            run.append(groups[group])
            group = following.get(group)
            if group is not None and head in led_to and group[0] != head[0]:
                break
        if run:
            blocks.append(Block(tuple(zip(*run, strict=True))))
    return blocks


def _group(key: Key) -> tuple[str, int, int]:
    return key[0], key[1], 1 if key[2] > 0 else -1


def _continues(
    document: Document,
    keys: list[Key],
    groups: dict[tuple[str, int, int], list[Key]],
    links: Links,
    before: Links,
) -> tuple[str, int, int] | None:
    """The group that carries on all lanes of this one, in order and alone."""
    if any(len(links[key]) != 1 for key in keys):
        return None
    targets = [links[key][0] for key in keys]
    group = _group(targets[0])
    if targets != groups[group] or any(len(before[target]) != 1 for target in targets):
        return None
    if [a[2] - keys[0][2] for a in keys] != [
        (b[2] - targets[0][2]) * (1 if a[2] * b[2] > 0 else -1) for a, b in zip(keys, targets, strict=True)
    ]:
        return None
    here, there = document.roads[keys[0][0]], document.roads[group[0]]
    if here is not there and (here.junction or there.junction):
        return None
    same = here.limit(here.sections[keys[0][1]].start) == there.limit(there.sections[group[1]].start)
    return group if same or here.junction else None
