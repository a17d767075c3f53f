"""What worker processes do in the tests of `parallel`."""

from __future__ import annotations

import os
import signal
from pathlib import Path

from me3bev_cli.errors import MapError, RecipeError, UserError, unknown_name


def square(number: int) -> int:
    return number * number


def whoami(_: int) -> tuple[int, str | None]:
    return os.getpid(), os.environ.get("OMP_NUM_THREADS")


def die_once(job: tuple[Path, int]) -> int:
    """Kills its own process the first time it sees a job whose number is odd."""
    folder, number = job
    mark = folder / str(number)
    if number % 2 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def die_always(_: int) -> None:
    os._exit(3)


def blunder(number: int) -> int:
    return number // 0


def refuse(kind: str) -> None:
    if kind == "recipe":
        raise RecipeError([UserError("first", where="a.yaml"), UserError("second")])
    raise unknown_name("map", "T33", ["T1", "T3"], where="--maps", kind=MapError)


def greet(number: int) -> int:
    print("greetings on stdout")
    return number


def unsendable(_: int) -> object:
    return lambda: None


class Counter:
    """Remembers, in each process, how many jobs it has seen."""

    def __init__(self) -> None:
        self.seen = 0

    def __call__(self, _: int) -> int:
        self.seen += 1
        return self.seen


def wait_for_ever(folder: Path) -> None:
    (folder / str(os.getpid())).touch()
    signal.pause()
