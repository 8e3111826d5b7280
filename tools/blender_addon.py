"""Pack the add-on for Blender as a zip to install.

    python tools/blender_addon.py [FOLDER]

Writes ID-VERSION.zip, named as in the add-on's manifest, into FOLDER (default: this one).  The same
files make the same bytes.
"""

from __future__ import annotations

import argparse
import tomllib
import zipfile
from pathlib import Path

SOURCE = Path(__file__).resolve().parent.parent / "integrations" / "blender" / "gf_usd_bake"
LONG_AGO = (1980, 1, 1, 0, 0, 0)  # the first date that a zip can hold


def pack(folder: Path) -> Path:
    """The zip, written into a folder."""
    manifest = tomllib.loads((SOURCE / "blender_manifest.toml").read_text(encoding="utf-8"))
    target = folder / f"{manifest['id']}-{manifest['version']}.zip"
    files = sorted(path for path in SOURCE.iterdir() if path.suffix in (".py", ".toml"))
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in files:
            entry = zipfile.ZipInfo(file.name, LONG_AGO)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, file.read_bytes())
    return target


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, nargs="?", default=Path(), help="default: this one")
    folder = parser.parse_args().folder
    if not folder.is_dir():
        parser.error(f"{folder} is no folder")
    print(pack(folder))


if __name__ == "__main__":
    main()
