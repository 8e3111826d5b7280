"""A mesh whose topology changes over time is baked with that of the first frame, all of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from compare_stages import differences, with_variant
from production_shot import box, tuples
from pxr import Usd, UsdGeom

import gf_usd
from gf_usd.layers.check.run import check_file


def sampled(kind: str, name: str, values: dict[int, object]) -> str:
    lines = "\n".join(f"{time}: {value}," for time, value in values.items())
    return f"{kind} {name}.timeSamples = {{\n{lines}\n}}\n"


def growing() -> str:
    """A box of 8 points until 11, of 26 from 12 on."""
    small, large = box(10.0, 1), box(10.0, 2)
    pair = {10: small, 12: large}

    def each(make) -> dict[int, object]:
        return {time: make(*shape) for time, shape in pair.items()}

    def primvar(name: str, interpolation: str, make) -> str:
        head = f'float[] primvars:{name} (\ninterpolation = "{interpolation}"\n)\n'
        return head + sampled("float[]", f"primvars:{name}", each(make))

    return f"""
def Mesh "Blob"
{{
    {sampled("point3f[]", "points", each(lambda p, c, i: tuples(p)))}
    {sampled("int[]", "faceVertexCounts", each(lambda p, c, i: c))}
    {sampled("int[]", "faceVertexIndices", each(lambda p, c, i: i))}
    {sampled("int[]", "cornerIndices", {10: [0], 12: [0, 1]})}
    {sampled("float[]", "cornerSharpnesses", {10: [2.0], 12: [2.0, 2.0]})}
    {primvar("age", "vertex", lambda p, c, i: [0.5] * len(p))}
    {primvar("side", "uniform", lambda p, c, i: [0.5] * len(c))}
    {primvar("hue", "faceVarying", lambda p, c, i: [0.5] * len(i))}
    {primvar("glow", "constant", lambda p, c, i: [len(p) * 1.0])}
    def GeomSubset "Lid"
    {{
        uniform token elementType = "face"
        {sampled("int[]", "indices", {10: [0], 12: [0, 1, 2, 3]})}
    }}
}}
"""


@pytest.mark.slow
def test_arrays_of_element_counts_are_held_and_others_interpolated(tmp_path: Path) -> None:
    source = tmp_path / "blob.usda"
    head = 'defaultPrim = "Blob"\n metersPerUnit = 0.01\n upAxis = "Y"\n startTimeCode = 10'
    source.write_text(f"#usda 1.0\n(\n {head}\n endTimeCode = 14\n)\n{growing()}")
    result = gf_usd.bake(source, output=f"{tmp_path}/out/", particles=60, frames=5, floor="none")
    assert any("its topology changes over time" in note for note in result.notes)
    stage, before = with_variant(result.root, "rubber"), Usd.Stage.Open(str(source))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Blob"))
    for time in (10, 12, 14):
        sizes = {
            primvar.GetPrimvarName(): len(primvar.Get(time))
            for primvar in UsdGeom.PrimvarsAPI(mesh).GetPrimvarsWithValues()
        }
        assert sizes == {"age": 8, "side": 6, "hue": 24, "glow": 1}
        assert len(mesh.GetPointsAttr().Get(time)) == 8
        assert list(mesh.GetCornerIndicesAttr().Get(time)) == [0]
        assert list(mesh.GetCornerSharpnessesAttr().Get(time)) == [2.0]
        assert list(UsdGeom.Subset.GetAllGeomSubsets(mesh)[0].GetIndicesAttr().Get(time)) == [0]
        np.testing.assert_array_equal(mesh.GetFaceVertexCountsAttr().Get(time), [4] * 6)
    assert stage.GetAttributeAtPath("/Blob.primvars:glow").Get(12)[0] == 26.0
    assert check_file(result.root).ok
    assert differences(before, with_variant(result.root, "none")) == {}
