"""One file instead of layers: a bake flattened with its source, as a layer or a usdz package.

What is selected is what is kept: the baked look, and the variants of the source as they are chosen.
The display variants are made again, so that the file still switches between its shapes.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

from pxr import Sdf, Tf, Usd, UsdUtils

from gf_usd.choices import Choices
from gf_usd.model import Asset
from gf_usd.publish import partial_path
from gf_usd.usd.dependencies import Beside, Package, anchor_tiles, refused
from gf_usd.usd.layout import RootSummary
from gf_usd.usd.stage import find_home, open_source
from gf_usd.usd.variants import hidden

PACKAGE = ".usdz"
NOWHERE = "nowhere"


def write_flat(
    path: Path,
    root: RootSummary,
    asset: Asset,
    *,
    source: Path,
    choices: Choices,
    moved: Mapping[Path, Path] | None = None,
) -> tuple[str, ...]:
    """Write the file under its partial name, ready to be published.

    Parameters
    ----------
    path : final name; .usdz becomes a package with every file it needs, anything else a layer
        that refers to textures by relative paths.
    root : the root layer over source and cache, with the bake selected.
    asset, source, choices : of the bake, as for `layout.write_root`.
    moved : files that go with the result, from where they are now to where they will be.

    Returns
    -------
    Notes in words: files that could not be found.

    Raises
    ------
    BakeError : the folder or the disk refuses.
    """
    stage = Usd.Stage.Open(str(root.path), Usd.Stage.LoadAll)
    session = stage.GetSessionLayer()
    for switch in root.switches:
        # a variant that is not there, so that nothing is hidden in the prims themselves
        Sdf.CreatePrimInLayer(session, switch).variantSelections[root.display_set] = NOWHERE
    layer = stage.Flatten(addSourceFileComment=False)
    anchor_tiles(stage, layer)
    _restore_displays(layer, root, asset, source, choices)
    if path.suffix != PACKAGE:
        files = Beside(path.parent.absolute(), moved or {})
        UsdUtils.ModifyAssetPaths(layer, files.place)
        _export(layer, partial_path(path))
        return tuple(files.notes)
    with tempfile.TemporaryDirectory(prefix="gf-usd-") as folder:
        package = Package(Path(folder))
        UsdUtils.ModifyAssetPaths(layer, package.place)
        # AR clients want a crate as the first file
        first = Path(folder) / f"{path.stem}.usdc"
        _export(layer, first)
        package.write(partial_path(path), first)
    return tuple(package.notes)


def _restore_displays(
    layer: Sdf.Layer, root: RootSummary, asset: Asset, source: Path, choices: Choices
) -> None:
    """Variants that hide what a display hides; visibility of these prims moves into them."""
    home = find_home(open_source(source), asset, choices)
    for switch in map(Sdf.Path, root.switches):
        spec = layer.GetPrimAtPath(switch)
        spec.variantSetNameList.prependedItems = [root.display_set]
        spec.variantSelections[root.display_set] = choices.shapes[0]
        modes = Sdf.VariantSetSpec(spec, root.display_set)
        hides = {mode: hidden(mode, switch, asset, home, choices) for mode in choices.shapes}
        for mode, paths in hides.items():
            inner = Sdf.VariantSpec(modes, mode).primSpec.path
            for path in {p for paths in hides.values() for p in paths}:
                mine = inner.AppendPath(path.MakeRelativePath(switch)).AppendProperty("visibility")
                authored = path.AppendProperty("visibility")
                if path in paths:
                    prim = Sdf.CreatePrimInLayer(layer, mine.GetPrimOrPrimVariantSelectionPath())
                    spec_of = Sdf.AttributeSpec(prim, "visibility", Sdf.ValueTypeNames.Token)
                    spec_of.default = "invisible"
                elif layer.GetPropertyAtPath(authored):
                    Sdf.CreatePrimInLayer(layer, mine.GetPrimOrPrimVariantSelectionPath())
                    Sdf.CopySpec(layer, authored, layer, mine)
        for path in {p for paths in hides.values() for p in paths}:
            authored = layer.GetPropertyAtPath(path.AppendProperty("visibility"))
            if authored:
                layer.GetPrimAtPath(path).RemoveProperty(authored)


def _export(layer: Sdf.Layer, path: Path) -> None:
    try:
        done = layer.Export(str(path))
    except Tf.ErrorException as error:
        raise refused(path) from error
    if not done:
        raise refused(path)
