"""``python -m gf_usd``."""

from __future__ import annotations

from gf_usd.cli.main import run

if __name__ == "__main__":
    run()
