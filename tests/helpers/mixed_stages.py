"""Stages with bodies that flow and bodies that do not."""

from __future__ import annotations

from pathlib import Path

HEAD = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    upAxis = "Y"
)
def Xform "World"
{
"""
CUBE = """    def Cube "%s" %s
    {
        %s
        double size = 0.2
        double3 xformOp:translate = (%s)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""
API = '(prepend apiSchemas = ["GaussianFleshBakeAPI"])'
MATERIAL = 'uniform token gaussianFlesh:material = "%s"'
TRAY = """    def Cube "Tray" (prepend apiSchemas = ["PhysicsCollisionAPI"])
    {
        double size = 1
        double3 xformOp:translate.timeSamples = { 1: (0, -0.52, 0), 24: (0, -0.42, 0) }
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
"""


def body(name: str, material: str, at: str) -> str:
    return CUBE % (name, API, MATERIAL % material, at)


def scene(folder: Path, *prims: str) -> Path:
    """A stage of some prims."""
    path = folder / "scene.usda"
    path.write_text(HEAD + "".join(prims) + "}\n", encoding="utf-8")
    return path


def castle_of(folder: Path) -> Path:
    """A block of rubber that falls on one of sand, .01 m below."""
    sand, rubber = ("Sand", "dry-sand", "0, 0.1, 0"), ("Block", "rubber", "0.03, 0.31, 0.02")
    return scene(folder, body(*sand), body(*rubber))
