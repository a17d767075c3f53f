"""What pydantic says about a block of a recipe, in the words of a recipe: which key, what is wrong, what is allowed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails, to_json

from me3bev_cli.errors import UserError, did_you_mean
from me3bev_cli.recipe_yaml import Node, Path, dotted, mark_of


@dataclass(frozen=True)
class Fault:
    """One fault at a key of a recipe, before it is known in which file and line that key stands."""

    path: Path
    what: str
    allowed: str | None = None
    hint: str | None = None
    missing: bool = False
    """A key that is not there: it may be in a file that could not be read."""

    def located(self, tree: Node | None = None) -> UserError:
        """As an error that says file, line and key; the key only without a tree."""
        where = ": ".join(text for text in (str(mark_of(tree, self.path)) if tree else "", dotted(self.path)) if text)
        return UserError(self.what, where=where or None, allowed=self.allowed, hint=self.hint)


def validate(model: type[BaseModel], data: Any, prefix: Path = (), *, nulls: bool = False) -> tuple[Any, list[Fault]]:
    """`data` (plain values as YAML gives them) as a `model`, or every fault in it.

    Values are not coerced: `"12"` and `true` are no numbers. A null for a key that cannot be null removes the key,
    unless `nulls` keeps it.
    """
    data = data if nulls else _drop_nulls(data, model)
    try:
        return model.model_validate_json(to_json(data), strict=True), []
    except ValidationError as error:
        return None, _faults(error, model, data, prefix)


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


def _models_for(annotation: Any, data: Any) -> list[type[BaseModel]]:
    """The models that a value of this type may be; where `kind` tells them apart, the one that it names."""
    models = list(_models_in(annotation))
    if len(models) > 1 and isinstance(data, dict):
        return [m for m in models if data.get("kind") in _kinds(m)] or models
    return models


def _kinds(model: type[BaseModel]) -> tuple[Any, ...]:
    field = model.model_fields.get("kind")
    return get_args(field.annotation) if field is not None else ()


def _nullable(annotation: Any) -> bool:
    return annotation in (None, Any, type(None)) or any(_nullable(argument) for argument in get_args(annotation))


def _drop_nulls(data: Any, model: type[BaseModel]) -> Any:
    """Without the keys whose value is null where null is not a value: what a recipe extends is undone that way."""
    if not isinstance(data, Mapping):
        return data
    kept = {}
    for key, value in data.items():
        field = model.model_fields.get(key)
        if field is None:
            kept[key] = value
        elif value is not None:
            kept[key] = _drop_nulls_below(value, field.annotation)
        elif _nullable(field.annotation):
            kept[key] = None
    return kept


def _drop_nulls_below(value: Any, annotation: Any) -> Any:
    if isinstance(value, list | tuple):
        return [_drop_nulls_below(item, annotation) for item in value]
    models = _models_for(annotation, value)
    return _drop_nulls(value, models[0]) if len(models) == 1 else value


def _faults(error: ValidationError, model: type[BaseModel], data: Any, prefix: Path) -> list[Fault]:
    details = error.errors(include_url=False)
    found: dict[Path, Fault] = {}
    for detail in details:
        path = _path(detail, data)
        # pydantic also counts the items that failed as absent.
        if detail["type"] == "too_short" and len(_value(data, path)) >= detail["ctx"]["min_length"]:
            continue
        fault = _describe(detail, path, model, data)
        other = found.get(path)
        if other is not None and other.what != fault.what:
            # A union: each of its members has something to say.
            fault = Fault(path, f"{other.what}; or {fault.what}", other.allowed or fault.allowed)
        found[path] = fault
    return [replace(fault, path=(*prefix, *fault.path)) for fault in found.values()]


def _path(detail: ErrorDetails, data: Any) -> Path:
    """The location without the names of union members that pydantic puts in it."""
    path: list[str | int] = []
    location = detail["loc"]
    for index, segment in enumerate(location):
        inside = isinstance(data, dict) and segment in data
        inside |= isinstance(data, list) and isinstance(segment, int) and segment < len(data)
        if inside:
            data = data[segment]
            path.append(segment)
        elif index == len(location) - 1 and detail["type"] == "missing":
            path.append(segment)
    if detail["type"] in ("union_tag_invalid", "union_tag_not_found"):
        path.append("kind")
    return tuple(path)


def _value(data: Any, path: Path) -> Any:
    for segment in path:
        data = data[segment]
    return data


def _keys_at(model: type[BaseModel], data: Any, path: Path) -> list[str]:
    """Keys that the block at `path` takes."""
    models = [model]
    for segment in path:
        data = data[segment]
        if isinstance(segment, str):
            fields = [m.model_fields[segment].annotation for m in models if segment in m.model_fields]
            models = [m for annotation in fields for m in _models_for(annotation, data)]
        elif len(models) > 1:
            models = [m for m in models if isinstance(data, dict) and data.get("kind") in _kinds(m)] or models
    return list(dict.fromkeys(key for m in models for key in m.model_fields))


_EXPECTED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "int_parsing": "a whole number",
    "float_type": "a number",
    "float_parsing": "a number",
    "string_type": "a word",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "tuple_type": "a list",
    "list_type": "a list",
    "dict_type": "a block of keys",
    "model_type": "a block of keys",
    "model_attributes_type": "a block of keys",
    "none_required": "null",
}

_BOUNDS = {
    "greater_than": ("gt", "> {}"),
    "greater_than_equal": ("ge", ">= {}"),
    "less_than": ("lt", "< {}"),
    "less_than_equal": ("le", "<= {}"),
}


def _describe(detail: ErrorDetails, path: Path, model: type[BaseModel], data: Any) -> Fault:
    kind, context, value = detail["type"], detail.get("ctx", {}), detail["input"]
    if kind == "missing":
        entry = f"entry {path[-1]}" if isinstance(path[-1], int) else f"'{path[-1]}'"
        return Fault(path, f"{entry} is missing", missing=True)
    if kind == "union_tag_not_found":
        return Fault(path, "'kind' is missing", missing=True)
    if kind == "extra_forbidden":
        keys = _keys_at(model, data, path[:-1])
        question = did_you_mean(str(path[-1]), keys)
        return Fault(path, _asking(f"unknown key '{path[-1]}'", question), ", ".join(keys) or "no keys")
    if kind in ("literal_error", "enum", "union_tag_invalid"):
        return _choice_fault(path, context, value)
    if kind in _EXPECTED:
        hint = f"Write {{name: {value}}}" if kind == "model_type" and path[-1:] in _PLUGIN_BLOCKS else None
        return Fault(path, f"expected {_EXPECTED[kind]}, got {_shown(value)}", hint=hint)
    if kind in _BOUNDS:
        key, text = _BOUNDS[kind]
        return Fault(path, f"{_shown(value)} is out of range", text.format(context[key]))
    if kind == "too_short":
        return Fault(path, f"needs at least {context['min_length']}, has {context['actual_length']}")
    if kind == "string_pattern_mismatch":
        return Fault(path, f"{_shown(value)} is not of the right form", f"what matches {context['pattern']}")
    if kind == "value_error":
        return Fault(path, str(context["error"]))
    return Fault(path, f"{detail['msg'][:1].lower()}{detail['msg'][1:]}, got {_shown(value)}")


_PLUGIN_BLOCKS = tuple((key,) for key in ("simulator", "spatial", "temporal", "fusion"))


def _choice_fault(path: Path, context: Mapping[str, Any], value: Any) -> Fault:
    if "tag" in context:
        value, allowed = context["tag"], str(context["expected_tags"])
    else:
        allowed = str(context["expected"]).replace(" or ", ", ")
    options = [word.strip().strip("'") for word in allowed.split(",")]
    question = did_you_mean(value, options) if isinstance(value, str) else None
    return Fault(path, _asking(f"{_shown(value)} is not among the choices", question), ", ".join(options))


def _asking(text: str, question: str | None) -> str:
    return f"{text}; {question}" if question else text


def _shown(value: Any) -> str:
    if isinstance(value, dict):
        return "a block of keys"
    if isinstance(value, list | tuple):
        return "a list"
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    return f"'{value}'" if isinstance(value, str) else str(value)
