"""Reader of FBX files by the external program usd-convert-asset, where it is installed.

The program has its own OpenUSD, and runs in a separate process.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

from pxr import Tf, Usd

from gf_usd.core.asset import OPTION
from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.data import refuse_pointer
from gf_usd.readers.mesh.to_usd import Folder, MeshSource, record_of
from gf_usd.readers.notes import source_of, unit_and_axis

PROGRAM = "usd-convert-asset"
PATIENCE = 600  # [s] for one conversion
HINT = (
    f"install {PROGRAM} (pip install {PROGRAM}, Python 3.12, in a separate environment) and put "
    f"it on PATH, or export the asset as glb or obj"
)


def convert_fbx(
    path: Path, *, meters_per_unit: float | None = None, up_axis: str | None = None
) -> MeshSource:
    """The USD layer of an FBX file, flattened.

    Raises InputError where the program is missing, fails, takes longer than ten minutes or writes
    no valid USD.
    """
    with path.open("rb") as file:
        refuse_pointer(path, file.read(512))
    program = shutil.which(PROGRAM)
    if program is None:
        raise InputError(f"{path}: reading FBX requires {PROGRAM}, which is not on PATH", HINT)
    folder = Folder()
    folder.pictures.mkdir()
    # The program writes images into a folder below its result.
    made = folder.pictures / "converted.usdc"
    command = [program, "-i", str(path.absolute()), "-o", str(made), "--preview-surface"]
    try:
        done = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=PATIENCE, check=False
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InputError(f"{path}: {PROGRAM} could not be run: {error}", HINT) from error
    if done.returncode != 0 or not made.is_file():
        output = (done.stderr or done.stdout).strip().splitlines()
        raise InputError(
            f"{path}: {PROGRAM} failed with status {done.returncode}"
            + (f": {output[-1]}" if output else ""),
            "check that the file opens in another program, or export the asset as glb or obj",
        )
    _flatten(path, made, folder.layer, meters_per_unit, up_axis)
    unit_from, axis_from = source_of(meters_per_unit, True), source_of(up_axis, True)
    output = unit_and_axis("FBX", meters_per_unit or 0.0, up_axis or "", unit_from, axis_from)
    sources = {"unit_from": unit_from, "axis_from": axis_from}
    return MeshSource(
        path,
        folder,
        record_of(path, [path], meters_per_unit, up_axis),
        (f"FBX was converted by {PROGRAM}", *output),
        {name: origin for name, origin in sources.items() if origin == OPTION},
    )


def _flatten(
    path: Path, made: Path, target: Path, meters_per_unit: float | None, up_axis: str | None
) -> None:
    """Flatten the program's result into one layer, and remove all other files but images."""
    try:
        flat = Usd.Stage.Open(str(made), Usd.Stage.LoadAll).Flatten()
    except Tf.ErrorException as error:
        raise InputError(f"{path}: the output of {PROGRAM} is not a USD file", HINT) from error
    if meters_per_unit is not None:
        flat.pseudoRoot.SetInfo("metersPerUnit", float(meters_per_unit))
    if up_axis is not None:
        flat.pseudoRoot.SetInfo("upAxis", up_axis)
    flat.Export(str(target))
    for layer in made.parent.rglob("*.usd*"):
        layer.unlink()
