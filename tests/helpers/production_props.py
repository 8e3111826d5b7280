"""The crate of the shot, and all that shots refer to written into a folder."""

from __future__ import annotations

from pathlib import Path

from production_layers import ball, box, chair, rock, topology, tuples
from pxr import Sdf


def crate() -> str:
    """Metres, Z up: a cage with everything that hangs on faces, edges, points and corners."""
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
