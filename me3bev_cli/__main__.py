"""`python -m me3bev_cli` is the same as `me3bev`."""

from __future__ import annotations

from me3bev_cli.main import main

if __name__ == "__main__":
    main()
