"""Pin what CI installs, by version and hash: python tools/lock.py [--upgrade].

Makes `requirements.lock` from `pyproject.toml`, with all its extras and its build requirements, for
Python 3.11 to 3.13 on Linux, macOS and Windows.  It needs uv (`python -m pip install uv`) and a
package index; versions in the file are kept, unless --upgrade is given.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
LOCK = ROOT / "requirements.lock"
HEAD = """\
# Made by `python tools/lock.py` out of pyproject.toml: never edit it by hand.
# What CI installs, by version and hash, for Python 3.11 to 3.13; pip checks every hash.
"""
# pip builds without isolation what it installs by this file, so that nothing is left unpinned
BUILDS = ("editables",)  # of hatchling, for `pip install -e`


def main() -> int:
    """Resolve, and replace the file; exit status of uv."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--upgrade", action="store_true", help="take the newest versions")
    args = parser.parse_args()
    with (ROOT / "pyproject.toml").open("rb") as file:
        builds = [*tomllib.load(file)["build-system"]["requires"], *BUILDS]
    with tempfile.TemporaryDirectory() as scratch:
        more, made = Path(scratch) / "builds.txt", Path(scratch) / "made.lock"
        more.write_text("\n".join(builds) + "\n")
        if LOCK.exists():
            made.write_bytes(LOCK.read_bytes())  # uv keeps the versions that it finds there
        command = [
            *("uv", "pip", "compile", "pyproject.toml", str(more), "--all-extras", "--quiet"),
            *("--universal", "--python-version", "3.11", "--generate-hashes", "--no-annotate"),
            *("--no-header", "--no-emit-index-url", "--no-emit-find-links", "-o", str(made)),
            *(["--upgrade"] if args.upgrade else []),
        ]
        try:
            done = subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, check=False)
        except FileNotFoundError:
            print("there is no uv: python -m pip install uv", file=sys.stderr)
            return 1
        if done.returncode == 0:
            LOCK.write_text(HEAD + made.read_text())
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
