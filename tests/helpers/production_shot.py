"""The layers of the shot itself; see production_layers.py."""

from __future__ import annotations

from pathlib import Path

from production_layers import SHOT, mesh
from production_props import write_props

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
