"""Skeleton of the creature: 15 joints, smooth weights, a walk cycle and a jump of 32 frames."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FRAMES, FPS = 32, 24.0
GRAVITY = 981.0  # [cm/s^2]
INFLUENCES = 4  # joints of a vertex
SMOOTHINGS = 6  # passes over the mesh


@dataclass(frozen=True, kw_only=True)
class Joint:
    """A joint of the bind pose, which has no rotations, and the limb that it moves."""

    name: str
    parent: str
    at: tuple[float, float, float]
    limb: tuple[tuple[float, float, float], tuple[float, float, float]]
    radius: float


def sides(name: str, parent: str, at, limb, radius: float) -> tuple[Joint, Joint]:
    """The joint at x > 0, which is the creature's left, and its mirror image."""
    flip = (-1.0, 1.0, 1.0)
    right = f"{parent[:-1]}R" if parent.endswith("L") else parent
    mirrored = [tuple(a * s for a, s in zip(p, flip)) for p in (at, *limb)]
    return (
        Joint(name=f"{name}L", parent=parent, at=at, limb=limb, radius=radius),
        Joint(
            name=f"{name}R", parent=right, at=mirrored[0], limb=(mirrored[1], mirrored[2]),
            radius=radius,
        ),
    )  # fmt: skip


JOINTS = (
    Joint(name="Hips", parent="", at=(0, 16, 0), limb=((0, 13, 0), (0, 22, 1)), radius=11.0),
    Joint(name="Spine", parent="Hips", at=(0, 27, 0), limb=((0, 28, 0), (0, 34, 0)), radius=8.5),
    Joint(name="Head", parent="Spine", at=(0, 37, 0), limb=((0, 43, 2), (0, 50, 0)), radius=9.5),
    *sides("Ear", "Head", (6.0, 53, -0.6), ((7.0, 55, -0.6), (19, 69, -0.9)), 3.4),
    *sides("Arm", "Spine", (8.0, 33, 0), ((10.0, 32.5, 0), (17, 30.5, 0.4)), 3.4),
    *sides("Hand", "ArmL", (19.0, 29.8, 0.5), ((21.0, 29.2, 0.7), (23, 28.6, 0.8)), 3.6),
    *sides("Leg", "Hips", (7.2, 13.5, 0), ((7.5, 11.0, 0), (8.0, 7.5, 0)), 4.8),
    *sides("Foot", "LegL", (8.2, 4.5, 0), ((8.3, 3.6, 0), (8.6, 2.8, 8)), 4.0),
    Joint(
        name="Tail", parent="Hips", at=(0, 14, -8.5), limb=((0, 14, -12), (0, 14.5, -17)),
        radius=4.6,
    ),
    Joint(
        name="TailTip", parent="Tail", at=(0, 14.5, -18), limb=((0, 16, -19.5), (0, 21.5, -26)),
        radius=4.2,
    ),
)  # fmt: skip
NAMES = tuple(joint.name for joint in JOINTS)
PARENTS = tuple(NAMES.index(joint.parent) if joint.parent else -1 for joint in JOINTS)


def joint_paths() -> tuple[str, ...]:
    """Names with their parents, as UsdSkel has them."""
    paths: list[str] = []
    for joint, parent in zip(JOINTS, PARENTS):
        paths.append(f"{paths[parent]}/{joint.name}" if joint.parent else joint.name)
    return tuple(paths)


def offsets() -> Floats:
    """(joints, 3) translation of each joint from its parent in the bind pose."""
    at = np.array([joint.at for joint in JOINTS], dtype=float)
    return at - np.array([at[p] if p >= 0 else np.zeros(3) for p in PARENTS])


def weights(points: Floats, faces: Ints) -> tuple[Ints, Floats]:
    """Joints and weights (V, INFLUENCES): Gaussians of the distance to a limb over its radius.

    They are smoothed over the edges of the mesh; the largest are kept and sum to one.
    """
    scaled = np.stack(
        [_distance(points, np.array(j.limb, float)) / j.radius for j in JOINTS], axis=1
    )
    found = np.exp(-2.0 * (scaled**2 - scaled.min(axis=1, keepdims=True) ** 2))
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], -1).reshape(-1, 2)
    near = sparse.coo_matrix((np.ones(len(edges)), tuple(edges.T)), shape=(len(points),) * 2)
    near = (near + near.T).tocsr().sign() + sparse.identity(len(points))
    mean = sparse.diags_array(1.0 / np.asarray(near.sum(1)).ravel()) @ near
    found /= found.sum(axis=1, keepdims=True)
    for _ in range(SMOOTHINGS):
        found = mean @ found
    # On the middle plane left and right differ by rounding only, which depends on the processor.
    joints = np.argsort(-found.round(9), axis=1, kind="stable")[:, :INFLUENCES]
    largest = np.take_along_axis(found, joints, axis=1)
    largest = np.where(largest < 0.01, 0.0, largest)
    return joints, largest / largest.sum(axis=1, keepdims=True)


def _distance(p: Floats, limb: Floats) -> Floats:
    axis = limb[1] - limb[0]
    t = np.clip((p - limb[0]) @ axis / (axis @ axis), 0.0, 1.0)
    return np.linalg.norm(p - limb[0] - t[:, None] * axis, axis=1)


def walk(frame: int) -> dict[str, tuple[float, float, float]]:
    """Rotations [degrees] about x, y, z of the joints at a frame: two steps on the spot."""
    phase = 2.0 * np.pi * frame / FRAMES
    s, c = np.sin(phase), np.cos(phase)
    pose = {
        "Hips": (3.0, 5.0 * s, 7.0 * c),
        "Spine": (2.0 + 2.0 * np.cos(2.0 * phase), -11.0 * s, -8.0 * c),
        "Head": (-5.0 + 4.0 * np.sin(2.0 * phase), 6.0 * s, -3.0 * c),
        "Tail": (0.0, -14.0 * s, 0.0),
        "TailTip": (0.0, -16.0 * np.sin(phase - 0.9), 0.0),
    }
    for side, sign in (("L", 1.0), ("R", -1.0)):
        swing = sign * s
        lifted = max(0.0, sign * c)  # the leg that comes forward
        pose[f"Leg{side}"] = (-30.0 * swing - 14.0 * lifted, 0.0, -5.0 * c)
        pose[f"Foot{side}"] = (22.0 * swing + 20.0 * lifted, 0.0, -2.0 * c)
        pose[f"Arm{side}"] = (32.0 * swing, 0.0, -sign * (28.0 + 4.0 * np.cos(2.0 * phase)))
        pose[f"Hand{side}"] = (10.0 * swing, 0.0, -sign * 8.0)
        pose[f"Ear{side}"] = (0.0, 0.0, sign * 4.0 * np.cos(2.0 * phase))
    return pose


CROUCH = {0: 0.15, 7: 1.0, 11: -0.35, 16: 0.1, 21: -0.1, 24: 1.0, 29: 0.05, 32: 0.15}  # by frame
AIR = (10.5, 21.5)  # frames of take-off and landing


def jump(frame: int) -> dict[str, tuple[float, float, float]]:
    """Rotations [degrees] of a jump on the spot: crouch, fly, land, rise."""
    low = float(np.interp(frame, list(CROUCH), list(CROUCH.values())))
    pose = {
        "Hips": (10.0 * low, 0.0, 0.0),
        "Spine": (16.0 * low, 0.0, 0.0),
        "Head": (-20.0 * low, 0.0, 0.0),
        "Tail": (14.0 * low, 0.0, 0.0),
        "TailTip": (10.0 * low, 0.0, 0.0),
    }
    for side, sign in (("L", 1.0), ("R", -1.0)):
        pose[f"Leg{side}"] = (-48.0 * low, 0.0, 8.0 * sign * max(low, 0.0))
        pose[f"Foot{side}"] = (38.0 * low, 0.0, -8.0 * sign * max(low, 0.0))
        pose[f"Arm{side}"] = (40.0 * low, 0.0, -sign * (20.0 + 20.0 * low))
        pose[f"Hand{side}"] = (0.0, 0.0, -sign * 8.0)
        pose[f"Ear{side}"] = (8.0 * low, 0.0, 0.0)
    return pose


def height(frame: float) -> float:
    """[cm] of the soles above the ground in the jump: a free flight between the frames of AIR."""
    t, duration = (frame - AIR[0]) / FPS, (AIR[1] - AIR[0]) / FPS
    return 0.5 * GRAVITY * t * (duration - t) if 0.0 < t < duration else 0.0


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Local joint transforms of some frames."""

    rotations: Floats  # (frames, joints, 4) quaternions x, y, z, w
    translations: Floats  # (frames, joints, 3)


def motion(name: str, points: Floats, joints: Ints, weight: Floats) -> Motion:
    """`walk` or `jump`, its hips at such a height that the soles touch the ground y = 0."""
    rest = offsets()
    rotations, translations = [], []
    for frame in range(FRAMES):
        pose = walk(frame) if name == "walk" else jump(frame)
        turn = np.stack(
            [
                Rotation.from_euler("xyz", pose.get(n, (0, 0, 0)), degrees=True).as_quat()
                for n in NAMES
            ]
        )
        local = rest.copy()
        if name == "walk":
            local[0, 0] += 1.6 * np.cos(2.0 * np.pi * frame / FRAMES)
        lowest = skin(points, joints, weight, turn, local)[:, 1].min()
        local[0, 1] += (height(frame) if name == "jump" else 0.0) - lowest
        rotations.append(turn)
        translations.append(local)
    return Motion(rotations=np.stack(rotations), translations=np.stack(translations))


def skin(points: Floats, joints: Ints, weight: Floats, turn: Floats, local: Floats) -> Floats:
    """Linear blend skinning of (V, 3) bind points by one pose."""
    place = np.zeros((len(NAMES), 3, 4))
    at = np.array([joint.at for joint in JOINTS], dtype=float)
    world: list[tuple[Floats, Floats]] = []
    for k, parent in enumerate(PARENTS):
        R, t = Rotation.from_quat(turn[k]).as_matrix(), local[k]
        if parent >= 0:
            R, t = world[parent][0] @ R, world[parent][0] @ t + world[parent][1]
        world.append((R, t))
        place[k, :, :3], place[k, :, 3] = R, t - R @ at[k]
    blended = np.einsum("vk,vkij->vij", weight, place[joints])
    return np.einsum("vij,vj->vi", blended[..., :3], points) + blended[..., 3]
