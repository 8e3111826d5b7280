"""--material-sweep: values, names, and options that it cannot be combined with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import gf_usd
from gf_usd.core.errors import UsageError
from gf_usd.core.materials.presets import find_preset
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.options.sweep import MOST, PROPERTIES, parse_sweep, swept


def test_moduli_are_spaced_by_equal_ratios() -> None:
    assert parse_sweep("youngs=1e4:1e6:5").values == (1e4, 31620.0, 1e5, 316200.0, 1e6)


def test_other_values_are_spaced_evenly() -> None:
    assert parse_sweep("friction=0:1:3").values == (0.0, 0.5, 1.0)
    assert parse_sweep("damping=0:1:3").values == (0.0, 0.5, 1.0), "no ratio starts at 0"


@pytest.mark.parametrize(
    "text",
    [
        "youngs",
        "size=1:2:3",
        "youngs=1:2",
        "youngs=2:1:3",
        "youngs=0:1:3",
        "poisson=0.1:0.5:3",
        "friction=0:1:1",
        f"friction=0:1:{MOST + 1}",
        "friction=0:1:two",
        "friction=a:1:2",
        "friction=nan:1:2",
    ],
)
def test_what_is_no_range_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="--material-sweep") as caught:
        parse_sweep(text)
    assert caught.value.hint


@pytest.mark.parametrize("name", PROPERTIES)
def test_a_variant_differs_in_one_value(name: str) -> None:
    field = PROPERTIES[name][0]
    base = find_preset("rubber")
    made = swept(base, parse_sweep(f"{name}=0.1:0.4:2"))
    for one, value in zip(made, (0.1, 0.4)):
        material, plain = one.material(1.0), base.material(1.0)
        changed = {k for k, v in vars(material).items() if v != vars(plain)[k]}
        assert changed == {"name", field}
        assert getattr(material, field) == value
    assert [one.name for one in made] == [f"rubber_{name}_0_1", f"rubber_{name}_0_4"]


@pytest.mark.parametrize(
    "options", [{"friction": 0.3}, {"preset": "paper"}, {"flatten": True}], ids=str
)
def test_what_contradicts_it_is_refused(options: dict) -> None:
    with pytest.raises(UsageError, match="--material-sweep"):
        Request.of({"material_sweep": "friction=0:1:2", **options}).check()
    Request.of({"material_sweep": "youngs=1:2:2", "friction": 0.3}).check()


@pytest.mark.slow
@pytest.mark.acceptance
def test_variants_and_a_sheet(tmp_path: Path) -> None:
    asset = tmp_path / "box.obj"
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    faces = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    lines = ["v {} {} {}".format(*x) for x in corners] + ["f {} {} {} {}".format(*f) for f in faces]
    asset.write_text("\n".join(lines))
    result = gf_usd.bake(
        asset, output=f"{tmp_path}/", material_sweep="youngs=3e4:3e5:2", particles=200, frames=3,
        drop=0.1,
    )  # fmt: skip
    assert [bake.material.youngs_modulus for bake in result.bakes] == [3e4, 3e5]
    assert result.root.name == "box.rubber_youngs.usda"
    sheet = tmp_path / "box.rubber_youngs.sheet.png"
    assert sheet in [path.absolute() for path in result.outputs]
    pixels = np.asarray(Image.open(sheet).convert("RGB"))
    # two rows of three tiles of 320 x 240 with captions, and gutters
    assert 960 <= pixels.shape[1] <= 1000
    assert 520 <= pixels.shape[0] <= 540
    assert pixels.std() > 0.0
    with pytest.raises(UsageError, match="exists already"):
        gf_usd.bake(asset, output=f"{tmp_path}/", material_sweep="youngs=3e4:3e5:2", particles=200)
