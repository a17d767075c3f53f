"""me3bev: build, train and compare end-to-end driving policies from declarative recipes."""

from __future__ import annotations

__version__ = "0.1.0"
