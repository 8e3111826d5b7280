"""Commands of a document, run as a reader runs them who pastes them into a terminal."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from tools.documents import ROOT


def paste(script: str, folder: Path, **options: float) -> str:
    """Run `script` in `folder`, which gets a link to samples/; returns its stdout.

    options : of the bakes that do not give them, in a gf-usd.toml.

    AssertionError where a command fails.
    """
    programs = folder / ".programs"
    programs.mkdir()
    for name, arguments in (("gf-usd", " -m gf_usd"), ("python", "")):
        program = programs / name
        program.write_text(f'#!/bin/sh\nexec "{sys.executable}"{arguments} "$@"\n')
        program.chmod(0o755)
    (folder / "samples").symlink_to(ROOT / "samples")
    table = "".join(f"{name} = {value}\n" for name, value in options.items())
    (folder / "gf-usd.toml").write_text(f"[bake]\n{table}")
    done = subprocess.run(
        ["bash", "-euxo", "pipefail", "-c", script],
        cwd=folder, check=False, capture_output=True, text=True,
        env={
            **os.environ,
            "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT),
        },
    )  # fmt: skip
    assert done.returncode == 0, f"{script}\n\nended with {done.returncode}:\n{done.stderr[-3000:]}"
    return done.stdout
