"""Splat files mean the same to us, to gsply and to usd-convert-gsplat, in both directions."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest
from captures import ball
from client_runs import PROBES, needs, programs, run

from gf_usd.core.asset import Splats
from gf_usd.readers import read_asset
from gf_usd.readers.splats.ply import read_splat_ply
from gf_usd.readers.splats.spz import read_spz
from gf_usd.readers.splats.write import ply_bytes, spz_bytes

pytestmark = [pytest.mark.clients, needs("splats")]

SANITY = Path(__file__).parents[1] / "assets" / "SanitySplats.spz"
SINGLE = 2e-6  # some roundings of single precision, in logarithms and logits of size 10
DEGREES = (0, 1, 2, 3)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Our files of every degree, and what the others made of them and wrote themselves."""
    folder = tmp_path_factory.mktemp("splats")
    for degree in DEGREES:
        rest = capture(degree)
        (folder / f"ball{degree}.ply").write_bytes(ply_bytes(rest))
        (folder / f"ball{degree}.spz").write_bytes(spz_bytes(rest))
    (folder / "sanity.spz").write_bytes(SANITY.read_bytes())
    arguments = [] if has_nvidia() else ["no-nvidia"]
    run([programs("splats") / "python", PROBES / "splats_read.py", folder, *arguments])
    return folder


def has_nvidia() -> bool:
    python = str(programs("splats") / "python")
    done = subprocess.run(
        [python, "-c", "import usd_convert_gsplat"], check=False, capture_output=True
    )
    return done.returncode == 0


def capture(degree: int) -> Splats:
    """More than one chunk of 256, with opacities that have logits."""
    rest = ball(600, degree=degree)
    opacities = np.linspace(0.02, 0.98, len(rest))
    return Splats(**{**vars(rest), "opacities": opacities})


def same(ours: Splats, theirs: Path, *, turn: float = SINGLE, opacity: float = SINGLE) -> None:
    with np.load(theirs) as found:
        np.testing.assert_allclose(found["positions"], ours.positions, atol=SINGLE)
        np.testing.assert_allclose(found["scales"], np.log(ours.scales), atol=SINGLE)
        alpha = 1.0 / (1.0 + np.exp(-found["opacities"].reshape(-1)))
        np.testing.assert_allclose(alpha, ours.opacities, atol=opacity)
        np.testing.assert_allclose(found["harmonics"], ours.harmonics, atol=SINGLE)
        q = found["orientations"]
        q = q / np.linalg.norm(q, axis=1, keepdims=True)
        sign = np.sign((q * ours.orientations).sum(axis=1, keepdims=True))
        np.testing.assert_allclose(sign * q, ours.orientations, atol=turn)


@pytest.mark.parametrize("program", ["gsply", "nvidia"])
@pytest.mark.parametrize("degree", DEGREES)
def test_they_read_our_ply(folder, degree, program):
    theirs = folder / f"ball{degree}.ply.{program}.npz"
    if program == "nvidia" and not has_nvidia():
        pytest.skip("usd-convert-gsplat has no release for this Python")
    same(capture(degree), theirs)
    same(read_splat_ply(folder / f"ball{degree}.ply"), theirs)


@pytest.mark.parametrize("program", ["gsply", "nvidia"])
@pytest.mark.parametrize("name", ["ball0", "ball1", "ball2", "ball3", "sanity"])
def test_they_and_we_read_one_spz(folder, name, program):
    if program == "nvidia" and not has_nvidia():
        pytest.skip("usd-convert-gsplat has no release for this Python")
    ours = read_spz(folder / f"{name}.spz")
    # gsply keeps opacities of 0 and 1 off their infinite logits by 1e-4
    same(ours, folder / f"{name}.spz.{program}.npz", opacity=1e-4)


@pytest.mark.parametrize("degree", DEGREES)
def test_our_layer_is_theirs(folder, degree):
    """The Gaussians of a PLY file that was made into USD by usd-convert-gsplat, and by us."""
    if not has_nvidia():
        pytest.skip("usd-convert-gsplat has no release for this Python")
    (theirs,) = read_asset(folder / f"ball{degree}.nvidia.usdc").splats
    (ours,) = read_asset(folder / f"ball{degree}.ply").splats
    for name in ("positions", "scales", "orientations", "opacities", "harmonics"):
        np.testing.assert_allclose(getattr(theirs, name), getattr(ours, name), atol=SINGLE)


@pytest.mark.parametrize("kind", ["gsply", "gsply4"])
@pytest.mark.parametrize("degree", DEGREES)
def test_we_read_their_spz(folder, degree, kind):
    """Versions 3 and 4."""
    ours = read_spz(folder / f"ball{degree}.{kind}.spz")
    same(ours, folder / f"ball{degree}.{kind}.spz.gsply.npz", opacity=1e-4)


@pytest.mark.parametrize("degree", DEGREES)
def test_we_read_their_packed_ply(folder, degree):
    ours = read_splat_ply(folder / f"ball{degree}.packed.ply")
    theirs = folder / f"ball{degree}.packed.ply.gsply.npz"
    same(ours, theirs, turn=1e-5, opacity=1e-4)
