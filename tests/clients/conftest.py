"""The bakes that the clients are given; each is made once in a session."""

from __future__ import annotations

from pathlib import Path

import pytest
from client_assets import Baked, bake_arm, bake_blocks, bake_duck, bake_obj

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="session")
def duck(tmp_path_factory: pytest.TempPathFactory) -> Baked:
    """The sample duck with three variants: centimeters, Y up, normals, UVs, subsets."""
    return bake_duck(ROOT / "samples" / "duck.usda", tmp_path_factory.mktemp("duck"))


@pytest.fixture(scope="session")
def blocks(tmp_path_factory: pytest.TempPathFactory) -> Baked:
    """Centimeters, Z up, 30 fps, nested, turned, unevenly scaled and mirrored meshes."""
    return bake_blocks(tmp_path_factory.mktemp("blocks"))


@pytest.fixture(scope="session")
def sparse(tmp_path_factory: pytest.TempPathFactory) -> Baked:
    """The same blocks so slow that samples can be left out within the precision."""
    few = {"precision": "5%", "adaptive_samples": True, "time_scale": 0.2}
    return bake_blocks(tmp_path_factory.mktemp("sparse"), **few)


@pytest.fixture(scope="session")
def character(tmp_path_factory: pytest.TempPathFactory) -> Baked:
    """Flesh on a skeleton, which must not pose it a second time."""
    return bake_arm(tmp_path_factory.mktemp("character"))


@pytest.fixture(scope="session")
def apart(tmp_path_factory: pytest.TempPathFactory) -> Baked:
    """The same blocks as two bodies of two materials."""
    return bake_blocks(tmp_path_factory.mktemp("apart"), combine=False)


@pytest.fixture(scope="session")
def obj(tmp_path_factory: pytest.TempPathFactory) -> Baked:
    """An OBJ file of meters, Y up."""
    return bake_obj(tmp_path_factory.mktemp("obj"))
