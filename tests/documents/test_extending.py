"""The code of the recipes in docs/extending.md runs as it stands there."""

from __future__ import annotations

import importlib
import re
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from lane_kernels import evaluate, flow_with_loss
from pxr import Sdf, Usd, UsdGeom
from random_turns import random_turns

from gf_usd.core.errors import InputError
from gf_usd.core.materials import dimensionless, laws
from gf_usd.core.materials.presets import presets
from gf_usd.layers.tracks import particles
from gf_usd.readers import formats
from gf_usd.verify.cases import patch
from tools.documents import ROOT

PAGE = (ROOT / "docs" / "extending.md").read_text("utf-8")
FENCE = re.compile(r"^( *)```python\n(.*?)^ *```$", re.DOTALL | re.MULTILINE)
CODE = [textwrap.dedent(text) for _, text in FENCE.findall(PAGE)]
MU, LAM = 2.0, 3.0  # [Pa]
TETRAHEDRON = """MeshVersionFormatted 1
Dimension 3
Vertices
4
0 0 0 1
1 0 0 1
0 1 0 1
0 0 1 1
Triangles
4
1 3 2 1
1 2 4 1
1 4 3 1
2 3 4 1
End
"""


def block(excerpt: str) -> str:
    """The only block of Python that holds these words."""
    (found,) = (text for text in CODE if excerpt in text)
    return found


def row(excerpt: str, module: ModuleType) -> Any:
    """The row of a table that a block shows, as the module of the table makes it."""
    return eval(block(excerpt), dict(vars(module)))[0]


@pytest.fixture
def made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Makes a module of the block with these words."""
    monkeypatch.syspath_prepend(str(tmp_path))
    names: list[str] = []

    def make(excerpt: str, name: str) -> Any:
        names.append(name)
        (tmp_path / f"{name}.py").write_text(block(excerpt), "utf-8")
        importlib.invalidate_caches()
        return importlib.import_module(name)

    yield make
    for name in names:
        sys.modules.pop(name, None)


@contextmanager
def law(excerpt: str, code: str) -> Iterator[str]:
    """The token of the row with these words, whose functions are in another module, in LAWS."""
    spec = replace(row(excerpt, laws), code=code)
    laws.LAWS[spec.token] = spec
    try:
        yield spec.token
    finally:
        del laws.LAWS[spec.token]


def gradients(size: float) -> np.ndarray:
    """(16, 3, 3) gradients with logarithmic stretches within a size, turned at random."""
    s = np.exp(np.random.default_rng(1).uniform(-size, size, (16, 3)))
    return (random_turns(16, 2) * s[:, None, :]) @ random_turns(16, 3)


def test_the_law_is_its_formula(made: Any) -> None:
    made("The Neo-Hookean law without a logarithm", "recipe_elastic")
    scope: dict[str, Any] = dict(vars(patch))
    exec(block("def stable_neo_hookean"), scope)
    F = gradients(0.4)
    with law('token="stableNeoHookean"', "recipe_elastic") as token:
        P = evaluate(token, F, MU, LAM)[1]
    expected = [scope["stable_neo_hookean"](one, MU, LAM) for one in F]
    np.testing.assert_allclose(P, expected, rtol=0.0, atol=1e-13)  # rounding


def test_the_law_with_state_flows_to_its_limit(made: Any) -> None:
    made("ideal von Mises plasticity", "recipe_plastic")
    F = np.concatenate([gradients(0.2), np.eye(3)[None]])
    before, stress = np.full((17, 1), 0.1), 0.05
    with law('token="idealPlastic"', "recipe_plastic") as token:
        E, after, work = flow_with_loss(token, F, before, MU, LAM, flow_stress=stress)
        P = evaluate(token, E, MU, LAM)[1]
        np.testing.assert_allclose(
            P, [patch.REFERENCE["corotated"](one, MU, LAM) for one in E], atol=1e-13
        )
    U, Ue = (np.linalg.svd(one)[1] for one in (F, E))
    size, left = (np.linalg.norm(s - s.mean(1, keepdims=True), axis=1) for s in (U, Ue))
    limit = np.sqrt(2.0 / 3.0) * stress / (2.0 * MU)
    assert (size[:-1] > limit).all()
    np.testing.assert_allclose(left[:-1], limit, rtol=1e-12)  # rounding
    np.testing.assert_allclose(after[:-1, 0] - 0.1, np.sqrt(2.0 / 3.0) * (size - limit)[:-1])
    np.testing.assert_allclose(work, ((F - E) * P).sum((1, 2)), atol=1e-14)
    assert (work[:-1] > 0.0).all()
    assert (E[-1] == F[-1]).all()  # what does not flow is as it was
    assert after[-1, 0] == 0.1


def test_the_preset_is_not_there_yet() -> None:
    assert row("DimensionlessPreset(", dimensionless).name not in presets()


def test_the_reader_reads_and_refuses(made: Any, tmp_path: Path) -> None:
    reader = made("Medit .mesh files", "recipe_medit")
    file = tmp_path / "one.mesh"
    file.write_text(TETRAHEDRON, "utf-8")
    (node,) = reader.read_medit(file).nodes
    assert node.mesh.points.shape == (4, 3)
    assert node.mesh.indices.tolist()[:3] == [0, 2, 1]
    file.write_text(TETRAHEDRON.replace("\n4\n1 3 2", "\n5\n1 3 2"), "utf-8")
    with pytest.raises(InputError, match="no complete section Triangles"):
        reader.read_medit(file)
    assert row('name="Medit"', formats).read.endswith(":read_medit")


def test_the_output_prim_follows_its_points(made: Any) -> None:
    trails = made("A line from the rest position", "recipe_trails")
    stage = Usd.Stage.CreateInMemory()
    rest = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
    track = trails.TrailsTrack(stage, Sdf.Path("/Trails"), rest, 0.5)
    track.write(rest + [0.0, 2.0, 0.0], 3.0)
    curves = UsdGeom.BasisCurves(track.prim)
    assert [list(p) for p in curves.GetPointsAttr().Get(3.0)] == [
        [0, 0, 0], [0, 2, 0], [1, 0, 0], [1, 2, 0]
    ]  # fmt: skip
    assert [list(p) for p in curves.GetExtentAttr().Get(3.0)] == [
        [-0.25, -0.25, -0.25], [1.25, 2.25, 0.25]
    ]  # fmt: skip


def test_the_lines_that_the_output_prim_changes_are_there() -> None:
    source = Path(particles.__file__).read_text("utf-8")
    assert block("every = [").replace("self._trails, ", "").strip() in source
    assert block("self._transforms =").splitlines()[-1] in source
