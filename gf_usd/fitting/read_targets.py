"""Targets out of files: meshes that move as the asset's do, and tracked points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError, counted
from gf_usd.core.scene import Recording
from gf_usd.fitting.observation import Followed, Scene, corner
from gf_usd.fitting.targets import Asked, Motion, points_sigma
from gf_usd.geometry.surface import barycentric
from gf_usd.readers.pictures.recording import BakedMotion
from gf_usd.readers.tracks import Tracks, read_tracks
from gf_usd.view.compare import TO_Z

MOST = 100  # points of a mesh that are compared: they are spread, and more tell little more
OFF = 0.1  # radii: a track that is farther from the surface is of something else
Z_UP = 0.5  # of the component along z of a unit vector


def read_motion(asked: Asked, scene: Scene) -> tuple[Motion, tuple[str, ...]]:
    """The points of a file over time, and notes on what was assumed.

    Points of meshes are those of the asset's meshes of the same path, else name, else number of
    points.  Times are those of the file's samples; what is before the first frame is left out.

    Raises InputError where the file cannot be read, shows nothing of the asset, or no time of it
    lies after the first frame.
    """
    assert asked.file is not None
    motion = _moving_meshes(asked.file)
    recording = motion.recording() if motion else None
    pairs = _pairs(recording, scene) if recording else {}
    if not pairs and (tracks := read_tracks(asked.file)) is not None:
        return attached(asked, tracks, scene)
    if motion is None or recording is None:
        raise InputError(
            f"{asked.file} contains neither moving meshes nor tracked points",
            "export a point cache of the asset, or tracks as curves (see docs/fit.md)",
        )
    if not pairs:
        ours = ", ".join(f"<{path}> of {len(x)} points" for path, x in scene.surfaces.items())
        theirs = ", ".join(f"<{m.name}> of {len(m.points)}" for m in recording.meshes) or "none"
        raise InputError(
            f"{asked.file} contains no mesh of the asset: it has {theirs}, but the asset has "
            f"{ours}",
            "export the same mesh, or tracked points (see docs/fit.md)",
        )
    rate = recording.time_codes_per_second
    begin = scene.start / scene.time_codes_per_second
    codes = [c for c in recording.time_codes if c / rate - begin > -1e-6]
    seconds = np.array([code / rate - begin for code in codes])
    require_times(asked.file, seconds, recording.time_codes, scene)
    chosen = {path: spread(scene.surfaces[path], MOST) for path in pairs}
    turn = _turn(recording.up, scene)
    rows = [
        np.concatenate([frame.meshes[k][chosen[path]] @ turn.T for path, k in pairs.items()])
        for frame in motion.frames(codes)
    ]
    notes = [
        f"{asked.file.name}: <{recording.meshes[k].name}> is compared with <{path}>"
        for path, k in pairs.items()
        if recording.meshes[k].name != path
    ]
    if not np.array_equal(turn, np.eye(3)):
        notes.append(f"{asked.file.name} has another up axis and is rotated to that of the asset")
    found = Motion(
        name=asked.file.name,
        followed=tuple(corner(path, chosen[path]) for path in pairs),
        seconds=seconds,
        x=np.array(rows),
        sigma=points_sigma(asked, scene),
        stated=asked.sigma is not None,
    )
    return found, tuple(notes)


def require_times(file: Path, seconds: Floats, codes: Sequence[float], scene: Scene) -> None:
    """Raise InputError where no time [s] after the first frame is there to be compared."""
    if not (seconds > 1e-6).any():
        raise InputError(
            f"{file}: its time codes {min(codes):g} to {max(codes):g} are not after the first"
            f" frame, at {scene.start / scene.time_codes_per_second:.4g} s",
            "--start sets the time code of the first frame",
        )


def _pairs(recording: Recording, scene: Scene) -> dict[str, int]:
    """Which mesh of the file is which of the asset, by the asset's prim path."""
    left = list(range(len(recording.meshes)))
    pairs: dict[str, int] = {}
    for same in (_path, _name):
        for path, x in scene.surfaces.items():
            mine = [
                k for k in left
                if same(recording.meshes[k].name) == same(path)
                and len(recording.meshes[k].points) == len(x)
            ]  # fmt: skip
            if path not in pairs and len(mine) == 1:
                pairs[path] = mine[0]
                left.remove(mine[0])
    for path, x in scene.surfaces.items():
        mine = [k for k in left if len(recording.meshes[k].points) == len(x)]
        if not pairs and len(scene.surfaces) == 1 and len(mine) == 1:
            pairs[path] = mine[0]
    return pairs


def _path(name: str) -> str:
    return name


def _name(name: str) -> str:
    return name.rsplit("/", 1)[-1]


def _turn(up: Sequence[float], scene: Scene) -> Floats:
    """(3, 3) rotation from a file's up axis to the asset's."""
    theirs, ours = up[2] > Z_UP, scene.up[2] > Z_UP
    if theirs == ours:
        return np.eye(3)
    return TO_Z if ours else TO_Z.T


def _moving_meshes(file: Path) -> BakedMotion | None:
    """The moving meshes of a file; None where nothing of the kind moves."""
    if not file.is_file():
        raise InputError(f"{file} does not exist", "check the spelling of --target")
    try:
        return BakedMotion(file)
    except InputError:
        if read_tracks(file) is None:
            raise
        return None


def attached(asked: Asked, tracks: Tracks, scene: Scene) -> tuple[Motion, tuple[str, ...]]:
    """Tracks as points of the surfaces that they lie on at the first frame.

    Those that begin later or lie off the surfaces are left out, which a note says.

    Raises InputError where none is left.
    """
    assert asked.file is not None
    rate, half = tracks.time_codes_per_second, 0.5 / scene.fps
    seconds = tracks.time_codes / rate - scene.start / scene.time_codes_per_second
    turned = tracks.x @ _turn(tracks.up, scene).T
    first = int(np.argmin(np.abs(seconds)))
    require_times(asked.file, seconds, tracks.time_codes.tolist(), scene)
    there = np.isfinite(turned[first]).all(axis=1) & (abs(seconds[first]) <= half)
    places = np.where(there[:, None], turned[first], 0.0)
    path, triangle, weights, distance = _on_surfaces(places, scene)
    good = there & (distance <= OFF * scene.radius)
    if not good.any():
        nearest = distance[there].min(initial=np.inf)
        raise InputError(
            f"{asked.file}: none of {len(good)} tracks is on the asset at its first frame; "
            f"{int(there.sum())} are visible then, the nearest is {nearest:.3g} m away, and the "
            f"body has a radius of {scene.radius:.3g} m",
            "check the units and the position of the tracks, and --start and --drop of the body",
        )
    notes = []
    if left := int((~there).sum()):
        notes.append(
            f"{asked.file.name}: {counted(left, 'track')} not visible at the first frame: left out"
        )
    if off := int((there & ~good).sum()):
        notes.append(f"{asked.file.name}: {counted(off, 'track')} off the surface: left out")
    order = [k for name in scene.surfaces for k in np.flatnonzero(good) if path[k] == name]
    after = seconds > -1e-6
    followed = []
    for name in scene.surfaces:
        mine = [k for k in order if path[k] == name]
        if mine:
            vertices = scene.triangles[name][triangle[mine]]
            followed.append(Followed(path=name, vertices=vertices, weights=weights[mine]))
    found = Motion(
        name=asked.file.name,
        followed=tuple(followed),
        seconds=seconds[after],
        x=turned[after][:, order],
        sigma=points_sigma(asked, scene),
        stated=asked.sigma is not None,
    )
    return found, tuple(notes)


def _on_surfaces(places: Floats, scene: Scene) -> tuple[list[str], Ints, Floats, Floats]:
    """Path, triangle, barycentric weights (n, 3) and distance [m] of the nearest surface points."""
    import igl

    path = [""] * len(places)
    triangle, weights = np.zeros(len(places), np.int64), np.zeros((len(places), 3))
    least = np.full(len(places), np.inf)
    for name, x in scene.surfaces.items():
        faces = np.asarray(scene.triangles[name], np.int64)
        if not len(faces):
            continue
        found: Any = igl.point_mesh_squared_distance(places, x, faces)
        squared, at, closest = found[:3]
        away = np.sqrt(np.maximum(squared, 0.0))
        corners = np.moveaxis(x[faces[at]], 1, 0)
        nearer = away < least
        for k in np.flatnonzero(nearer):
            path[k] = name
        triangle[nearer], least[nearer] = at[nearer], away[nearer]
        weights[nearer] = barycentric(closest, *corners)[nearer]
    return path, triangle, weights, least


def spread(points: Floats, most: int) -> Ints:
    """Up to so many of the points (n, 3), each the farthest from those before it."""
    if len(points) <= most:
        return np.arange(len(points))
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(0), axis=1)))]
    away = np.full(len(points), np.inf)
    while len(chosen) < most:
        away = np.minimum(away, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(away)))
    return np.array(sorted(chosen))
