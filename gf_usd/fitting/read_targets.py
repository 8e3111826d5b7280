"""Targets from files: animated meshes of the asset, and tracked points."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError, counted
from gf_usd.core.scene import Recording
from gf_usd.core.units import code_text, length_text
from gf_usd.fitting.observation import Scene, TrackedPoints, vertices_as_points
from gf_usd.fitting.targets import Motion, TargetSpec, points_sigma
from gf_usd.geometry.surface import barycentric
from gf_usd.readers.pictures.recording import BakedMotion
from gf_usd.readers.tracks import Tracks, read_tracks
from gf_usd.view.compare import Y_UP_TO_Z_UP

MAX_POINTS = 100  # of a mesh that are compared: more add little information
MAX_DISTANCE = 0.1  # [radii] of a track from the surface; others belong to something else
Z_UP = 0.5  # threshold of the z component of a unit vector


def read_motion(spec: TargetSpec, scene: Scene) -> tuple[Motion, tuple[str, ...]]:
    """The points of a file over time, and notes on assumptions.

    Meshes are paired with those of the asset by path, else name, else number of points.  Times are
    those of the samples of the file, without those before the first frame.

    Raises InputError where the file cannot be read, contains nothing of the asset, or has no time
    after the first frame.
    """
    assert spec.file is not None
    motion = _moving_meshes(spec.file)
    recording = motion.recording() if motion else None
    pairs = _pair_meshes(recording, scene) if recording else {}
    if not pairs and (tracks := read_tracks(spec.file)) is not None:
        return attach_tracks(spec, tracks, scene)
    if motion is None or recording is None:
        raise InputError(
            f"{spec.file} contains neither moving meshes nor tracked points",
            "export a point cache of the asset, or tracks as curves (see docs/fit.md)",
        )
    if not pairs:
        own = ", ".join(f"<{path}> of {len(x)} points" for path, x in scene.surfaces.items())
        others = ", ".join(f"<{m.name}> of {len(m.points)}" for m in recording.meshes) or "none"
        raise InputError(
            f"{spec.file} contains no mesh of the asset: it has {others}, but the asset has {own}",
            "export the same mesh, or tracked points (see docs/fit.md)",
        )
    rate = recording.time_codes_per_second
    start_seconds = scene.start / scene.time_codes_per_second
    codes = [c for c in recording.time_codes if c / rate - start_seconds > -1e-6]
    seconds = np.array([code / rate - start_seconds for code in codes])
    require_times(spec.file, seconds, recording.time_codes, scene)
    chosen = {path: farthest_points(scene.surfaces[path], MAX_POINTS) for path in pairs}
    rotation = _up_axis_rotation(recording.up, scene)
    rows = [
        np.concatenate([frame.meshes[k][chosen[path]] @ rotation.T for path, k in pairs.items()])
        for frame in motion.frames(codes)
    ]
    notes = [
        f"{spec.file.name}: <{recording.meshes[k].name}> is compared with <{path}>"
        for path, k in pairs.items()
        if recording.meshes[k].name != path
    ]
    if not np.array_equal(rotation, np.eye(3)):
        notes.append(f"{spec.file.name} has another up axis and is rotated to that of the asset")
    found = Motion(
        name=spec.file.name,
        tracked=tuple(vertices_as_points(path, chosen[path]) for path in pairs),
        seconds=seconds,
        x=np.array(rows),
        sigma=points_sigma(spec, scene),
        stated=spec.sigma is not None,
    )
    return found, tuple(notes)


def require_times(file: Path, seconds: Floats, codes: Sequence[float], scene: Scene) -> None:
    """Raise InputError where all times [s] are before the first frame or at it."""
    if not (seconds > 1e-6).any():
        raise InputError(
            f"{file}: its time codes {code_text(min(codes))} to {code_text(max(codes))} are not"
            f" after the first frame, at {scene.start / scene.time_codes_per_second:.4g} s",
            "--start sets the time code of the first frame",
        )


def _pair_meshes(recording: Recording, scene: Scene) -> dict[str, int]:
    """Indices of meshes of the file, by the prim path of the asset's mesh that they pair with."""
    unpaired = list(range(len(recording.meshes)))
    pairs: dict[str, int] = {}
    for same in (_full_path, _last_component):
        for path, x in scene.surfaces.items():
            candidates = [
                k for k in unpaired
                if same(recording.meshes[k].name) == same(path)
                and len(recording.meshes[k].points) == len(x)
            ]  # fmt: skip
            if path not in pairs and len(candidates) == 1:
                pairs[path] = candidates[0]
                unpaired.remove(candidates[0])
    for path, x in scene.surfaces.items():
        candidates = [k for k in unpaired if len(recording.meshes[k].points) == len(x)]
        if not pairs and len(scene.surfaces) == 1 and len(candidates) == 1:
            pairs[path] = candidates[0]
    return pairs


def _full_path(name: str) -> str:
    return name


def _last_component(name: str) -> str:
    return name.rsplit("/", 1)[-1]


def _up_axis_rotation(up: Sequence[float], scene: Scene) -> Floats:
    """Rotation (3, 3) from a file's up axis to the asset's."""
    others, own = up[2] > Z_UP, scene.up[2] > Z_UP
    if others == own:
        return np.eye(3)
    return Y_UP_TO_Z_UP if own else Y_UP_TO_Z_UP.T


def _moving_meshes(file: Path) -> BakedMotion | None:
    """The animated meshes of a file; None where it has tracks instead."""
    if not file.is_file():
        raise InputError(f"{file} does not exist", "check the spelling of --target")
    try:
        return BakedMotion(file)
    except InputError:
        if read_tracks(file) is None:
            raise
        return None


def attach_tracks(spec: TargetSpec, tracks: Tracks, scene: Scene) -> tuple[Motion, tuple[str, ...]]:
    """Attach tracks to the nearest points of the surfaces at the first frame.

    Tracks that begin later or are not on a surface are omitted, with a note.

    Raises InputError where no track remains.
    """
    assert spec.file is not None
    rate, half = tracks.time_codes_per_second, 0.5 / scene.fps
    seconds = tracks.time_codes / rate - scene.start / scene.time_codes_per_second
    x = tracks.x @ _up_axis_rotation(tracks.up, scene).T
    first = int(np.argmin(np.abs(seconds)))
    require_times(spec.file, seconds, tracks.time_codes.tolist(), scene)
    visible = np.isfinite(x[first]).all(axis=1) & (abs(seconds[first]) <= half)
    positions = np.where(visible[:, None], x[first], 0.0)
    path, triangle, weights, distance = _closest_surface_points(positions, scene)
    on_surface = visible & (distance <= MAX_DISTANCE * scene.radius)
    if not on_surface.any():
        nearest = distance[visible].min(initial=np.inf)
        raise InputError(
            f"{spec.file}: none of {len(on_surface)} tracks is on the asset at its first frame; "
            f"{int(visible.sum())} are visible then, the nearest is {length_text(nearest)} away,"
            f" and the body has a radius of {length_text(scene.radius)}",
            "check the units and the position of the tracks, and --start and --drop of the body",
        )
    notes = []
    if unpaired := int((~visible).sum()):
        notes.append(
            f"{spec.file.name}: {counted(unpaired, 'track')} not visible at the first frame:"
            " left out"
        )
    if off_surface := int((visible & ~on_surface).sum()):
        notes.append(f"{spec.file.name}: {counted(off_surface, 'track')} off the surface: left out")
    order = [k for name in scene.surfaces for k in np.flatnonzero(on_surface) if path[k] == name]
    from_start = seconds > -1e-6
    tracked = []
    for name in scene.surfaces:
        candidates = [k for k in order if path[k] == name]
        if candidates:
            vertices = scene.triangles[name][triangle[candidates]]
            tracked.append(TrackedPoints(path=name, vertices=vertices, weights=weights[candidates]))
    found = Motion(
        name=spec.file.name,
        tracked=tuple(tracked),
        seconds=seconds[from_start],
        x=x[from_start][:, order],
        sigma=points_sigma(spec, scene),
        stated=spec.sigma is not None,
    )
    return found, tuple(notes)


def _closest_surface_points(
    positions: Floats, scene: Scene
) -> tuple[list[str], Ints, Floats, Floats]:
    """Path, triangle, barycentric weights (n, 3) and distance [m] of the closest surface points."""
    import igl

    path = [""] * len(positions)
    triangle, weights = np.zeros(len(positions), np.int64), np.zeros((len(positions), 3))
    min_distance = np.full(len(positions), np.inf)
    for name, x in scene.surfaces.items():
        faces = np.asarray(scene.triangles[name], np.int64)
        if not len(faces):
            continue
        found: Any = igl.point_mesh_squared_distance(positions, x, faces)
        squared, face, closest = found[:3]
        distances = np.sqrt(np.maximum(squared, 0.0))
        corners = np.moveaxis(x[faces[face]], 1, 0)
        nearer = distances < min_distance
        for k in np.flatnonzero(nearer):
            path[k] = name
        triangle[nearer], min_distance[nearer] = face[nearer], distances[nearer]
        weights[nearer] = barycentric(closest, *corners)[nearer]
    return path, triangle, weights, min_distance


def farthest_points(points: Floats, most: int) -> Ints:
    """Indices of at most `most` points (n, 3) by farthest point sampling."""
    if len(points) <= most:
        return np.arange(len(points))
    chosen = [int(np.argmax(np.linalg.norm(points - points.mean(0), axis=1)))]
    distances = np.full(len(points), np.inf)
    while len(chosen) < most:
        distances = np.minimum(distances, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distances)))
    return np.array(sorted(chosen))
