"""The JSON Schema of recipes as installed: the core's schema with each plugin's keys, for editors to complete from."""

from __future__ import annotations

from typing import Any

from me3bev_cli import registry
from me3bev_cli.errors import PluginError
from me3bev_cli.recipe import Recipe
from me3bev_cli.recipe_check import BLOCKS


def recipe_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a recipe file.

    Nothing is required at the top, since a file that extends another need not repeat it. A plugin that does not
    import is left with its name and any keys.
    """
    schema = Recipe.model_json_schema()
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema"
    schema["title"] = "me3bev recipe"
    schema.pop("required", None)
    schema["properties"]["extends"] = {
        "type": "string",
        "description": "a shipped recipe's name, or a file relative to this one",
    }
    definitions = schema.setdefault("$defs", {})
    for kind in BLOCKS:
        choices = [_plugin(kind, name, definitions) for name in registry.names(kind)]
        nullable = [{"type": "null"}] if Recipe.model_fields[kind].default is None else []
        schema["properties"][kind] = {"anyOf": [*choices, *nullable]}
    definitions.pop("PluginChoice", None)
    definitions.pop("SimulatorChoice", None)
    return schema


def _plugin(kind: str, name: str, definitions: dict[str, Any]) -> dict[str, Any]:
    """The schema of one plugin's block; models nested in its config go to `definitions` under their own names."""
    declared = BLOCKS[kind].model_json_schema()["properties"]
    block: dict[str, Any] = {"type": "object", "required": ["name"], "title": f"{kind}: {name}"}
    try:
        model = registry.config_class(kind, name)
    except PluginError:
        block["properties"] = declared | {"name": {"const": name}}
        return block
    prefix = f"{kind}.{name}."
    own = model.model_json_schema(ref_template=f"#/$defs/{prefix}{{model}}")
    definitions.update({prefix + key: value for key, value in own.pop("$defs", {}).items()})
    block["properties"] = declared | own.get("properties", {}) | {"name": {"const": name}}
    block["additionalProperties"] = False
    if "description" in own:
        block["description"] = own["description"]
    return block
