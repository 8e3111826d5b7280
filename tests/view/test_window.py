"""What a window needs, shows and does, without opening one."""

from __future__ import annotations

import ctypes
import importlib

import numpy as np
import pytest
from recordings import BOX, TRIANGLES, FallingBox, MeltingBox

from gf_usd.core.errors import UsageError
from gf_usd.view import window
from gf_usd.view.window import (
    Clock,
    EllipsoidMesh,
    ShadedMesh,
    floor_lines,
    icosahedron,
    mesh_at_frame,
)


class Now:
    """A clock that stands still until it is moved."""

    seconds = 100.0

    def __call__(self) -> float:
        return self.seconds


def test_it_plays_in_real_time_and_starts_again():
    now = Now()
    clock = Clock([0.0, 0.1, 0.2], now)
    seen = []
    for tenth in range(8):
        now.seconds = 100.0 + 0.1 * tenth + 0.05
        clock.tick()
        seen.append(clock.frame)
    assert seen == [0, 1, 2, 0, 1, 2, 0, 1]
    assert not clock.tick()


def test_it_pauses_steps_and_goes_on_from_there():
    now = Now()
    clock = Clock([0.0, 0.1, 0.2], now)
    clock.step(-1)
    assert (clock.frame, clock.playing) == (2, False)
    now.seconds += 5.0
    assert not clock.tick()
    clock.step(1)
    clock.step(1)
    clock.toggle()
    now.seconds += 0.12
    assert clock.tick()
    assert clock.frame == 2  # 0.1 s of frame 1 and 0.12 s more
    clock.rewind()
    assert clock.frame == 0


def test_a_balls_normals_stand_on_its_ellipsoid():
    corners, faces = icosahedron()
    assert (corners.shape, faces.shape) == ((12, 3), (20, 3))
    cloud = FallingBox(gaussians=5).recording().gaussians
    balls = EllipsoidMesh(cloud)
    rng = np.random.default_rng(2)
    positions, axes = rng.standard_normal((5, 3)), rng.standard_normal((5, 3, 3))
    points, normals = balls.pose(positions, axes)
    for i in range(5):
        x = points[12 * i : 12 * i + 12] - positions[i]
        # f(x) = x' (A A')^-1 x is 1 on the ellipsoid, and its gradient is the normal
        gradient = np.linalg.solve(axes[i] @ axes[i].T, x.T).T
        assert np.einsum("ij,ij->i", x, gradient) == pytest.approx(np.ones(12), rel=1e-6)
        gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
        assert normals[12 * i : 12 * i + 12] == pytest.approx(gradient, abs=1e-6)
    assert balls.triangles.max() == 59
    assert balls.colors.shape == (60, 3)


def test_a_box_has_flat_sides():
    skin = ShadedMesh(FallingBox().recording().meshes)
    points, normals = skin.pose((BOX,))
    assert points[skin.triangles] == pytest.approx(BOX[TRIANGLES])
    assert np.sort(np.abs(normals), axis=1) == pytest.approx(np.tile([0, 0, 1], (24, 1)))


def test_a_surface_whose_faces_change_has_the_faces_of_its_frame():
    box = MeltingBox()
    recording = box.recording()
    whole = ShadedMesh(recording.meshes)
    counts = []
    for frame in box.frames(recording.time_codes):
        skin = mesh_at_frame(recording, whole, frame)
        points, _ = skin.pose(tuple(mesh.points for mesh in frame.flows))
        (mesh,) = frame.flows
        assert points[skin.triangles] == pytest.approx(mesh.points[mesh.triangles])
        counts.append(len(skin.triangles))
    assert counts == [11, 12, 11, 12, 11, 12, 11]
    assert len(whole.pose(())[0]) == 0
    solid = FallingBox().recording()
    skin = ShadedMesh(solid.meshes)
    assert mesh_at_frame(solid, skin, next(iter(FallingBox().frames([1.0])))) is skin


def test_the_floor_lies_under_the_box():
    lines = floor_lines(np.zeros(3), np.array([1.0, 2.0, 4.0]), np.array([0, 0, 1.0]), -0.5)
    assert (lines[..., 2] == -0.5).all()
    assert lines[..., :2].mean(axis=(0, 1)) == pytest.approx([0.5, 1.0])


def test_no_open3d_is_said_with_the_extra(monkeypatch):
    def gone(name):
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    monkeypatch.setattr(importlib, "import_module", gone)
    with pytest.raises(UsageError, match="Python module open3d") as caught:
        window.import_open3d()
    assert "pip install open3d" in caught.value.hint


def test_a_missing_library_is_said_with_its_package(monkeypatch):
    def broken(name):
        raise ImportError("libusb-1.0.so.0: cannot open shared object file")

    monkeypatch.setattr(importlib, "import_module", broken)
    with pytest.raises(UsageError, match=r"libusb-1\.0\.so\.0") as caught:
        window.import_open3d()
    assert "apt-get install" in caught.value.hint
    assert "libusb-1.0-0" in caught.value.hint


@pytest.mark.parametrize(
    ("display", "words"),
    [(None, "DISPLAY is not set"), ("", "DISPLAY is not set"), (":9731", "cannot be opened")],
)
def test_no_display_is_said_before_a_window_is_tried(monkeypatch, display, words):
    monkeypatch.setattr(window.sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    if display is not None:
        monkeypatch.setenv("DISPLAY", display)
    with pytest.raises(UsageError, match=words) as caught:
        window.require_display()
    assert "gf-usd report" in caught.value.hint


def test_no_x11_is_said_with_its_package(monkeypatch):
    def gone(name):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setattr(window.sys, "platform", "linux")
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(ctypes, "CDLL", gone)
    with pytest.raises(UsageError, match="libX11") as caught:
        window.require_display()
    assert "libx11-6" in caught.value.hint
