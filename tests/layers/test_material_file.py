"""A material as a layer of its own, which --material reads."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from full_disk import full_disk  # noqa: F401
from pxr import Usd

from gf_usd.core.errors import BakeError
from gf_usd.core.materials.presets import find_preset
from gf_usd.layers.materials import write_material_file
from gf_usd.readers.usd_bake.material_file import read_material

ASSET = Path(__file__).parents[2] / "samples" / "sphere.usda"
SINGLE = 1e-6  # relative: attributes of UsdPhysics are single precision


@pytest.mark.parametrize("name", ["rubber", "clay", "styrofoam", "aluminium"])
def test_what_is_written_is_read(name: str, tmp_path: Path) -> None:
    material = replace(find_preset(name).material(0.1), name=f"{name}_fit")
    path = write_material_file(
        tmp_path / "found.usda", material, {"fit": {"noise": 0.5}}, source=ASSET
    )
    again = read_material(path)
    assert (again.name, again.law) == (material.name, material.law)
    numbers = {k: v for k, v in material.values.items() if not isinstance(v, str)}
    assert {k: again.values[k] for k in numbers} == pytest.approx(numbers, rel=SINGLE)
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetPrimAtPath(f"/Materials/{material.name}")
    assert prim.GetCustomDataByKey("gaussianFlesh:fit:noise") == 0.5


def test_a_layer_is_replaced(tmp_path: Path) -> None:
    path = tmp_path / "found.usda"
    for density in (1000.0, 2000.0):
        material = replace(find_preset("rubber").material(0.1), density=density)
        write_material_file(path, material, {}, source=ASSET)
        assert read_material(path).density == density
    assert [file.name for file in tmp_path.iterdir()] == ["found.usda"]


@pytest.mark.usefixtures("full_disk")
def test_a_full_disk_leaves_no_part_of_a_layer(tmp_path: Path) -> None:
    with pytest.raises(BakeError, match=r"found\.partial\.usda"):
        write_material_file(tmp_path / "found.usda", find_preset("rubber").material(0.1), {},
                            source=ASSET)  # fmt: skip
    assert list(tmp_path.iterdir()) == []
