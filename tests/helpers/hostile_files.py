"""Small valid files of every format that is read, and seeded changes that break them."""

from __future__ import annotations

import random
import re
import struct
from pathlib import Path

import numpy as np
import trimesh
from pxr import Sdf, UsdUtils

from gf_usd.readers.splats.spz import read_spz
from gf_usd.readers.splats.write import ply_bytes

STAGE = """#usda 1.0
(
    defaultPrim = "A"
    metersPerUnit = 1
    upAxis = "Y"
    timeCodesPerSecond = 24
    startTimeCode = 1
    endTimeCode = 3
)
def Xform "A" {
    double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 3: (0, 1, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Mesh "M" (prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsMassAPI"]) {
        point3f[] points = [(-1,-1,-1),(1,-1,-1),(1,1,-1),(-1,1,-1),(-1,-1,1),(1,-1,1),(1,1,1),(-1,1,1)]
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [0,3,2,1,4,5,6,7,0,1,5,4,2,3,7,6,1,2,6,5,0,4,7,3]
        color3f[] primvars:displayColor = [(1, 0, 0)] (interpolation = "constant")
        float physics:density = 1000
    }
    def Sphere "S" {
        double radius = 0.5
    }
}
"""  # noqa: E501
ODD = (
    *("nan", "inf", "-inf", "0", "-1", "1e-9", "1e9", "1e38", "-2147483648", "2147483647"),
    *("99999999999", "[]", "()", '""', "None", "</A>", "@missing.usda@", "@/etc/passwd@"),
)


def sound(folder: Path) -> list[Path]:
    """One file of each format, written into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    made = [folder / "a.usda", folder / "a.usdc", folder / "a.usdz"]
    made[0].write_text(STAGE)
    layer = Sdf.Layer.FindOrOpen(str(made[0]))
    assert layer is not None
    layer.Export(str(made[1]))
    UsdUtils.CreateNewUsdzPackage(str(made[1]), str(made[2]))
    ball = trimesh.creation.icosphere(subdivisions=1)
    for suffix in ("obj", "ply", "stl", "off", "glb"):
        made.append(folder / f"b.{suffix}")
        ball.export(made[-1])
    made.append(folder / "ascii.ply")
    ball.export(made[-1], encoding="ascii")
    generator = np.random.default_rng(0)
    splats = b"".join(
        struct.pack("<6f8B", *generator.normal(size=3), 0.1, 0.1, 0.1, *([128] * 8))
        for _ in range(64)
    )
    made.append(folder / "c.splat")
    made[-1].write_bytes(splats)
    made.append(folder / "d.spz")
    made[-1].write_bytes((Path(__file__).parents[1] / "assets/SanitySplats.spz").read_bytes())
    made.append(folder / "e.ply")
    made[-1].write_bytes(ply_bytes(read_spz(made[-2])))
    return made


def broken(content: bytes, suffix: str, dice: random.Random) -> bytes:
    """A sound file's bytes, broken one to three times."""
    for _ in range(dice.randint(1, 3)):
        content = dice.choice(_ways(suffix))(content, dice)
    return content


def _ways(suffix: str):
    text = suffix in (".usda", ".obj", ".off", ".ply", ".glb")
    return (_cut, _flip, _splice, _word) + ((_number, _number, _line, _number) if text else ())


def _cut(content: bytes, dice: random.Random) -> bytes:
    return content[: dice.randrange(len(content) + 1)]


def _flip(content: bytes, dice: random.Random) -> bytes:
    out = bytearray(content)
    for _ in range(dice.randint(1, 8) if out else 0):
        out[dice.randrange(len(out))] ^= 1 << dice.randrange(8)
    return bytes(out)


def _splice(content: bytes, dice: random.Random) -> bytes:
    a, b, c = sorted(dice.randrange(len(content) + 1) for _ in range(3))
    return content[:b] + content[a:b] + content[c:]


def _word(content: bytes, dice: random.Random) -> bytes:
    """Four bytes become an absurd number, as a count, an offset or a coordinate."""
    at = dice.randrange(max(1, len(content) - 3))
    value = dice.choice((0, 1, 0x7FFFFFFF, 0xFFFFFFFF, 0x80000000, 0x7F800000, 0x7FC00000))
    return content[:at] + struct.pack("<I", value) + content[at + 4 :]


def _number(content: bytes, dice: random.Random) -> bytes:
    """A number of the text becomes an odd value."""
    found = list(re.finditer(rb"-?\d+(\.\d+)?", content))
    if not found:
        return content
    one = dice.choice(found)
    return content[: one.start()] + dice.choice(ODD).encode() + content[one.end() :]


def _line(content: bytes, dice: random.Random) -> bytes:
    """A line goes, doubles or moves."""
    lines = content.split(b"\n")
    one = lines.pop(dice.randrange(len(lines)))
    for _ in range(dice.randint(0, 2)):
        lines.insert(dice.randrange(len(lines) + 1), one)
    return b"\n".join(lines)
