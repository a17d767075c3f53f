"""The page itself: one HTML file from a template, with style and script in it; no request leaves it."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from typing import Any

from jinja2 import BaseLoader, Environment, StrictUndefined, TemplateNotFound
from markupsafe import Markup

from me3bev_cli.reporting.chart import colour


class _Parts(BaseLoader):
    """Templates from the package's data."""

    def get_source(self, environment: Environment, template: str) -> tuple[str, str | None, None]:
        try:
            return _text(template), None, None
        except FileNotFoundError:
            raise TemplateNotFound(template) from None


def _text(name: str) -> str:
    return files("me3bev_cli.reporting").joinpath("page", name).read_text(encoding="utf-8")


def render(context: Mapping[str, Any]) -> str:
    """The HTML of a report. Everything in `context` that is not Markup is escaped."""
    environment = Environment(
        loader=_Parts(), autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["colour"] = colour
    template = environment.get_template("page.html")
    return template.render(style=Markup(_text("style.css")), script=Markup(_text("script.js")), **context)
