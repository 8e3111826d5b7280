"""Which meshes of several joints are held by flesh with a core."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh

from gf_usd.geometry.flesh.cores import Core, Cores
from gf_usd.geometry.flesh.single_joint import accessories, loose_meshes

CELL = 0.25
# heights [m] of the lower and the upper end of boxes, the first of which has the core
SPANS = {"body": (0.0, 1.0), "belt": (0.9, 1.1), "plume": (1.2, 4.2), "hat": (5.0, 5.4)}


def boxes(**spans: tuple[float, float]) -> Any:
    """A solid of boxes, which have points every tenth of a meter."""
    surfaces, triangles = [], []
    for path, (low, high) in spans.items():
        box = trimesh.creation.box((0.5, high - low, 0.5))
        box = box.subdivide_to_size(0.1).apply_translation((0.0, 0.5 * (low + high), 0.0))
        surfaces.append(SimpleNamespace(path=path, points=np.asarray(box.vertices)))
        triangles.append(np.asarray(box.faces))
    return SimpleNamespace(surfaces=surfaces, triangles=triangles)


def loose(carried: dict[str, int] | None = None, **spans: tuple[float, float]) -> Any:
    axis = np.linspace((0.0, 0.2, 0.0), (0.0, 0.8, 0.0), 5)
    core = Core(bone=0, points=axis, radius=np.array([0.0, 0.1, 0.1, 0.1, 0.0]))
    skeleton: Any = SimpleNamespace(weights=dict.fromkeys(spans))
    return loose_meshes(skeleton, carried or {}, boxes(**spans), Cores(cores=(core,)), CELL)


def test_what_no_flesh_reaches_is_loose_and_what_it_reaches_at_its_end_is_measured():
    left, near = loose(**SPANS)
    assert left == ["hat"]
    assert set(near) == {"belt", "plume"}, "the belt holds the plume"
    assert near["belt"] == 1.0
    # the lowest of its 3 m are within a cell of the belt, 0.15 m and its end
    assert near["plume"] == pytest.approx(0.15 / 3.0, abs=0.06)


def test_a_coat_whose_wall_a_core_goes_through_is_not_held_by_it() -> None:
    """A thick coat was held by the cores of the arms in its wall, and hung to twice its length."""
    left, near = loose(body=(0.0, 1.0), coat=(0.6, 3.0))
    assert left == []
    # what is in the body or within a cell of it
    assert near == {"coat": pytest.approx((1.0 + CELL - 0.6) / 2.4, abs=0.06)}


def test_meshes_of_one_joint_and_bodies_without_cores_are_not_judged():
    assert loose({"hat": 0}, **SPANS)[0] == []
    assert loose(hat=SPANS["hat"]) == ([], {})


def test_accessories_have_no_core_that_is_not_in_other_flesh_too() -> None:
    spans = {"neck": (0.0, 1.0), "head": (0.9, 2.0), "hat": (1.9, 2.5), "scarf": (0.3, 0.7)}
    axis = np.linspace((0.0, 0.2, 0.0), (0.0, 1.6, 0.0), 15)
    core = Core(bone=0, points=axis, radius=np.full(15, 0.1))
    bound = {"head": 0, "hat": 0, "scarf": 0}
    # the core is also in the neck where it is in the scarf, but not all of it in the head
    cores = Cores(cores=(core,))
    assert accessories(list(bound), bound, boxes(**spans), cores) == ["hat", "scarf"]


def test_without_cores_every_mesh_of_one_joint_is_an_accessory_and_none_is_judged() -> None:
    """Where no bone was in the flesh, there was a traceback instead of the refusal."""
    solid, none = boxes(**SPANS), Cores(cores=())
    assert accessories([], {}, solid, none) == []
    assert accessories(["hat"], {"hat": 0}, solid, none) == ["hat"]
    skeleton: Any = SimpleNamespace(weights=dict.fromkeys(SPANS))
    assert loose_meshes(skeleton, {}, solid, none, CELL) == ([], {})
