"""Install the programs that play or validate the files of gf-usd, each into its own environment.

    python tools/clients.py install                       all of them, into .clients/
    python tools/clients.py install --only blender,newton --into DIR

They contain their own OpenUSD, so that none can share gf-usd's environment.  The tests that are
marked ``clients`` find them in ``.clients/``, or in the folder that ``GF_USD_CLIENTS`` names.  An
environment that already has the requested versions is not changed.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STAMP = "requirements.txt"
VERSION = "import sys; print(*sys.version_info[:2], sep='.')"


@dataclass(frozen=True)
class Client:
    """A program, as packages of PyPI, or of npm."""

    requirements: tuple[str, ...]
    proof: str  # Python, or JavaScript for Node.js, that must run once it is installed
    megabytes: int  # of its environment
    python: str | None = None  # the one version it runs on; None: any that gf-usd runs on
    libraries: tuple[str, ...] = ()  # Debian packages that it links to
    npm: bool = False


CLIENTS = {
    "validation": Client(
        ("usd-validation-nvidia[usd]>=1.22,<2",), "import usd_validation_nvidia", 240
    ),
    "newton": Client(
        # not newton[importers], which brings meshing and robot formats that are not read here
        ("newton>=1.8,<2", "newton-usd-schemas>=0.6,<1", "usd-core>=25.5,<26.9"),
        "import newton.usd",
        780,
    ),
    "splats": Client(
        # the converter has no release for Python 3.13 yet
        ("gsply[spz]>=0.4,<1", "usd-convert-gsplat[usd]>=0.1.15,<1; python_version < '3.13'"),
        "import gsply",
        540,
    ),
    "gltf": Client(
        ("gltf-validator@2.0.0-dev.3.10", "three@0.187.0"),
        "require('gltf-validator')",
        25,
        npm=True,
    ),
    "blender": Client(
        ("bpy>=5.2,<5.3",),
        "import bpy; print(bpy.app.version_string)",
        1_010,
        python="3.13",
        libraries=(
            *("libx11-6", "libgl1", "libxrender1", "libxfixes3", "libxi6"),
            *("libxkbcommon0", "libsm6", "libice6", "libxext6"),
        ),
    ),
}


SPACE = 1.5  # times the size of an environment: pip unpacks its packages next to it


class NotInstalled(Exception):
    """A client that could not be installed; the message says why and what to do."""


def main() -> None:
    """Install the requested clients; exit 1 with a message where one cannot be."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    install = commands.add_parser("install", help="create the environments")
    install.add_argument(
        "--only", default=",".join(CLIENTS), metavar="NAMES", help="default: %(default)s"
    )
    install.add_argument(
        "--into", type=Path, default=ROOT / ".clients", metavar="DIR", help="default: .clients"
    )
    install.add_argument(
        "--python", action="append", default=[], metavar="PROGRAM",
        help="a Python to use where its version fits; repeatable",
    )  # fmt: skip
    options = parser.parse_args()
    names = options.only.split(",")
    unknown = [name for name in names if name not in CLIENTS]
    if unknown:
        parser.error(f"unknown: {', '.join(unknown)} (choose from {', '.join(CLIENTS)})")
    failed = False
    for name in names:
        try:
            print(f"{name}: {set_up(name, options.into, options.python)}", flush=True)
        except NotInstalled as error:
            failed = True
            print(f"{name}: not installed: {error}", file=sys.stderr, flush=True)
    sys.exit(1 if failed else 0)


def set_up(name: str, into: Path, pythons: list[str]) -> str:
    """Create ``into/name`` with the client in it, and say how that went.

    Raises NotInstalled where no Python of the right version is found, the disk is too full, or pip
    or the proof fails.
    """
    client = CLIENTS[name]
    folder = into.resolve() / name
    stamp = folder / STAMP
    wanted = "\n".join(client.requirements) + "\n"
    if stamp.is_file() and stamp.read_text() == wanted:
        return f"is in {folder}"
    began = time.perf_counter()
    _require_space(client, into.resolve())
    if client.npm:
        _install_packages(client, folder)
        stamp.write_text(wanted)
        return f"installed into {folder} in {time.perf_counter() - began:.0f} s"
    python = find_python(client.python, pythons)
    shutil.rmtree(folder, ignore_errors=True)
    _run([python, "-m", "venv", str(folder)])
    own = str(folder / "bin" / "python")
    _run([own, "-m", "pip", "install", "--quiet", *client.requirements])
    try:
        _run([own, "-c", client.proof])
    except NotInstalled as error:
        if not client.libraries:
            raise
        raise NotInstalled(
            f"{error}\nhint: it links to libraries of the system; on Debian: apt-get install"
            f" {' '.join(client.libraries)}"
        ) from error
    stamp.write_text(wanted)
    return f"installed into {folder} in {time.perf_counter() - began:.0f} s"


def _require_space(client: Client, into: Path) -> None:
    """Raises NotInstalled where the disk of a folder, which may not exist yet, is too full."""
    there = next(folder for folder in (into, *into.parents) if folder.exists())
    free, needed = shutil.disk_usage(there).free / 1e6, SPACE * client.megabytes
    if free < needed:
        raise NotInstalled(
            f"{there}: {free:,.0f} MB of the disk are free, and {needed:,.0f} MB are needed\n"
            "hint: free some, or install into another disk with --into"
        )


def _install_packages(client: Client, folder: Path) -> None:
    """Packages of npm into ``folder/node_modules``; their proof runs there."""
    if not (shutil.which("npm") and shutil.which("node")):
        raise NotInstalled("npm was not found\nhint: on Debian: apt-get install npm")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    quiet = ("--no-audit", "--no-fund", "--loglevel=error")
    _run(["npm", "install", *quiet, "--prefix", str(folder), *client.requirements])
    _run(["node", "-e", client.proof.replace("'", f"'{folder}/node_modules/", 1)])


def find_python(version: str | None, named: list[str]) -> str:
    """A Python program of a version, for example "3.13".

    Tries those that are named, this one, those on PATH, and those of pyenv and uv.

    Raises NotInstalled where there is none.
    """
    if version is None:
        return sys.executable
    for candidate in [*named, sys.executable, *_elsewhere(version)]:
        try:
            done = subprocess.run(
                [candidate, "-c", VERSION], check=False, capture_output=True, text=True
            )
        except OSError:
            continue
        # a shim of pyenv is there for versions that are not switched on, and fails
        if done.returncode == 0 and done.stdout.strip() == version:
            return candidate
    raise NotInstalled(
        f"it runs on Python {version} only, and none was found\n"
        f"hint: install python{version} (pyenv install {version}, or uv python install {version}),"
        " or name one with --python"
    )


def _elsewhere(version: str) -> Iterator[str]:
    program = f"python{version}"
    found = shutil.which(program)
    if found:
        yield found
    home = Path.home()
    for pattern in (
        f".pyenv/versions/{version}*/bin/{program}",
        f".local/share/uv/python/cpython-{version}*/bin/{program}",
    ):
        yield from map(str, sorted(home.glob(pattern), reverse=True))


def _run(command: list[str]) -> None:
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    if done.returncode:
        message = (done.stderr or done.stdout).strip().splitlines()[-15:]
        raise NotInstalled("\n".join([f"{' '.join(command)} exited {done.returncode}", *message]))


if __name__ == "__main__":
    main()
