"""Small things that the writers share."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd
from small_sources import PLAIN, SEVERAL_ROOTS
from small_stages import write

from gf_usd.core.errors import InputError
from gf_usd.layers.stage import find_home, open_source, to_metadata
from gf_usd.system.atomic_files import asset_path


def test_asset_paths_are_anchored_at_the_layer() -> None:
    folder = Path("/shots/010")
    assert asset_path(Path("/shots/010/duck.usda"), folder) == "./duck.usda"
    assert asset_path(Path("/shots/010/in/duck.usda"), folder) == "./in/duck.usda"
    assert asset_path(Path("/assets/duck.usda"), folder) == "../../assets/duck.usda"


def test_metadata_keeps_numbers_words_and_nesting() -> None:
    value = {
        "a": 1,
        "none": None,
        "up": (0.0, 1.0, 0.0),
        "many": [1.0, 2.0],
        "words": ["x", "y"],
        "deep": {"yes": True, "f": np.float64(0.5), "n": np.int64(3)},
    }
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.customLayerData = to_metadata(value)
    again = Sdf.Layer.CreateAnonymous(".usda")
    again.ImportFromString(layer.ExportToString())
    data = again.customLayerData
    assert data["deep"] == {"yes": True, "f": 0.5, "n": 3}
    assert data["up"] == Gf.Vec3d(0, 1, 0)
    assert (list(data["many"]), list(data["words"])) == ([1, 2], ["x", "y"])
    assert (data["a"], "none" in data) == (1, False)


def test_the_home_is_the_default_prim_or_the_first_with_a_surface(tmp_path: Path) -> None:
    asset = SEVERAL_ROOTS.asset(tmp_path)
    stage = Usd.Stage.Open(str(asset.facts.path))
    assert find_home(stage, asset).scope == "/one/GaussianFlesh"
    only_two = replace(asset, surfaces=asset.surfaces[1:])
    assert find_home(stage, only_two).scope == "/two/GaussianFlesh"
    stage.SetDefaultPrim(stage.GetPrimAtPath("/two"))
    assert find_home(stage, asset).root == "/two"


def test_files_that_cannot_be_sources(tmp_path: Path) -> None:
    broken = tmp_path / "broken.usda"
    broken.write_text("not usd")
    with pytest.raises(InputError) as caught:
        open_source(broken)
    assert caught.value.message == f"{broken} cannot be opened as USD"
    still = write(tmp_path / "still.usda", PLAIN.body, "timeCodesPerSecond = 0")
    with pytest.raises(InputError, match="timeCodesPerSecond is 0"):
        open_source(still)
