"""highway-env comes without the plotting that it imports, and gets it when it wants it."""

from __future__ import annotations

import subprocess
import sys

SCRIPT = """
import sys
import me3bev_plugins.simulator.highway.env
print([name for name in ("matplotlib", "matplotlib.pyplot", "pandas") if name in sys.modules])
from highway_env.envs.common import observation
from highway_env.vehicle import dynamics
print(observation.pd.DataFrame.__module__, dynamics.plt.subplots.__module__)
import matplotlib.pyplot
print(matplotlib.pyplot.subplots is dynamics.plt.subplots, "matplotlib.pyplot" in sys.modules)
import gymnasium
gymnasium.make("highway-v0", config={"vehicles_count": 2}).reset(seed=0)
"""

LOADED = """
import sys, matplotlib, pandas
import me3bev_plugins.simulator.highway.stock
print(matplotlib.rcParams is not None, sys.modules["pandas"] is pandas)
"""


def run(code: str) -> list[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.splitlines()


def test_plotting_is_put_off_until_it_is_wanted() -> None:
    lines = run(SCRIPT)
    assert lines[-3:] == ["[]", "pandas matplotlib.pyplot", "True True"]


def test_what_is_loaded_already_stays() -> None:
    assert run(LOADED)[-1] == "True True"
