"""What of a stage is drawn."""

from __future__ import annotations

from pxr import Usd, UsdGeom


def visible(stage: Usd.Stage) -> set[str]:
    """Paths of the shapes that are not invisible."""
    walk = stage.Traverse(Usd.TraverseInstanceProxies())
    gprims = [UsdGeom.Gprim(p) for p in walk if p.IsA(UsdGeom.Gprim)]
    return {str(g.GetPath()) for g in gprims if g.ComputeVisibility() != "invisible"}
