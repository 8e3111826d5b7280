"""``python -m gf_usd``."""

from gf_usd.cli.main import run

if __name__ == "__main__":
    run()
