"""YAML with the place of every value."""

from __future__ import annotations

from typing import Any

import pytest

from me3bev_cli.errors import RecipeError
from me3bev_cli.recipe_yaml import mark_of, plain, read_yaml, write_yaml


def read(text: str) -> Any:
    return plain(read_yaml(text, "a.yaml"))


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e-3", 0.001),
        ("1.5E+2", 150.0),
        ("4e5", 400_000),
        ("400_000", 400_000),
        ("010", "010"),
        ("-3", -3),
        (".5", 0.5),
        ("no", "no"),
        ("on", "on"),
        ("true", True),
        ("null", None),
        ("~", None),
        ("'1'", "1"),
        ("12:30", "12:30"),
        ("2024-01-01", "2024-01-01"),
        ("[1, [2.0, x]]", [1, [2.0, "x"]]),
    ],
)
def test_scalars_follow_yaml_1_2(text: str, value: Any) -> None:
    found = read(f"key: {text}")["key"]
    assert found == value
    assert type(found) is type(value)


def test_what_is_written_is_read_back_unchanged() -> None:
    data = {
        "words": ["no", "1e3", "4e5", "010", "null", "true", "", "T1", "a: b", "#", "é"],
        "numbers": [0, -1, 0.001, 1e-9, 1e300, 3.0, 2**40],
        "flags": [True, False, None],
        "deep": {"list": [{"a": [1]}, {}], "empty": []},
    }
    data["again"] = data["numbers"]
    assert read(write_yaml(data)) == data


def test_marks_are_the_lines_of_keys_and_items() -> None:
    tree = read_yaml("a:\n  b:\n    - 1\n    - c: 2\nd: {e: 3}\n", "a.yaml")
    for path, line in [(("a",), 1), (("a", "b"), 2), (("a", "b", 1), 4), (("a", "b", 1, "c"), 4), (("d", "e"), 5)]:
        assert str(mark_of(tree, path)) == f"a.yaml:{line}"
    assert str(mark_of(tree, ("a", "absent", "x"))) == "a.yaml:1"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a: 1\nb: 2\na: 3\n", "a.yaml:3: a: 'a' is set twice, first at a.yaml:1"),
        ("a:\n\tb: 1\n", "a.yaml:2: a tab cannot indent YAML. Use spaces"),
        ("a: [1\nb: 2\n", "a.yaml:2: not YAML: "),
        ("a: 1\n b: 2\n", "a.yaml:2: not YAML: mapping values are not allowed here"),
        ("a: &x 1\nb: *x\n", "a.yaml:2: not YAML: aliases are not read here; use extends"),
        ("a: !!python/object:os.system 1\n", "a.yaml:1: the tag tag:yaml.org,2002:python/object:os.system is not read"),
        ("a: 1\n---\nb: 2\n", "a.yaml:2: not YAML: but found another document"),
        ("[1]: 2\n", "a.yaml:1: a key must be a word"),
        ("a: \x00\n", "a.yaml: not YAML: "),
        ("a: !!int word\n", "a.yaml:1: 'word' is not a number"),
        ("[" * 5000, "a.yaml: nested too deeply to be a recipe"),
    ],
)
def test_what_is_no_yaml_is_said_with_its_line(text: str, message: str) -> None:
    with pytest.raises(RecipeError) as caught:
        read_yaml(text, "a.yaml")
    assert str(caught.value).startswith(message)


def test_all_duplicates_are_reported() -> None:
    with pytest.raises(RecipeError) as caught:
        read_yaml("a: 1\na: 2\nb: {c: 1, c: 2}\n", "a.yaml")
    assert [fault.where for fault in caught.value.faults] == ["a.yaml:2: a", "a.yaml:3: c"]
