"""Hand-written source stages, each with a difficulty of its own."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from small_stages import CUBE, asset_of, frames_of, info_of, particles_of, write
from small_stages import CUBE_POINTS as POINTS

from gf_usd.core.asset import Asset
from gf_usd.core.frames.frame import BakedFrame, BakeInfo
from gf_usd.core.frames.particles import Particles

Y_M = 'upAxis = "Y"\n metersPerUnit = 1'
Z_CM = 'upAxis = "Z"\n metersPerUnit = 0.01'
NORMALS = "[(0,0,-1),(0,0,-1),(1,0,0),(0,1,0),(0,0,1),(0,0,1),(0.6,0,0.8),(0,1,0)]"
BOUND = 'prepend apiSchemas = ["MaterialBindingAPI"]'


@dataclass(frozen=True)
class Source:
    """A usda body with the metadata of its layer."""

    body: str
    head: str = Y_M
    skinned: tuple[str, ...] = ()

    def asset(self, folder: Path, name: str = "duck.usda") -> Asset:
        """Written into ``folder`` and read."""
        return asset_of(write(folder / name, self.body, self.head), skinned=self.skinned)

    def scene(
        self, folder: Path, *, frames: int = 5
    ) -> tuple[Asset, Particles, BakeInfo, list[BakedFrame]]:
        """What a CacheWriter of the motion is made of, and its frames."""
        asset = self.asset(folder)
        info, particles = info_of(asset, frames=frames), particles_of(asset)
        return asset, particles, info, list(frames_of(asset, particles, info))


PLAIN = Source(
    f"""
def Xform "duck" (
    kind = "component"
    assetInfo = {{
        string name = "duck"
    }}
)
{{
    float3[] extentsHint = [(0, 0, 0), (1, 1, 1)]
    def Scope "geo"
    {{
        def Mesh "body" (
            {BOUND}
        )
        {{ {CUBE}
            rel material:binding = </_materials/red>
            normal3f[] normals = {NORMALS}
            uniform token subdivisionScheme = "none"
            color3f[] primvars:displayColor = [(1, 0, 0)]
            def GeomSubset "top" (
                {BOUND}
            )
            {{
                uniform token elementType = "face"
                uniform token familyName = "materialBind"
                int[] indices = [1]
                rel material:binding = </_materials/green>
            }}
        }}
    }}
}}
def Scope "_materials"
{{
    def Material "red"
    {{
        token outputs:surface.connect = </_shaders/paint.outputs:surface>
    }}
    def Material "green"
    {{
    }}
}}
def Scope "_shaders"
{{
    def Shader "paint"
    {{
        uniform token info:id = "UsdPreviewSurface"
        token outputs:surface
    }}
}}
""",
    Y_M + '\n defaultPrim = "duck"\n kilogramsPerUnit = 0.5\n startTimeCode = 10',
)

MOVING = Source(
    f"""
def Xform "root"
{{
    double3 xformOp:translate.timeSamples = {{ 1: (3, 0, 0), 5: (5, 1, 2) }}
    float3 xformOp:rotateXYZ.timeSamples = {{ 1: (0, 0, 0), 5: (30, 40, 50) }}
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
    def Xform "arm"
    {{
        float3 xformOp:scale = (2, 50, -5)
        uniform token[] xformOpOrder = ["xformOp:scale"]
        def Mesh "m"
        {{ {CUBE}
            uniform token orientation = "leftHanded"
            vector3f[] accelerations = {POINTS}
            normal3f[] primvars:normals = [(0, 0, 1), (0, 1, 0)] (
                interpolation = "vertex"
            )
            int[] primvars:normals:indices = [0, 1, 0, 1, 0, 1, 0, 1]
            point3f[] points.timeSamples = {{
                1: [(0,0,0),(1,0,0),(1,1,0),(0,1,0),(0,0,1),(1,0,1),(1,1,1),(0,1,1)],
                9: [(0,0,0),(2,0,0),(2,2,0),(0,2,0),(0,0,2),(2,0,2),(2,2,2),(0,2,2)],
            }}
        }}
    }}
}}
""",
    Z_CM + "\n timeCodesPerSecond = 24\n startTimeCode = 1\n endTimeCode = 9",
)

INSTANCES = Source(
    f"""
def Xform "root"
{{
    def "left" (
        instanceable = true
        references = </_protos/chair>
    )
    {{
        double3 xformOp:translate = (-2, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }}
    def "right" (
        instanceable = true
        references = </_protos/chair>
    )
    {{
    }}
}}
class "_protos"
{{
    def Xform "chair"
    {{
        def Mesh "seat" (
            {BOUND}
        )
        {{ {CUBE}
            rel material:binding = </_materials/red>
        }}
    }}
}}
def Scope "_materials"
{{
    def Material "red"
    {{
    }}
}}
"""
)

SKINNED = Source(
    f"""
def Xform "root"
{{
    double3 xformOp:translate = (0, 2, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def SkelRoot "figure"
    {{
        float3[] extent = [(0, 0, 0), (1, 1, 1)]
        def Skeleton "bones" (
            prepend apiSchemas = ["SkelBindingAPI"]
        )
        {{
            uniform token[] joints = ["hip"]
            uniform matrix4d[] bindTransforms = [((1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,0,1))]
            uniform matrix4d[] restTransforms = [((1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,0,1))]
            rel skel:animationSource = </_anims/walk>
        }}
        def Mesh "skin" (
            prepend apiSchemas = ["SkelBindingAPI"]
        )
        {{ {CUBE}
            int[] primvars:skel:jointIndices = [0] (
                elementSize = 1
                interpolation = "constant"
            )
            float[] primvars:skel:jointWeights = [1] (
                elementSize = 1
                interpolation = "constant"
            )
            rel skel:skeleton = </root/figure/bones>
            rel skel:animationSource = </_anims/walk>
        }}
    }}
}}
def Scope "_anims"
{{
    def SkelAnimation "walk"
    {{
        uniform token[] joints = ["hip"]
        float3[] translations.timeSamples = {{ 1: [(0, 0, 0)], 5: [(0, 7, 0)] }}
        quatf[] rotations = [(1, 0, 0, 0)]
        half3[] scales = [(1, 1, 1)]
    }}
}}
""",
    Y_M,
    ("/root/figure/skin",),
)

ROOT_MESH = Source(
    f"""
def Mesh "blob"
{{ {CUBE}
    double3 xformOp:translate = (0, 3, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
""",
    Y_M + '\n defaultPrim = "blob"',
)

SEVERAL_ROOTS = Source(
    f"""
over "nothing"
{{
}}
def Scope "_materials"
{{
}}
def Xform "one"
{{
    def Mesh "m"
    {{ {CUBE}
    }}
}}
def Xform "two"
{{
    double3 xformOp:translate = (4, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "m"
    {{ {CUBE}
    }}
}}
""",
    Z_CM,
)

IMPLICIT = Source(
    """
def Xform "root" (
    prepend variantSets = "display"
    variants = {
        string display = "big"
    }
)
{
    double3 xformOp:translate = (4, 0, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Xform "GaussianFlesh"
    {
    }
    def Cube "box"
    {
        double size = 2
        uniform token orientation = "leftHanded"
        color3f[] primvars:displayColor = [(1, 0, 0)]
    }
    variantSet "display" = {
        "big" {
        }
        "small" {
        }
    }
}
"""
)

SOURCES = {
    "plain": PLAIN,
    "moving": MOVING,
    "instances": INSTANCES,
    "skinned": SKINNED,
    "root_mesh": ROOT_MESH,
    "several_roots": SEVERAL_ROOTS,
    "implicit": IMPLICIT,
}
