"""Fingerprint of the program: its source, its schema, and its libraries."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path
from typing import Any

PACKAGE = Path(__file__).resolve().parent.parent
SCHEMA = "generatedSchema.usda"
APART = ("batch", "delivery", "fitting", "verify", "view")  # not used by bakes
# libraries whose versions may round or write differently
LIBRARIES = ("usd-core", "taichi", "numpy", "scipy", "trimesh", "libigl", "pillow")


@cache
def program() -> dict[str, Any]:
    """The fingerprint: a hash of the source, one of the schema, and versions of libraries."""
    schemas = (PACKAGE / "schemas", PACKAGE.parent / "schemas")
    schema = next((p for folder in schemas for p in folder.glob(f"*/{SCHEMA}")), None)
    return {
        "code": _hash_files(_sources(), PACKAGE),
        "schema": _hash_files([schema], schema.parent) if schema else "",
        "libraries": {name: _version(name) for name in LIBRARIES},
    }


def _sources() -> list[Path]:
    files = sorted(PACKAGE.rglob("*.py"))
    return [file for file in files if file.relative_to(PACKAGE).parts[0] not in APART]


def _version(name: str) -> str:
    # a slow import, which a bake without checkpoints does not need
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(name)
    except PackageNotFoundError:
        return ""


def _hash_files(files: list[Path], folder: Path) -> str:
    content = hashlib.sha256()
    for file in files:
        content.update(file.relative_to(folder).as_posix().encode() + b"\0")
        content.update(hashlib.sha256(file.read_bytes()).digest())
    return content.hexdigest()
