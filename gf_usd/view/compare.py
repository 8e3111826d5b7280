"""Distance between two motions of the same meshes, point by point over time.

With x_i(t) the points of one motion and y_i(t) those of the other, in meters and in the world
frame of the first, a comparison has for each time

    largest = max_i |x_i - y_i|          rms = sqrt(mean_i |x_i - y_i|^2)

the volume of each motion, V = sum over triangles (a, b, c) of a . (b x c) / 6 (divergence theorem),
and the distance of their centers of mass.  The center of mass is that of a homogeneous solid, the
mean of the centroids (a + b + c) / 4 of the same tetrahedra weighted by their volumes; for an open
surface, which encloses no volume, it is the mean of the points.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, Protocol

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.errors import InputError, UsageError, listed_paths
from gf_usd.core.scene import MotionFrame, Recording, RenderMesh
from gf_usd.core.units import code_text

Align = Literal["time", "start"]
# rotation from Y up to Z up: (x, y, z) becomes (x, -z, y)
Y_UP_TO_Z_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
MIN_VOLUME_SHARE = 1e-6  # of the bounding box: a surface that encloses less counts as open
SAME_TIME = 1e-6  # [time codes] tolerance of equal times


class Source(Protocol):
    """A motion that can be evaluated at any time code."""

    def recording(self) -> Recording: ...

    def frames(self, time_codes: Sequence[float]) -> Iterator[MotionFrame]: ...


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Two motions, A and B, at the T time codes of A that both have."""

    meshes: tuple[tuple[str, str], ...]  # prim paths that were compared, in A and in B
    points: int  # of these meshes
    radius: float  # [m] of a sphere of A's volume at its first frame
    time_codes: Floats  # (T,) of A
    other_time_codes: Floats  # (T,) of B at the same moments
    seconds: Floats  # (T,) [s] of playback since A's first frame
    largest: Floats  # (T,) [m] largest distance of a point
    rms: Floats  # (T,) [m] root of the mean square of the distances
    volumes: Floats  # (T, 2) [m^3] of A and of B
    center: Floats  # (T,) [m] distance of the centers of mass
    worst: tuple[str, int]  # mesh of A and point where the distance is largest over all times
    tolerance: float | None = None  # [m]
    notes: tuple[str, ...] = ()  # assumptions and omissions, as text

    @property
    def worst_frame(self) -> int:
        """Index of the time with the largest distance."""
        return int(np.argmax(self.largest))

    @property
    def error(self) -> float:
        """Largest distance [m] over all points and times."""
        return float(self.largest.max())

    @property
    def first_over(self) -> float | None:
        """Time code of A at which a distance first exceeds the tolerance; None: none does."""
        over = np.flatnonzero(self.largest > (np.inf if self.tolerance is None else self.tolerance))
        return float(self.time_codes[over[0]]) if len(over) else None

    @property
    def same(self) -> bool:
        """Whether all distances are within the tolerance; without one, whether all are 0."""
        return self.error <= (self.tolerance or 0.0)


@dataclass(frozen=True, kw_only=True)
class Pairing:
    """Pairs of meshes of A and B, and the rotation from B's world frame to A's."""

    first: tuple[int, ...]  # meshes of A
    second: tuple[int, ...]  # those of B, in the same order
    rotation: Floats  # (3, 3): x of A = rotation times x of B
    notes: tuple[str, ...]

    def distances(self, a: MotionFrame, b: MotionFrame) -> list[Floats]:
        """Distances (V,) [m] of the points of each pair of meshes, at one time."""
        return [
            np.linalg.norm(a.meshes[i] - b.meshes[j] @ self.rotation.T, axis=1)
            for i, j in zip(self.first, self.second)
        ]


def compare_motions(a: Source, b: Source, *, align: Align = "time") -> Comparison:
    """Compare motion B with motion A at the times of A that lie in both.

    Between its samples B is interpolated linearly, as USD does.

    Parameters
    ----------
    align : "time": compare at equal times of both stages [s]; "start": at equal times since the
        first frame of each.

    Raises
    ------
    InputError : the motions have no mesh in common, a mesh has different numbers of points, or
        the motions have no time in common.
    """
    recording_a, recording_b = a.recording(), b.recording()
    pairing = pair_meshes(recording_a, recording_b)
    codes, codes_b, notes = _common_times(recording_a, recording_b, align)
    first = [recording_a.meshes[i] for i in pairing.first]
    second = [recording_b.meshes[j] for j in pairing.second]
    largest, rms, volumes, center = [], [], [], []
    worst, max_distance = (first[0].name, 0), -1.0
    for frame, frame_b in zip(a.frames(codes), b.frames(codes_b)):
        distances = pairing.distances(frame, frame_b)
        for mesh, distance in zip(first, distances):
            if len(distance) and distance.max() > max_distance:
                max_distance, worst = float(distance.max()), (mesh.name, int(distance.argmax()))
        all_distances = np.concatenate(distances)
        largest.append(all_distances.max())
        rms.append(np.sqrt(np.mean(all_distances**2)))
        solid_a = _volume_and_center([frame.meshes[i] for i in pairing.first], first)
        solid_b = _volume_and_center(
            [frame_b.meshes[j] @ pairing.rotation.T for j in pairing.second], second
        )
        volumes.append((solid_a[0], solid_b[0]))
        center.append(np.linalg.norm(solid_a[1] - solid_b[1]))
    return Comparison(
        meshes=tuple((m.name, n.name) for m, n in zip(first, second)),
        points=sum(len(m.points) for m in first),
        radius=_equivalent_radius(first),
        time_codes=np.array(codes),
        other_time_codes=np.array(codes_b),
        seconds=np.array([recording_a.seconds(code) for code in codes]),
        largest=np.array(largest),
        rms=np.array(rms),
        volumes=np.array(volumes),
        center=np.array(center),
        worst=worst,
        notes=(*pairing.notes, *notes),
    )


def with_tolerance(found: Comparison, tolerance: str | float | None) -> Comparison:
    """The comparison with a tolerance: [m], a text as for `parse_tolerance`, or None.

    Raises UsageError for a text that is neither a length nor a percentage.
    """
    if isinstance(tolerance, str):
        tolerance = parse_tolerance(tolerance, found.radius)
    return replace(found, tolerance=tolerance)


LENGTHS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}


def parse_tolerance(text: str, radius: float) -> float:
    """The length [m] of "2mm", "0.5cm", "0.01m", or "0.5%" of the radius [m].

    Raises UsageError for any other text.
    """
    hint = "give a length or a share of the radius: --tolerance 2mm, --tolerance 0.5%"
    number = text.strip().lower()
    unit = next((unit for unit in ("%", *LENGTHS) if number.endswith(unit)), "")
    if not unit:
        raise UsageError(f"--tolerance {text!r} has no unit", hint)
    try:
        value = float(number.removesuffix(unit))
    except ValueError:
        raise UsageError(f"--tolerance {text!r} is not a length", hint) from None
    if not (np.isfinite(value) and value >= 0.0):
        raise UsageError(f"--tolerance {text!r} is not a length of 0 or more", hint)
    return value * (0.01 * radius if unit == "%" else LENGTHS[unit])


def pair_meshes(a: Recording, b: Recording) -> Pairing:
    """Pair the baked meshes of A with those of B: by path, else by name, else by point count.

    Raises InputError where no pair is found, or a pair has different numbers of points.
    """
    baked_a = [i for i, moves in enumerate(a.baked) if moves]
    unpaired_b = list(range(len(b.meshes)))
    pairs: dict[int, int] = {}
    for matches in (_same_path, _same_name):
        for i in baked_a:
            found = [j for j in unpaired_b if matches(a.meshes[i], b.meshes[j])]
            if i not in pairs and len(found) == 1:
                pairs[i] = found[0]
                unpaired_b.remove(found[0])
    unpaired = [i for i in baked_a if i not in pairs]
    if not pairs and len(unpaired) == 1:
        found = [
            j for j in unpaired_b if len(b.meshes[j].points) == len(a.meshes[unpaired[0]].points)
        ]
        if len(found) == 1:
            pairs[unpaired[0]] = found[0]
            unpaired_b.remove(found[0])
    if not pairs and (a.flows or b.flows):
        flows = f"{a.path}: <{a.flows[0]}>" if a.flows else f"{b.path}: <{b.flows[0]}>"
        raise InputError(
            f"{flows} has different points in every frame and cannot be compared point by point",
            "compare the particles: gf_usd.read returns their positions in every frame",
        )
    if not pairs:
        raise InputError(
            f"{a.path} and {b.path} have no mesh in common: the first has "
            f"{_list_names(a, baked_a)}, the second {_list_names(b, unpaired_b)}",
            "compare two bakes of one asset, or give the meshes of both the same names",
        )
    for i, j in pairs.items():
        if len(a.meshes[i].points) != len(b.meshes[j].points):
            raise InputError(
                f"{a.path}: <{a.meshes[i].name}> has {len(a.meshes[i].points)} points, but "
                f"<{b.meshes[j].name}> of {b.path} has {len(b.meshes[j].points)}",
                "the meshes must have the same points: compare them before subdivision or "
                "decimation",
            )
    return Pairing(
        first=tuple(pairs),
        second=tuple(pairs.values()),
        rotation=_up_axis_rotation(a, b),
        notes=tuple(_pairing_notes(a, b, pairs, baked_a, unpaired_b)),
    )


def _same_path(a: RenderMesh, b: RenderMesh) -> bool:
    return a.name == b.name


def _same_name(a: RenderMesh, b: RenderMesh) -> bool:
    return a.name.rsplit("/", 1)[-1] == b.name.rsplit("/", 1)[-1]


def _list_names(recording: Recording, which: Sequence[int]) -> str:
    return listed_paths([recording.meshes[i].name for i in which]) or "none"


def _pairing_notes(
    a: Recording,
    b: Recording,
    pairs: dict[int, int],
    baked_a: Sequence[int],
    unpaired_b: Sequence[int],
) -> Iterator[str]:
    renamed = [(i, j) for i, j in pairs.items() if not _same_path(a.meshes[i], b.meshes[j])]
    if renamed:
        i, j = renamed[0]
        more = f" and {len(renamed) - 1} more" if len(renamed) > 1 else ""
        yield f"<{a.meshes[i].name}> is compared with <{b.meshes[j].name}>{more}"
    if missing := [i for i in baked_a if i not in pairs]:
        yield f"not in {b.path.name}: {_list_names(a, missing)}"
    # A delivered file poses the obstacles of its bake, too, and does not tell them from bodies.
    there = set() if b.about else {mesh.name for mesh in a.meshes}
    if extra := [j for j in unpaired_b if b.baked[j] and b.meshes[j].name not in there]:
        yield f"not in {a.path.name}: {_list_names(b, extra)}"
    if a.up != b.up:
        yield f"{b.path.name} has another up axis and is rotated to that of {a.path.name}"


def _up_axis_rotation(a: Recording, b: Recording) -> Floats:
    """The rotation from B's up axis to A's, by the convention of importers."""
    if a.up == b.up:
        return np.eye(3)
    return Y_UP_TO_Z_UP if a.up[2] > 0.5 else Y_UP_TO_Z_UP.T


def _common_times(
    a: Recording, b: Recording, align: Align
) -> tuple[list[float], list[float], tuple[str, ...]]:
    """Time codes of A within B's range, those of B at the same times, and notes."""
    origin = (a.time_codes[0], b.time_codes[0]) if align == "start" else (0.0, 0.0)
    rate = b.time_codes_per_second / a.time_codes_per_second
    pairs = [(code, origin[1] + (code - origin[0]) * rate) for code in a.time_codes]
    low, high = b.time_codes[0] - SAME_TIME, b.time_codes[-1] + SAME_TIME
    kept = [
        (code, min(max(at, b.time_codes[0]), b.time_codes[-1]))
        for code, at in pairs
        if low <= at <= high
    ]
    if not kept:
        raise InputError(
            f"{a.path} moves in time codes {code_text(a.time_codes[0])} to"
            f" {code_text(a.time_codes[-1])} and {b.path} in {code_text(b.time_codes[0])} to"
            f" {code_text(b.time_codes[-1])}: these ranges do not overlap",
            "compare from the first frame of each: --align start",
        )
    codes, codes_b = [code for code, _ in kept], [at for _, at in kept]
    notes = []
    if len(kept) < len(pairs):
        notes.append(
            f"{len(kept)} of {len(pairs)} frames are compared, at time codes"
            f" {code_text(codes[0])} to {code_text(codes[-1])}: B ({b.path.name}) has only these"
        )
    samples = np.asarray(b.time_codes)
    interpolated = sum(float(np.abs(samples - at).min()) > SAME_TIME for at in codes_b)
    if interpolated:
        notes.append(f"{b.path.name} is interpolated at {interpolated} of {len(kept)} frames")
    return codes, codes_b, tuple(notes)


def _volume_and_center(
    points: Sequence[Floats], meshes: Sequence[RenderMesh]
) -> tuple[float, Floats]:
    """Volume [m^3] and center of mass (3,) [m] of all meshes, with vertices at `points`."""
    volume, moment = 0.0, np.zeros(3)
    low, high = (f(np.concatenate(points), axis=0) for f in (np.min, np.max))
    middle = 0.5 * (low + high)  # local origin, to limit cancellation
    for x, mesh in zip(points, meshes):
        six_volumes, corner_sums = _tetrahedron_volumes(x - middle, mesh.triangles)
        volume += float(six_volumes.sum()) / 6.0
        moment += (six_volumes[:, None] * corner_sums).sum(0) / 24.0
    if abs(volume) <= MIN_VOLUME_SHARE * float(np.prod(high - low)):
        return abs(volume), np.mean(np.concatenate(points), axis=0)
    return abs(volume), middle + moment / volume


def _tetrahedron_volumes(x: Floats, triangles: Ints) -> tuple[Floats, Floats]:
    """Six times the volume (T,) of each tetrahedron (0, a, b, c), and a + b + c (T, 3)."""
    a, b, c = (x[np.asarray(triangles)[:, k]] for k in range(3))
    return np.einsum("ij,ij->i", a, np.cross(b, c)), a + b + c


def _equivalent_radius(meshes: Sequence[RenderMesh]) -> float:
    """Radius [m] of a sphere of equal volume; half the box diagonal of an open surface."""
    points = [np.asarray(mesh.points) for mesh in meshes]
    volume, _ = _volume_and_center(points, meshes)
    all_distances = np.concatenate(points)
    size = all_distances.max(0) - all_distances.min(0)
    if volume <= MIN_VOLUME_SHARE * float(np.prod(size)):
        return 0.5 * float(np.linalg.norm(size))
    return float(np.cbrt(3.0 * volume / (4.0 * np.pi)))
