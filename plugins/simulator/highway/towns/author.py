"""Write the towns' OpenDRIVE files anew: `python -m me3bev_plugins.simulator.highway.towns.author [T3 ...]`."""

from __future__ import annotations

import gzip
import sys
from importlib import import_module
from pathlib import Path

from me3bev_plugins.simulator.highway.towns.network import build
from me3bev_plugins.simulator.highway.towns.streets import Layout
from me3bev_plugins.simulator.highway.towns.writer import write

NAMES = ("T1", "T2", "T3", "T4", "T5", "T6", "T7")


def layout(name: str) -> Layout:
    """The layout of a town, from the module named after it."""
    module = import_module(f"me3bev_plugins.simulator.highway.towns.{name.lower()}")
    made: Layout = module.layout()
    return made


def author(name: str) -> bytes:
    """The compressed OpenDRIVE file of a town; the same bytes every time."""
    return gzip.compress(write(build(layout(name))), compresslevel=9, mtime=0)


def main(names: list[str]) -> None:
    """Write the named towns, or all, next to this file."""
    for name in names or NAMES:
        path = Path(__file__).parent / f"{name}.xodr.gz"
        path.write_bytes(author(name))
        print(f"{path}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main(sys.argv[1:])
