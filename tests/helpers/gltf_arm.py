"""The soft arm of `arm` as a glTF file: two joints below a node in centimeters, animated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import arm
import numpy as np
from mesh_makers import GltfMaker
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

SMALL = 0.01  # of the node above the joints: they are in centimeters
FPS = 24.0
FRAMES = arm.LAST - arm.FIRST + 1
BEND = (20.0, 60.0)  # [degrees] of the second joint about z


def triangles() -> list[list[int]]:
    """Of the arm's faces."""
    return [[f[0], f[k], f[k + 1]] for f in arm.faces() for k in range(1, len(f) - 1)]


def maker(*, tilt: float = 30.0, animated: bool = True, inverse: bool = True) -> GltfMaker:
    """The file in the making: nodes Figure, Armature, A, B and Skin; tilt : [degrees] of Figure.

    B turns at a constant rate, A rises by a cubic curve.
    """
    made = GltfMaker()
    weight = np.clip((arm.ALONG - 0.8) / 0.4, 0.0, 1.0).repeat(4)
    points = arm.points()
    weights = np.stack([1.0 - weight, weight, 0 * weight, 0 * weight], 1).astype(np.float32)
    joints = np.tile(np.array([0, 1, 0, 0], np.uint8), (len(points), 1))
    made.mesh(
        made.primitive(points, triangles(), JOINTS_0=joints, WEIGHTS_0=weights),
        name="Skin", skin=0,
    )  # fmt: skip
    quaternion = Rotation.from_euler("x", tilt, degrees=True).as_quat().tolist()
    made.tree["nodes"] += [
        {"name": "Figure", "rotation": quaternion, "translation": [0, 1, 0], "children": [2]},
        {"name": "Armature", "scale": [SMALL] * 3, "children": [3]},
        {"name": "A", "children": [4]},
        {"name": "B", "translation": [1.0 / SMALL, 0, 0]},
    ]
    bind = np.tile(np.diag([1.0 / SMALL] * 3 + [1.0]), (2, 1, 1))  # row vectors: by columns
    bind[1, 3, 0] = -1.0 / SMALL
    skin: dict[str, Any] = {"joints": [3, 4]}
    if inverse:
        skin["inverseBindMatrices"] = made.accessor(bind.reshape(2, 16).astype(np.float32))
    made.tree["skins"] = [skin]
    made.tree["scenes"], made.tree["scene"] = [{"nodes": [0, 1]}], 0
    if animated:
        animate(made)
    return made


def animate(made: GltfMaker) -> None:
    """Add the animation."""
    last = (FRAMES - 1) / FPS
    ends = made.accessor(np.array([0.0, last], np.float32))
    turns = Rotation.from_euler("z", np.array(BEND)[:, None], degrees=True).as_quat()
    rise = np.zeros((2, 3, 3), np.float32)  # in-tangent, value, out-tangent of two keys
    rise[0, 2, 1], rise[1, 1, 1], rise[1, 0, 1] = 30.0, 20.0, -10.0
    samplers: list[dict[str, Any]] = [
        {"input": ends, "output": made.accessor(turns.astype(np.float32))},
        {
            "input": ends,
            "output": made.accessor(rise.reshape(6, 3)),
            "interpolation": "CUBICSPLINE",
        },
    ]
    made.tree["animations"] = [
        {
            "name": "wave",
            "samplers": samplers,
            "channels": [
                {"sampler": 0, "target": {"node": 4, "path": "rotation"}},
                {"sampler": 1, "target": {"node": 3, "path": "translation"}},
            ],
        }
    ]


def posed(
    frame: float, *, tilt: float = 30.0, offsets: NDArray[np.float64] | float = 0.0
) -> NDArray[np.float64]:
    """(V, 3) [m] of the skin at a frame from 0 on, by the equations of glTF 2.0.

    offsets : (V, 3) [m] of morph targets, which come before the skinning.
    """
    s, d = frame / (FRAMES - 1), (FRAMES - 1) / FPS
    rise = (3 * s**2 - 2 * s**3) * 20.0
    rise += d * ((s**3 - 2 * s**2 + s) * 30.0 + (s**3 - s**2) * -10.0)
    bend = Rotation.from_euler("z", BEND[0] + s * (BEND[1] - BEND[0]), degrees=True).as_matrix()
    turn = Rotation.from_euler("x", tilt, degrees=True).as_matrix()
    X = arm.points() + offsets
    weight = np.clip((arm.ALONG - 0.8) / 0.4, 0.0, 1.0).repeat(4)[:, None]
    elbow = np.array([1.0, 0.0, 0.0])
    there = (1.0 - weight) * X + weight * ((X - elbow) @ bend.T + elbow)
    return (there + [0.0, SMALL * rise, 0.0]) @ turn.T + [0.0, 1.0, 0.0]


def write(folder: Path, made: GltfMaker | None = None) -> Path:
    """The file arm.glb in a folder."""
    return (made or maker()).glb(folder / "arm.glb")
