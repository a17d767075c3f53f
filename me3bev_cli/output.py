"""What a command prints: tables for people, and the same figures as JSON where `--json FILE|-` asks for them."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

from me3bev_cli.files import atomic_write_text

if TYPE_CHECKING:
    from rich.console import Console

STDOUT = "-"


def console(json_target: str | None = None) -> Console:
    """Where people's output goes: stdout, or stderr when stdout is taken by JSON. Plain and wide in a pipe."""
    from rich.console import Console

    stream = sys.stderr if json_target == STDOUT else sys.stdout
    return Console(file=stream, width=None if stream.isatty() else 160, highlight=False)


def write_json(data: Any, target: str) -> None:
    """Write `data` to a file, whole or not at all, or to stdout for `-`.

    Numbers that JSON does not know (NaN, infinities) become null.

    Raises:
        UserError: the file cannot be written.
    """
    text = json.dumps(_finite(data), indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    if target == STDOUT:
        sys.stdout.write(text)
        sys.stdout.flush()
    else:
        atomic_write_text(target, text)


def _finite(data: Any) -> Any:
    if isinstance(data, dict):
        return {str(key): _finite(value) for key, value in data.items()}
    if isinstance(data, list | tuple):
        return [_finite(value) for value in data]
    if hasattr(data, "item") and not isinstance(data, str | bytes):
        # A number of numpy or torch, without importing either.
        data = data.item()
    if isinstance(data, float) and (data != data or data in (float("inf"), float("-inf"))):
        return None
    return data
