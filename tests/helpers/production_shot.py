"""A shot as a production has it: seven layers, and every way that USD has to put them together.

    shot.usda            root: sublayers, variant selections, overrides, cameras and lights
      anim.usda          sublayer with an offset of 100: animated transforms and visibility
      set.usda           sublayer: the hierarchy
        props/crate.usda reference: meters, Z up, 48 time codes a second; a subdivision cage
        props/ball.usdc  payload: inches; points only in time samples
        props/chair.usda instances of it, with an instance inside
        props/rock.usda  prototype of a PointInstancer

The shot is in centimeters, Y up, 24 time codes a second, from 101 to 104; the animation begins at
91.  Sizes in the world are about 20 cm.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf

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
    """Centimeters: a seat, and two legs that are instances themselves."""
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


def crate() -> str:
    """Meters, Z up: a cage with everything that hangs on faces, edges, points and corners."""
    points, counts, indices = box(0.2)
    tall = points * (1.0, 1.0, 1.5)
    n_points, n_faces, n_corners = len(points), len(counts), len(indices)
    edges = [indices[0], indices[1], indices[2]]
    return f"""#usda 1.0
(
    defaultPrim = "Crate"
    metersPerUnit = 1
    upAxis = "Z"
    timeCodesPerSecond = 48
)
def Xform "Crate" (
    kind = "component"
    assetInfo = {{
        asset identifier = @./crate.usda@
        string name = "Crate"
    }}
    prepend variantSets = ["shape"]
    variants = {{
        string shape = "cube"
    }}
)
{{
    float3[] extentsHint = [(-0.1, -0.1, -0.1), (0.1, 0.1, 0.1)]
    def Mesh "Box" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        point3f[] points = {tuples(points)}
        {topology(counts, indices)}
        float3[] extent = [(-0.1, -0.1, -0.1), (0.1, 0.1, 0.1)]
        uniform token subdivisionScheme = "catmullClark"
        uniform token interpolateBoundary = "edgeAndCorner"
        token faceVaryingLinearInterpolation = "cornersPlus1"
        int[] creaseIndices = {edges}
        int[] creaseLengths = [3]
        float[] creaseSharpnesses = [4]
        int[] cornerIndices = [{indices[4]}]
        float[] cornerSharpnesses = [10]
        int[] holeIndices = [5]
        color3f[] primvars:displayColor = [(0.5, 0.3, 0.1)] (
            interpolation = "constant"
        )
        float[] primvars:wear = {[round(0.01 * i, 3) for i in range(n_faces)]} (
            interpolation = "uniform"
        )
        float[] primvars:dust = {[round(0.02 * i, 3) for i in range(n_points)]} (
            interpolation = "varying"
        )
        point3f[] primvars:rest = {tuples(points)} (
            interpolation = "vertex"
        )
        texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (
            interpolation = "faceVarying"
        )
        int[] primvars:st:indices = {[i % 4 for i in range(n_corners)]}
        float[] primvars:pair = {[0.5] * (2 * n_points)} (
            elementSize = 2
            interpolation = "vertex"
        )
        string primvars:lot = "K7" (
            interpolation = "constant"
        )
        float[] primvars:heat.timeSamples = {{
            0: {[0.0] * n_points},
            10: {[1.0] * n_points},
        }}
        asset primvars:stencil = @./stencil.png@
        uniform token subsetFamily:materialBind:familyType = "nonOverlapping"
        rel material:binding = </Crate/Looks/Wood>
        def GeomSubset "Lid" (
            prepend apiSchemas = ["MaterialBindingAPI"]
        )
        {{
            uniform token elementType = "face"
            uniform token familyName = "materialBind"
            int[] indices = [4, 5, 6, 7]
            rel material:binding = </Crate/Looks/Paint>
        }}
        def GeomSubset "Rim"
        {{
            uniform token elementType = "point"
            uniform token familyName = "selection"
            int[] indices = [0, 1, 2]
        }}
    }}
    def Scope "Looks"
    {{
        def Material "Wood"
        {{
        }}
        def Material "Paint"
        {{
        }}
    }}
    variantSet "shape" = {{
        "cube" {{
        }}
        "tall" (
            prepend variantSets = ["paint"]
            variants = {{
                string paint = "red"
            }}
        ) {{
            over "Box"
            {{
                point3f[] points = {tuples(tall)}
                float3[] extent = [(-0.1, -0.1, -0.15), (0.1, 0.1, 0.15)]
            }}
            variantSet "paint" = {{
                "red" {{
                    over "Box"
                    {{
                        color3f[] primvars:displayColor = [(0.8, 0.1, 0.1)]
                    }}
                }}
                "blue" {{
                }}
            }}
        }}
    }}
}}
"""


def write_props(folder: Path) -> None:
    """The layers that shots refer to, in ``folder/props``."""
    props = folder / "props"
    props.mkdir(parents=True)
    for name, text in (("crate", crate()), ("chair", chair()), ("rock", rock())):
        (props / f"{name}.usda").write_text(text, encoding="utf-8")
    layer = Sdf.Layer.CreateAnonymous(".usda")
    assert layer.ImportFromString(ball())
    assert layer.Export(str(props / "ball.usdc"))
    (props / "stencil.png").write_bytes(b"a picture")


SET = f"""#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Y"
)
class "_prop"
{{
    custom double userProperties:weight = 3
    token purpose = "render"
}}
class "_wheel"
{{
    def Mesh "Tyre"
    {{
        {mesh(11.0)}
        bool doubleSided = 1
    }}
}}
class "_weak"
{{
    custom string userProperties:origin = "the yard"
}}
def Xform "World" (
    kind = "assembly"
)
{{
    def Xform "Props" (
        kind = "group"
    )
    {{
        double3 xformOp:translate = (0, 40, 0)
        float3 xformOp:rotateXYZ = (0, 0, 0)
        float3 xformOp:scale = (1, 1, 1)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
        def "Crate" (
            prepend inherits = </_prop>
            prepend references = @./props/crate.usda@
            prepend specializes = </_weak>
        )
        {{
            float xformOp:rotateX:units = -90
            float3 xformOp:scale:units = (100, 100, 100)
            uniform token[] xformOpOrder = ["xformOp:rotateX:units", "xformOp:scale:units"]
        }}
        def Xform "Mirror"
        {{
            double3 xformOp:translate = (30, 0, 0)
            float3 xformOp:scale = (-1, 1.25, 1)
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale"]
            def "Tall" (
                prepend references = @./props/crate.usda@
            )
            {{
                float xformOp:rotateX:units = -90
                float3 xformOp:scale:units = (100, 100, 100)
                uniform token[] xformOpOrder = ["xformOp:rotateX:units", "xformOp:scale:units"]
            }}
        }}
        def Xform "Inches" (
            prepend payload = @./props/ball.usdc@ (offset = 101)
        )
        {{
            double3 xformOp:translate = (-30, 0, 0)
            float3 xformOp:scale:units = (2.54, 2.54, 2.54)
            uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:scale:units"]
        }}
        def Xform "Wheel" (
            prepend inherits = </_wheel>
        )
        {{
            double3 xformOp:translate = (0, -25, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }}
        def Sphere "Knob"
        {{
            double radius = 7
            double3 xformOp:translate = (0, 30, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
            color3f[] primvars:displayColor = [(0.2, 0.8, 0.3)]
        }}
    }}
    def Xform "Stand"
    {{
        def Mesh "Proxy"
        {{
            {mesh(10.0, 1)}
            uniform token purpose = "proxy"
        }}
        def Mesh "Guide"
        {{
            {mesh(10.0, 1)}
            uniform token purpose = "guide"
        }}
        def Mesh "Hidden"
        {{
            {mesh(10.0, 1)}
            token visibility = "invisible"
        }}
        def Mesh "Late"
        {{
            {mesh(10.0, 1)}
        }}
        def Mesh "Off"
        {{
            {mesh(10.0, 1)}
        }}
    }}
    def Xform "Chairs"
    {{
        def "A" (
            instanceable = true
            prepend references = @./props/chair.usda@
        )
        {{
            double3 xformOp:translate = (-20, 90, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }}
        def "B" (
            instanceable = true
            prepend references = @./props/chair.usda@
        )
        {{
            double3 xformOp:translate = (20, 90, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }}
        def "C" (
            instanceable = true
            prepend references = @./props/chair.usda@
        )
        {{
            double3 xformOp:translate = (60, 90, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]
        }}
    }}
    def PointInstancer "Scatter"
    {{
        rel prototypes = [</World/Scatter/Prototypes/Rock>, </World/Library/Stone>]
        int[] protoIndices = [0, 1, 0]
        point3f[] positions = [(0, 0, 50), (10, 0, 50), (20, 0, 50)]
        quath[] orientations = [(1, 0, 0, 0), (1, 0, 0, 0), (0, 1, 0, 0)]
        def Scope "Prototypes"
        {{
            def "Rock" (
                prepend references = @./props/rock.usda@
            )
            {{
            }}
        }}
    }}
    def Scope "Library"
    {{
        def "Stone" (
            prepend references = @./props/rock.usda@
        )
        {{
        }}
    }}
}}
"""

ANIM = """#usda 1.0
(
    metersPerUnit = 0.01
    upAxis = "Y"
)
over "World"
{
    over "Props"
    {
        double3 xformOp:translate.timeSamples = {
            -10: (0, 18, 0),
            0: (0, 38, 0),
            10: (4, 58, 2),
        }
        float3 xformOp:rotateXYZ.timeSamples = {
            0: (0, 0, 0),
            10: (10, 20, 30),
        }
        over "Mirror"
        {
            float3 xformOp:scale.timeSamples = {
                -10: (-1, 1, 1),
                10: (-1.2, 1.5, 1),
            }
        }
    }
    over "Stand"
    {
        over "Late"
        {
            token visibility.timeSamples = {
                -10: "invisible",
                2: "inherited",
            }
        }
    }
}
"""

ROOT = """
over "World"
{{
    custom string note = "approved"
    over "Props"
    {{
        over "Mirror"
        {{
            over "Tall" (
                variants = {{
                    string shape = "tall"
                }}
            )
            {{
                over "Box"
                {{
                    rel material:binding = </Looks/Steel>
                }}
            }}
        }}
    }}
    over "Stand"
    {{
        over "Off" (
            active = false
        )
        {{
        }}
    }}
}}
def Scope "Looks"
{{
    def Material "Steel"
    {{
    }}
}}
def Scope "Lights"
{{
    def SphereLight "Key" (
        prepend apiSchemas = ["CollectionAPI:lightLink"]
    )
    {{
        float inputs:intensity = 500
        rel collection:lightLink:includes = </World/Props/Crate>
        uniform bool collection:lightLink:includeRoot = 0
    }}
}}
def Camera "ShotCam"
{{
    float focalLength = 35
    double3 xformOp:translate.timeSamples = {{
        91: (0, 50, 300),
        104: (10, 50, 280),
    }}
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
"""


def write_shot(folder: Path) -> Path:
    """Write all layers of the shot into ``folder``; its root layer."""
    write_props(folder)
    (folder / "set.usda").write_text(SET, encoding="utf-8")
    (folder / "anim.usda").write_text(ANIM, encoding="utf-8")
    sublayers = "subLayers = [@./anim.usda@ (offset = 101), @./set.usda@]"
    shot = folder / "shot.usda"
    body = ROOT.replace("{{", "{").replace("}}", "}")
    shot.write_text(f"#usda 1.0\n(\n    {SHOT}\n    {sublayers}\n)\n{body}", encoding="utf-8")
    return shot
