"""Makes the file: the fewest joints or blend shapes within an error, whichever file is smaller."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from gf_usd.core.errors import BakeError, InputError, UsageError
from gf_usd.core.scene import Recording
from gf_usd.delivery.gltf import write_glb
from gf_usd.delivery.gltf_read import read_error
from gf_usd.delivery.motion import BodyMotion, bodies_of
from gf_usd.delivery.rig import Rig, with_joints, with_shapes
from gf_usd.delivery.usd import Look, error_of, require_no_input, write_usd
from gf_usd.readers.pictures.recording import BakedMotion
from gf_usd.system.atomic_files import partial_path, publish

USD, GLB = (".usdz", ".usda", ".usdc"), (".glb",)
KINDS = ("auto", "shapes", "joints")  # shapes are found faster
OFFSET_BYTES = 12  # of a point in a shape
JOINT_BYTES = 20  # a key of a joint in the smallest form: a rotation of 16 bits, a translation
MOST_JOINTS = 400  # of a body
MOST_SHAPES = 64  # of a body
MARGIN = 0.999  # of the error that is left to rounding in the file
AGAIN = 0.9  # of that error, where rounding took more


@dataclass(frozen=True, kw_only=True)
class DeliveredBody:
    """How a body of one variant is described."""

    variant: str  # "" where the bake has none
    meshes: tuple[str, ...]  # prim paths
    joints: int  # without the root joint
    shapes: int  # blend shapes
    radius: float  # [m] that the error is a share of


@dataclass(frozen=True, kw_only=True)
class Delivered:
    """A delivered file."""

    path: Path
    bytes: int
    error: float  # the largest distance to the bake over points and frames, in radii, as read back
    frames: int
    bodies: tuple[DeliveredBody, ...]
    notes: tuple[str, ...] = ()  # what was assumed or left out, in words


def deliver(
    bake: Path,
    target: Path,
    *,
    error: float = 0.005,
    variant: str | None = None,
    kind: str = "auto",
    most_joints: int = MOST_JOINTS,
    most_shapes: int = MOST_SHAPES,
) -> Delivered:
    """Write a bake as joints or blend shapes; see `gf_usd.deliver`.

    error : share of the radius of each body.  variant : None: all of a USD file, the selected one
    of a glTF file.  kind : "joints", "shapes", or "auto" for the smaller file.

    Raises
    ------
    UsageError : a wrong option, or the target is an input.
    InputError : the file cannot be read, or nothing in it moves.
    BakeError : the limits do not allow the error, or the disk refuses.
    """
    _require(bake, target, error, kind, most_joints, most_shapes)
    suffix = target.suffix.lower()
    looks, recordings, notes = _looks(bake, variant, whole=suffix in GLB)
    files = _Usd(bake, target) if suffix in USD else _Glb(target, recordings[0])
    with _no_partial_files(target):
        return _smallest(bake, target, looks, files, error, kind, most_joints, most_shapes, notes)


@contextmanager
def _no_partial_files(target: Path) -> Iterator[None]:
    """However it ends, nothing is left under a partial name."""
    try:
        yield
    finally:
        for path in (target, *(_kept(target, kind) for kind in KINDS)):
            partial_path(path).unlink(missing_ok=True)


def _kept(target: Path, kind: str) -> Path:
    return target.with_name(f"{target.stem}.{kind}{target.suffix}")


def _smallest(
    bake: Path,
    target: Path,
    looks: Sequence[Look],
    files: _Usd | _Glb,
    error: float,
    kind: str,
    most_joints: int,
    most_shapes: int,
    notes: Sequence[str],
) -> Delivered:
    """Write with each kind, and publish the smallest file."""
    kinds = KINDS[1:] if kind == "auto" else (kind,)
    made: list[tuple[int, Path, Sequence[Look], float, tuple[str, ...]]] = []
    reasons = []
    for one in kinds:
        if made:
            most_joints = min(most_joints, _room(made[0][2]))
        fit = _fitter(one, max(1, most_joints), most_shapes, reasons)
        found = _within(looks, fit, error, files)
        if found is None:
            continue
        rigs, off, said = found
        kept = _kept(target, one)
        partial_path(target).replace(partial_path(kept))
        made.append((partial_path(kept).stat().st_size, partial_path(kept), rigs, off, said))
        if not any(rig.joints or rig.blend_shapes for look in rigs for rig in look.rigs):
            break  # rigid motion: nothing is smaller
    if not made:
        raise BakeError(
            f"{bake} cannot be delivered within {100 * error:g} % of the radius: "
            f"{' and '.join(reasons)}.",
            "allow a larger --error, or more with --max-joints and --max-shapes",
        )
    made.sort(key=lambda row: row[0])
    size, smallest, chosen, off, said = made[0]
    smallest.replace(partial_path(target))
    publish(target)
    return Delivered(
        path=target,
        bytes=size,
        error=off,
        frames=max(len(look.time_codes) for look in chosen),
        bodies=tuple(
            DeliveredBody(
                variant=look.name,
                meshes=tuple(look.meshes[i] for i in rig.body.meshes),
                joints=rig.joints,
                shapes=rig.blend_shapes,
                radius=rig.body.radius,
            )
            for look in chosen
            for rig in look.rigs
        ),
        notes=(*notes, *said),
    )


def _require(
    bake: Path, target: Path, error: float, kind: str, most_joints: int, most_shapes: int
) -> None:
    if target.suffix.lower() not in (*USD, *GLB):
        raise UsageError(
            f"{target} does not end in {', '.join((*USD, *GLB))}.",
            "the ending says what is written: -o duck.usdz",
        )
    if not 0.0 < error < 1.0:
        raise UsageError(
            f"--error is {100 * error:g} % of the radius.", "give more than 0% and less than 100%"
        )
    if kind not in KINDS:
        raise UsageError(f"--as is {kind!r}.", f"choose from {', '.join(KINDS)}")
    if most_joints < 1 or most_shapes < 1:
        raise UsageError(
            f"--max-joints is {most_joints}, --max-shapes {most_shapes}.", "give 1 or more"
        )
    if not target.parent.is_dir():
        raise UsageError(f"{target.parent} is no folder.", "choose a folder that exists, with -o")
    if target.is_dir():
        raise UsageError(f"{target} is a folder.", "name the file: -o duck.usdz")
    require_no_input(bake, target)


def _looks(
    bake: Path, variant: str | None, *, whole: bool
) -> tuple[list[Look], list[Recording], tuple[str, ...]]:
    """The variants with their bodies, not yet fitted.

    whole : one variant with all that is visible; else all of them, with what the bake moves.
    """
    first = BakedMotion(bake, variant)
    sources = [first]
    if variant is None and not whole:
        sources += [BakedMotion(bake, name) for name in first.variants if name != first.variant]
    looks, recordings, notes = [], [], {}
    for source in sources:
        recording = source.recording()
        baked = [i for i, mine in enumerate(recording.baked) if mine or whole]
        if not baked:
            raise InputError(
                f"{bake}: no mesh of the bake is visible.", "bake again with mesh among --only"
            )
        bodies = bodies_of(recording, list(source.frames()), baked)
        looks.append(
            Look(
                name=source.variant if source.variants else "",
                bodies=bodies,
                rigs=(),
                meshes=tuple(mesh.name for mesh in recording.meshes),
                triangles=tuple(mesh.triangles for mesh in recording.meshes),
                time_codes=recording.time_codes,
                unit=recording.unit,
            )
        )
        recordings.append(recording)
        notes |= dict.fromkeys(recording.notes)
    return looks, recordings, tuple(notes)


class _Usd:
    def __init__(self, bake: Path, target: Path) -> None:
        self._bake, self._target = bake, target

    def write(self, looks: Sequence[Look]) -> tuple[str, ...]:
        return write_usd(self._bake, self._target, looks)

    def error(self, looks: Sequence[Look]) -> float:
        return max(error_of(partial_path(self._target), look) for look in looks)


class _Glb:
    def __init__(self, target: Path, recording: Recording) -> None:
        self._target, self._recording = target, recording

    def write(self, looks: Sequence[Look]) -> tuple[str, ...]:
        return write_glb(self._target, self._recording, looks[0].rigs)

    def error(self, looks: Sequence[Look]) -> float:
        return read_error(partial_path(self._target), self._recording, looks[0].rigs)


def _fitter(
    kind: str, most_joints: int, most_shapes: int, reasons: list[str]
) -> Callable[[BodyMotion, float], Rig | None]:
    """Finds the smallest rig of a body within an error; None, and why, where there is none."""

    def fit(body: BodyMotion, error: float) -> Rig | None:
        if kind == "shapes":
            found = with_shapes(body, error, most_shapes)
            if found is None:
                reasons.append(f"{most_shapes} blend shapes are too few")
            return found
        *_, last = with_joints(body, error, most_joints)
        if last.error <= error:
            return last
        reasons.append(f"{last.joints} joints leave {100 * last.error:.2g} %")
        return None

    return fit


def _room(looks: Sequence[Look]) -> int:
    """How many joints take about the bytes of the shapes: with more, their file is larger."""
    most = 0
    for look in looks:
        points = sum(len(rig.body.rest) * rig.blend_shapes for rig in look.rigs)
        most = max(most, points * OFFSET_BYTES // (JOINT_BYTES * len(look.time_codes)))
    return most


def _within(
    looks: Sequence[Look],
    fit: Callable[[BodyMotion, float], Rig | None],
    error: float,
    files: _Usd | _Glb,
) -> tuple[list[Look], float, tuple[str, ...]] | None:
    """Fit, write under the partial name and read back; None where the limits do not allow it."""
    aim = MARGIN * error
    while aim > error / 2.0:
        rigged = []
        for look in looks:
            rigs = [fit(body, aim) for body in look.bodies]
            if any(rig is None for rig in rigs):
                return None
            rigged.append(replace(look, rigs=tuple(rig for rig in rigs if rig is not None)))
        notes = files.write(rigged)
        off = files.error(rigged)
        if off <= error:
            return rigged, off, notes
        aim *= AGAIN
    raise BakeError(
        f"the file differs by {100 * off:.2g} % of the radius when it is read back.",
        "allow a larger --error",
    )
