"""How much memory there is to be had."""

from __future__ import annotations

from pathlib import Path

import torch

_GROUPS = (("memory.max", "memory.current", "inactive_file"), ("memory.limit_in_bytes", "memory.usage_in_bytes", ""))
"""A control group's limit, what it uses, and what of that is only a cache; of both versions."""


def available_memory(proc: Path = Path("/proc/meminfo"), groups: Path = Path("/sys/fs/cgroup")) -> int | None:
    """Bytes that processes can still take here, also by the limit of a container; None where nobody tells."""
    found = [limit for limit in (_system(proc), *_control_groups(groups)) if limit is not None]
    return min(found) if found else None


def available_on(device: torch.device) -> int | None:
    """Bytes that are free on a GPU, with what torch has put aside there; of any other device those of the system."""
    if device.type != "cuda":
        return available_memory()
    free, _ = torch.cuda.mem_get_info(device)
    return free + torch.cuda.memory_reserved(device) - torch.cuda.memory_allocated(device)


def _system(proc: Path) -> int | None:
    try:
        lines = dict(line.split(":", 1) for line in proc.read_text().splitlines() if ":" in line)
        return 1024 * int(lines["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError):
        return None


def _control_groups(root: Path) -> list[int]:
    """What the control groups that are mounted here leave; a container sees its own at the root."""
    found = []
    for folder in (root, root / "memory"):
        for limit, used, cache in _GROUPS:
            try:
                left = int((folder / limit).read_text()) - int((folder / used).read_text())
                found.append(left + _cached(folder, cache))
            except (OSError, ValueError):  # "max": there is no limit.
                continue
    return found


def _cached(folder: Path, key: str) -> int:
    try:
        rows = dict(line.split(" ", 1) for line in (folder / "memory.stat").read_text().splitlines())
        return int(rows.get(key or "total_inactive_file", 0))
    except (OSError, ValueError):
        return 0
