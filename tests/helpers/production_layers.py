"""A shot as a production has it: seven layers, and every way that USD has to put them together.

    shot.usda            root: sublayers, variant selections, overrides, cameras and lights
      anim.usda          sublayer with an offset of 100: animated transforms and visibility
      set.usda           sublayer: the hierarchy
        props/crate.usda reference: metres, Z up, 48 time codes a second; a subdivision cage
        props/ball.usdc  payload: inches; points only in time samples
        props/chair.usda instances of it, with an instance inside
        props/rock.usda  prototype of a PointInstancer

The shot is in centimetres, Y up, 24 time codes a second, from 101 to 104; the animation begins at
91.  Sizes in the world are about 20 cm.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
START = 101.0
SHOT = """defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Y"
    timeCodesPerSecond = 24
    startTimeCode = 101
    endTimeCode = 104"""


def box(size: float, cells: int = 2, turn: float = 0.0) -> tuple[Floats, list[int], list[int]]:
    """A closed box about the origin: points (V, 3), counts and indices of quads, outward.

    turn : [rad] about Z.
    """
    index: dict[tuple[int, int, int], int] = {}
    faces: list[int] = []
    for axis in range(3):
        for side in (0, cells):
            for i in range(cells):
                for j in range(cells):
                    ring = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
                    for a, b in ring if side else ring[::-1]:
                        x, y, z = ((side, a, b), (b, side, a), (a, b, side))[axis]
                        faces.append(index.setdefault((x, y, z), len(index)))
    points = (np.array(list(index)) / cells - 0.5) * size
    c, s = np.cos(turn), np.sin(turn)
    points = points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    return points, [4] * (len(faces) // 4), faces


def tuples(values: Floats) -> str:
    """An array of vectors in usda."""
    return "[" + ", ".join("(" + ", ".join(f"{v:.7g}" for v in row) + ")" for row in values) + "]"


def topology(counts: list[int], indices: list[int]) -> str:
    return f"int[] faceVertexCounts = {counts}\nint[] faceVertexIndices = {indices}\n"


def mesh(size: float, cells: int = 2) -> str:
    """The body of a plain Mesh prim."""
    points, counts, indices = box(size, cells)
    return (
        f"point3f[] points = {tuples(points)}\n{topology(counts, indices)}"
        f"float3[] extent = {tuples(np.stack([points.min(axis=0), points.max(axis=0)]))}\n"
        'uniform token subdivisionScheme = "none"\n'
    )


def ball() -> str:
    """Inches, a payload: its points are in time samples alone, from before the start on."""
    samples, normals, speeds = [], [], []
    for code in (-9.0, 0.0, 1.0, 4.0):
        points, counts, indices = box(8.0, 2, 0.02 * code)
        points = points + (0.0, 0.0, 0.25 * code)
        samples.append(f"{code:g}: {tuples(points)},")
        normals.append(f"{code:g}: {tuples(points / np.linalg.norm(points, axis=1)[:, None])},")
        speeds.append(f"{code:g}: {tuples(np.full_like(points, 0.5))},")
    lines = "\n".join
    clockwise = np.array(indices).reshape(-1, 4)[:, ::-1].ravel().tolist()
    return f"""#usda 1.0
(
    defaultPrim = "Ball"
    metersPerUnit = 0.0254
    upAxis = "Y"
    timeCodesPerSecond = 24
)
def Xform "Ball"
{{
    def Mesh "Skin"
    {{
        point3f[] points.timeSamples = {{
            {lines(samples)}
        }}
        normal3f[] normals.timeSamples = {{
            {lines(normals)}
        }}
        vector3f[] velocities.timeSamples = {{
            {lines(speeds)}
        }}
        vector3f[] accelerations = {tuples(np.zeros_like(points))}
        float3[] extent = [(-6, -6, -6), (6, 6, 6)]
        {topology(counts, clockwise)}
        uniform token orientation = "leftHanded"
        uniform token subdivisionScheme = "none"
    }}
}}
"""


def chair() -> str:
    """Centimetres: a seat, and two legs that are instances themselves."""
    return f"""#usda 1.0
(
    defaultPrim = "Chair"
    metersPerUnit = 0.01
    upAxis = "Y"
)
def Xform "Chair"
{{
    def Mesh "Seat"
    {{
        {mesh(14.0, 1)}
    }}
    def "Left" (
        instanceable = true
        references = </Leg>
    )
    {{
        double3 xformOp:translate = (-5, -12, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    def "Right" (
        instanceable = true
        references = </Leg>
    )
    {{
        double3 xformOp:translate = (5, -12, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
}}
def Xform "Leg"
{{
    def Mesh "Post"
    {{
        {mesh(6.0, 1)}
    }}
}}
"""


def rock() -> str:
    return f"""#usda 1.0
(
    defaultPrim = "Rock"
    metersPerUnit = 0.01
    upAxis = "Y"
)
def Mesh "Rock"
{{
    {mesh(9.0, 1)}
}}
"""
