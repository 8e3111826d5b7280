"""gf-usd as a program: where it is, which presets it has, and its errors.

Nothing here knows Blender.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

# with a capital where the command line itself is wrong
ERROR = re.compile(r"^[eE]rror: ", re.MULTILINE)
HINT = "set the path of gf-usd, or of a Python that has it, in the add-on's preferences"
# of a Python start-up; the first start of gf-usd on a cold disk is slow
PATIENCE = 60.0  # [s]


class ProgramError(Exception):
    """gf-usd cannot be run, or refused: `message` is what is wrong, `hint` what to do about it."""

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message, self.hint = message, hint


def find_program(named: str = "") -> list[str]:
    """The words that start gf-usd.

    named : path of gf-usd, or of a Python that has it; "": `gf-usd` on PATH, else the Python there.

    Raises ProgramError where neither is found.
    """
    if named:
        path = shutil.which(os.path.expanduser(named))
        if path is None:
            raise ProgramError(f"{named} is not a program", HINT)
        return [path, "-m", "gf_usd"] if Path(path).name.startswith("python") else [path]
    found = shutil.which("gf-usd")
    if found:
        return [found]
    for name in ("python3", "python"):
        python = shutil.which(name)
        if python and _run([python, "-c", "import gf_usd"]).returncode == 0:
            return [python, "-m", "gf_usd"]
    raise ProgramError("gf-usd is not on PATH", HINT)


def surroundings() -> dict[str, str]:
    """The environment for gf-usd: without what belongs to Blender's own Python and OpenUSD."""
    own = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "PXR_"))}
    return {**own, "PYTHONUTF8": "1"}


def list_materials(program: list[str]) -> list[tuple[str, str]]:
    """(name, what it is like) of every preset.

    Raises ProgramError where gf-usd does not say.
    """
    done = _run([*program, "materials", "--json"])
    if done.returncode:
        raise error_in(done.stderr)
    said = json.loads(done.stdout)
    looks = [(row["name"], row["note"]) for row in said["looks"]]
    return looks + [
        (row["name"], f"{row['youngs_modulus']:.3g} Pa, {row['density']:g} kg/m^3")
        for row in said["physical"]
    ]


def error_in(said: str) -> ProgramError:
    """The message and the hint of an error that gf-usd printed before it wrote any event."""
    starts = list(ERROR.finditer(said))
    if starts:
        message, _, hint = said[starts[-1].end() :].partition("\n\nhint: ")
        return ProgramError(message.strip(), hint.strip())
    lines = [line for line in said.splitlines() if line.strip()]
    # what a traceback ends with
    return ProgramError("\n".join(lines[-3:]) or "gf-usd ended without a message")


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            command, check=False, capture_output=True, encoding="utf-8", errors="replace",
            timeout=PATIENCE, env=surroundings(),
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ProgramError(f"{command[0]} does not run: {error}", HINT) from error
