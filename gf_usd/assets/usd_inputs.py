"""The files that a USD asset is composed of."""

from __future__ import annotations

from pathlib import Path

from pxr import Ar, UsdUtils

from gf_usd.assets.usd_stage import reading


def usd_inputs(path: Path) -> tuple[list[Path], list[str]]:
    """(files, missing): every layer and asset that a file leads to, and what does not resolve.

    All variants, payloads, value clips and UDIM tiles count, whether selected or not.  What lies in
    a package is the package.  Raises InputError for a file that is damaged, or leads to one.
    """
    with reading(path):
        layers, assets, missing = UsdUtils.ComputeAllDependencies(str(path))
        names = [layer.realPath or layer.identifier for layer in layers] + list(assets)
    files = {Path(Ar.SplitPackageRelativePathOuter(name)[0]) for name in names}
    return sorted(file for file in files if file.is_file()), list(missing)
