"""Small stages with physics, as text, and how they are read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from gf_usd.core.mesh.measures import signed_volume
from gf_usd.core.stage import Collider, StagePhysics
from gf_usd.readers import read_asset
from gf_usd.readers.usd_physics.scene import read_physics

BOX = """
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0,2,3,1, 4,5,7,6, 0,1,5,4, 2,6,7,3, 0,4,6,2, 1,3,7,5]
    point3f[] points = [(0,0,0),(1,0,0),(0,1,0),(1,1,0),(0,0,1),(1,0,1),(0,1,1),(1,1,1)]
"""

SLIDE = """
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 3: (4, 0, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
"""


def head(
    meters: float = 1.0, up: str = "Y", kilograms: float | None = None, extra: str = ""
) -> str:
    """The first lines of a layer."""
    mass = "" if kilograms is None else f"kilogramsPerUnit = {kilograms}"
    return f'#usda 1.0\n(\nmetersPerUnit = {meters}\nupAxis = "{up}"\n{mass}\n{extra}\n)\n'


def prim(kind: str, name: str, *lines: str, apis: Sequence[str] = (), meta: str = "") -> str:
    """A prim with applied APIs; lines are attributes and children."""
    quoted = ", ".join(f'"{api}"' for api in apis)
    applied = f"prepend apiSchemas = [{quoted}]" if apis else ""
    return f'def {kind} "{name}" (\n{applied}\n{meta}\n)\n{{\n' + "\n".join(lines) + "\n}\n"


def mesh(name: str, *lines: str, apis: Sequence[str] = (), meta: str = "") -> str:
    """A cube of edge 1 with a corner at the origin."""
    return prim("Mesh", name, BOX, *lines, apis=apis, meta=meta)


def bound(path: str, purpose: str = "physics") -> str:
    """A line that binds a material."""
    return f"rel material:binding{purpose and ':' + purpose} = <{path}>"


def physics_of(
    path: Path,
    *bodies: str,
    rest: float | None = None,
    times: Sequence[float] = (1.0, 2.0, 3.0),
    facts_from: str = "",
) -> StagePhysics:
    """What a file says of physics; facts_from: a prim with a mesh, where the stage has several."""
    prims = [facts_from] if facts_from else []
    return read_physics(path, read_asset(path, prims=prims).facts, bodies, rest=rest, times=times)


def beside_a_body(write: Callable[..., Path]) -> Callable[..., StagePhysics]:
    """A reader of what a stage says besides the mesh /Body, which is baked."""

    def read_beside(
        *prims: str, layer: str = head(), bodies: tuple[str, ...] = ("/Body",)
    ) -> StagePhysics:
        path = write(layer + mesh("Body") + "".join(prims))
        return physics_of(path, *bodies, facts_from="/Body")

    return read_beside


def only(physics: StagePhysics) -> Collider:
    """The one collider."""
    (collider,) = physics.colliders
    return collider


def volume(collider: Collider, frame: int = 0) -> float:
    """[m^3] that its triangles enclose at a frame."""
    return float(signed_volume(collider.positions(frame), collider.triangles))
