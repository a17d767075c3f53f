"""YAML to a tree that remembers the file and line of every value, and back.

Scalars follow YAML 1.2's core schema: `1e-3` is a number, `no` and `on` are words. Aliases, tags and duplicate
keys are faults.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import yaml

from me3bev_cli.errors import RecipeError, UserError

Path = tuple[str | int, ...]
"""Keys and list indices from the top of a recipe."""


@dataclass(frozen=True)
class Mark:
    """Where a value was written: a file and a line, or an option."""

    source: str
    line: int | None = None

    def __str__(self) -> str:
        return self.source if self.line is None else f"{self.source}:{self.line}"


@dataclass(frozen=True)
class Node:
    """A value and the place where its key (or list item) begins."""

    value: Any
    """A dict of nodes, a list of nodes, or a scalar."""
    mark: Mark


def plain(node: Node) -> Any:
    """The values without their marks."""
    if isinstance(node.value, dict):
        return {key: plain(child) for key, child in node.value.items()}
    if isinstance(node.value, list):
        return [plain(child) for child in node.value]
    return node.value


def mark_of(node: Node, path: Path) -> Mark:
    """The mark of the value at `path`, or of the deepest block around it that exists."""
    for segment in path:
        inside = isinstance(node.value, dict) and segment in node.value
        if not inside and not (isinstance(node.value, list) and segment in range(len(node.value))):
            break
        node = node.value[segment]
    return node.mark


def dotted(path: Path) -> str:
    """A path as it is written after `--set`."""
    return ".".join(str(segment) for segment in path)


INT, FLOAT, BOOL, NULL, STR = (f"tag:yaml.org,2002:{name}" for name in ("int", "float", "bool", "null", "str"))

_POWER = r"[eE][-+]?[0-9]+"
_SCALARS = (
    (BOOL, re.compile(r"^(?:true|True|TRUE|false|False|FALSE)$"), "tTfF"),
    (INT, re.compile(r"^[-+]?(?:0|[1-9][0-9_]*)$"), "-+0123456789"),
    (
        FLOAT,
        re.compile(rf"^[-+]?(?:[0-9][0-9_]*(?:\.[0-9]*)?{_POWER}|[0-9][0-9_]*\.[0-9]*|\.[0-9]+(?:{_POWER})?)$"),
        "-+.0123456789",
    ),
    (NULL, re.compile(r"^(?:~|null|Null|NULL|)$"), ["~", "n", "N", ""]),
)


class _Loader(yaml.SafeLoader):
    yaml_implicit_resolvers: dict[str, list[tuple[str, re.Pattern[str]]]] = {}

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark  # type: ignore[no-untyped-call]
            raise yaml.composer.ComposerError(None, None, "aliases are not read here; use extends", mark)
        return super().compose_node(parent, index)


class _Dumper(yaml.SafeDumper):
    """Quotes whatever either reading of YAML, ours or version 1.1's, would not take for a string."""

    yaml_implicit_resolvers = dict(yaml.SafeDumper.yaml_implicit_resolvers)

    def ignore_aliases(self, data: Any) -> bool:
        return True


for _tag, _pattern, _first in _SCALARS:
    _Loader.add_implicit_resolver(_tag, _pattern, list(_first))
    _Dumper.add_implicit_resolver(_tag, _pattern, list(_first))


def read_yaml(text: str, source: str, *, lines: bool = True) -> Node:
    """The tree of one document.

    Args:
        text: the document.
        source: what to call it in messages.
        lines: whether marks say the line.

    Raises:
        RecipeError: every duplicate key or tag, or the first syntax error.
    """
    faults: list[UserError] = []
    try:
        root = yaml.compose(text, Loader=_Loader)
        tree = _Converter(source, lines, faults).convert(root) if root is not None else Node(None, Mark(source))
    except yaml.YAMLError as error:
        raise RecipeError([_syntax_fault(error, source, lines)]) from None
    except RecursionError:
        raise RecipeError([UserError("nested too deeply to be a recipe", where=source)]) from None
    if faults:
        raise RecipeError(faults)
    return tree


def _syntax_fault(error: yaml.YAMLError, source: str, lines: bool) -> UserError:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    where = f"{source}:{mark.line + 1}" if mark is not None and lines else source
    what = getattr(error, "problem", None) or str(error).splitlines()[0]
    if "'\\t'" in what:
        return UserError("a tab cannot indent YAML", where=where, hint="Use spaces")
    return UserError(f"not YAML: {what}", where=where)


class _Converter:
    def __init__(self, source: str, lines: bool, faults: list[UserError]) -> None:
        self.source, self.lines, self.faults = source, lines, faults

    def convert(self, node: yaml.Node, at: yaml.Node | None = None) -> Node:
        """`at` is the key that holds the node: a block's own mark is a line later."""
        start = (at or node).start_mark
        mark = Mark(self.source, start.line + 1 if self.lines else None)
        if isinstance(node, yaml.MappingNode):
            return Node(self._mapping(node), mark)
        if isinstance(node, yaml.SequenceNode):
            return Node([self.convert(child) for child in node.value], mark)
        return Node(self._scalar(node, mark), mark)

    def _mapping(self, node: yaml.MappingNode) -> dict[str, Node]:
        entries: dict[str, Node] = {}
        for key, value in node.value:
            child = self.convert(value, at=key)
            if not isinstance(key, yaml.ScalarNode):
                self.faults.append(UserError("a key must be a word", where=str(child.mark)))
            elif key.value in entries:
                first = entries[key.value].mark
                self.faults.append(
                    UserError(f"'{key.value}' is set twice, first at {first}", where=f"{child.mark}: {key.value}")
                )
            else:
                entries[key.value] = child
        return entries

    def _scalar(self, node: yaml.Node, mark: Mark) -> Any:
        text, tag = str(node.value), node.tag
        try:
            if tag == INT:
                return int(text.replace("_", ""))
            if tag == FLOAT:
                return _number(text.replace("_", ""))
        except ValueError:
            self.faults.append(UserError(f"'{text}' is not a number", where=str(mark)))
            return None
        if tag == BOOL:
            return text.lower() == "true"
        if tag == NULL:
            return None
        if tag != STR:
            self.faults.append(UserError(f"the tag {tag} is not read here", where=str(mark)))
        return text


def _number(text: str) -> float | int:
    """A float; but a whole number that is written with an exponent (4e5 steps) is an int."""
    value = float(text)
    return int(value) if "." not in text and value.is_integer() and abs(value) < 2**53 else value


def write_yaml(data: Any) -> str:
    """Plain data as YAML that `read_yaml` reads back unchanged; short blocks stay on one line."""
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=110, allow_unicode=True)
