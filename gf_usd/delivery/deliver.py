"""Makes the file: the fewest joints or blend shapes within an error, whichever file is smaller."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gf_usd.core import PACKAGE_SUFFIX
from gf_usd.core.errors import BakeError, UsageError, counted, listed
from gf_usd.core.scene import Recording
from gf_usd.core.units import length_text, percent_text
from gf_usd.delivery.gltf.read import read_error, read_splat_errors
from gf_usd.delivery.gltf.write import write_glb
from gf_usd.delivery.motion import BodyMotion
from gf_usd.delivery.rig import Rig, with_joints, with_shapes, with_single_joints
from gf_usd.delivery.splats.clouds import (
    ALL,
    CAPTURED,
    CHOICES,
    ONLY,
    SplatErrors,
)
from gf_usd.delivery.splats.usd import read_errors
from gf_usd.delivery.usd import error_of, require_no_layer_of_bake, write_usd
from gf_usd.delivery.variants import BakedVariant, read_variants
from gf_usd.readers.inputs import require_packable
from gf_usd.readers.pictures.splats import SplatMotion
from gf_usd.system.atomic_files import partial_path, publish

USD, GLB = (PACKAGE_SUFFIX, ".usda", ".usdc"), (".glb",)

KINDS = ("auto", "shapes", "joints")  # shapes are found faster

BINDINGS = ("skin", "nodes")  # what Gaussians follow

OFFSET_BYTES = 12  # of a point in a shape

JOINT_BYTES = 20  # a key of a joint in the smallest form: a rotation of 16 bits, a translation

MOST_JOINTS = 400  # of a body

MOST_SHAPES = 64  # of a body

MARGIN = 0.999  # of the error that is left to rounding in the file

AGAIN = 0.9  # of that error, where rounding took more

MOST_REASONS = 4  # in an error message


@dataclass(frozen=True, kw_only=True)
class DeliveredBody:
    """The joints or blend shapes of a body of one variant."""

    variant: str  # "" where the bake has none
    meshes: tuple[str, ...]  # prim paths
    splats: tuple[str, ...]  # prim paths of Gaussians that follow the same joints or shapes
    joints: int  # without the root joint
    shapes: int  # blend shapes
    radius: float  # [m] to which the error is relative
    moves: bool = True  # False: an obstacle that stands still, in glTF


@dataclass(frozen=True, kw_only=True)
class DeliveredSplats:
    """A set of Gaussians, with its error as read back from the file."""

    variant: str  # "" where the bake has none
    path: str  # of the prim
    count: int  # of the Gaussians
    position: float  # the largest distance over Gaussians and frames [radii]
    # |S' - S| / |S| of covariances over Gaussians and frames: median, 99 in 100, largest
    covariance: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Delivered:
    """A delivered file."""

    path: Path  # the file
    bytes: int  # its size
    error: float  # the largest distance to the bake over points, Gaussians and frames [radii]
    frames: int  # number of frames of the motion
    bodies: tuple[DeliveredBody, ...]  # of each variant
    splats: tuple[DeliveredSplats, ...] = ()  # that were delivered
    notes: tuple[str, ...] = ()  # assumptions and omissions, as text


def deliver(
    bake: Path,
    target: Path,
    *,
    error: float = 0.005,
    variant: str | None = None,
    kind: str = "auto",
    most_joints: int = MOST_JOINTS,
    most_shapes: int = MOST_SHAPES,
    splats: str = CAPTURED,
    bind_splats: str = "skin",
) -> Delivered:
    """Write a bake as joints or blend shapes; see `gf_usd.deliver`.

    error : share of the radius of each body.  variant : None: all of a USD file, the selected one
    of a glTF file.  kind : "joints", "shapes", or "auto" for the smaller file.  splats : one of
    CHOICES.  bind_splats : one of BINDINGS.

    Raises
    ------
    UsageError : a wrong option, or the target is an input.
    InputError : the file cannot be read, or nothing in it moves.
    BakeError : the limits do not allow the error, or a file cannot be written.
    """
    _require(bake, target, error, kind, most_joints, most_shapes, splats)
    nodes = bind_splats == "nodes"
    if nodes:
        kind = _kind_of_nodes(target, kind)
    elif bind_splats not in BINDINGS:
        raise UsageError(
            f"--bind-splats is {bind_splats!r}", f"choose one of {', '.join(BINDINGS)}"
        )
    suffix = target.suffix.lower()
    if suffix == PACKAGE_SUFFIX:
        require_packable(bake, bake)
    variants, recordings, notes = read_variants(bake, variant, splats, whole=suffix in GLB)
    files = _Usd(bake, target, error) if suffix in USD else _Glb(target, recordings[0])
    with _no_partial_files(target):
        limits = (most_joints, most_shapes)
        return _smallest(bake, target, variants, files, error, kind, limits, notes, nodes=nodes)


def _kind_of_nodes(target: Path, kind: str) -> str:
    """The kind "joints", which Gaussians on glTF nodes need.

    Raises UsageError for another kind, or a file that is not glTF.
    """
    if target.suffix.lower() in USD or kind == "shapes":
        raise UsageError(
            f"--bind-splats nodes is only for joints in .glb, not for {target} --as {kind}",
            "leave it out, or deliver a .glb --as joints",
        )
    return "joints"


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
    variants: Sequence[BakedVariant],
    files: _Usd | _Glb,
    error: float,
    kind: str,
    limits: tuple[int, int],
    notes: Sequence[str],
    *,
    nodes: bool,
) -> Delivered:
    """Write with each kind, and publish the smallest file.

    limits : most joints and shapes of a body.  nodes : Gaussians follow single joints.
    """
    most_joints, most_shapes = limits
    kinds = KINDS[1:] if kind == "auto" else (kind,)
    made: list[tuple[int, Path, Sequence[BakedVariant], float, tuple[str, ...]]] = []
    failures: dict[str, str] = {}
    for one in kinds:
        if made:
            most_joints = min(most_joints, _joints_as_large(made[0][2]))
        fit = _fitter(
            one, max(1, most_joints), most_shapes, failures, nodes=nodes, alone=len(kinds) == 1
        )
        found = _within(variants, fit, error, files)
        if found is None:
            continue
        rigs, off, rig_notes = found
        kept = _kept(target, one)
        partial_path(target).replace(partial_path(kept))
        made.append((partial_path(kept).stat().st_size, partial_path(kept), rigs, off, rig_notes))
        if not any(rig.joints or rig.blend_shapes for variant in rigs for rig in variant.rigs):
            break  # rigid motion: nothing is smaller
    if not made:
        raise BakeError(
            f"{bake} cannot be delivered within {100 * error:g} % of the radius: "
            f"{listed(list(failures), MOST_REASONS, '; ')}",
            ", or ".join(
                ["allow a larger --error", *filter(None, dict.fromkeys(failures.values()))]
            ),
        )
    made.sort(key=lambda row: row[0])
    size, smallest, chosen, off, rig_notes = made[0]
    smallest.replace(partial_path(target))
    moved = files.splats(chosen)
    publish(target)
    return Delivered(
        path=target,
        bytes=size,
        error=max([off, *(one.position for found in moved for one in found)]),
        frames=max(len(variant.time_codes) for variant in chosen),
        bodies=tuple(
            DeliveredBody(
                variant=variant.name,
                meshes=tuple(variant.meshes[i] for i in rig.body.meshes),
                splats=tuple(variant.clouds[number].name for number, _ in rig.body.splats),
                joints=rig.joints,
                shapes=rig.blend_shapes,
                radius=rig.body.radius,
                moves=rig.body.moves,
            )
            for variant in chosen
            for rig in variant.rigs
        ),
        splats=tuple(
            DeliveredSplats(
                variant=variant.name,
                path=cloud.name,
                count=len(cloud),
                position=errors.position,
                covariance=errors.covariance,
            )
            for variant, found in zip(chosen, moved)
            for cloud, errors in zip(variant.clouds, found)
        ),
        notes=(*notes, *rig_notes),
    )


def _require(
    bake: Path,
    target: Path,
    error: float,
    kind: str,
    most_joints: int,
    most_shapes: int,
    splats: str,
) -> None:
    if target.suffix.lower() not in (*USD, *GLB):
        raise UsageError(
            f"{target} does not end in {', '.join((*USD, *GLB))}",
            "the suffix chooses the format: -o duck.usdz",
        )
    if not 0.0 < error < 1.0:
        raise UsageError(
            f"--error is {100 * error:g} % of the radius", "give more than 0% and less than 100%"
        )
    if kind not in KINDS:
        raise UsageError(f"--as is {kind!r}", f"choose one of {', '.join(KINDS)}")
    if most_joints < 1 or most_shapes < 1:
        raise UsageError(
            f"--max-joints is {most_joints}, --max-shapes {most_shapes}", "give 1 or more"
        )
    if splats not in CHOICES:
        raise UsageError(f"--splats is {splats!r}", f"choose one of {', '.join(CHOICES)}")
    if splats in (ALL, ONLY) and target.suffix.lower() in USD:
        raise UsageError(
            f"--splats {splats} is only for .glb: {target} would contain the same particles as "
            f"the bake",
            "leave it out, or bake with --half for smaller particles in USD",
        )
    if not target.parent.is_dir():
        raise UsageError(f"{target.parent} is not a folder", "choose a folder that exists, with -o")
    if target.is_dir():
        raise UsageError(f"{target} is a folder", "name the file: -o duck.usdz")
    require_no_layer_of_bake(bake, target)


class _Usd:
    def __init__(self, bake: Path, target: Path, allowed: float) -> None:
        self._bake, self.target, self._allowed = bake, target, allowed

    def write(self, variants: Sequence[BakedVariant]) -> tuple[str, ...]:
        return write_usd(self._bake, self.target, variants, self._allowed)

    def error(self, variants: Sequence[BakedVariant]) -> float:
        points = max(error_of(partial_path(self.target), variant) for variant in variants)
        return max([points, *(one.position for found in self.splats(variants) for one in found)])

    def splats(self, variants: Sequence[BakedVariant]) -> list[tuple[SplatErrors, ...]]:
        return [
            read_errors(
                SplatMotion(partial_path(self.target), variant.name or None),
                variant.clouds, variant.radii, variant.time_codes,
            )
            if variant.clouds
            else ()
            for variant in variants
        ]  # fmt: skip


class _Glb:
    def __init__(self, target: Path, recording: Recording) -> None:
        self.target, self._recording = target, recording

    def write(self, variants: Sequence[BakedVariant]) -> tuple[str, ...]:
        return write_glb(self.target, self._recording, variants[0].rigs, variants[0].clouds)

    def error(self, variants: Sequence[BakedVariant]) -> float:
        return read_error(partial_path(self.target), self._recording, variants[0].rigs)

    def splats(self, variants: Sequence[BakedVariant]) -> list[tuple[SplatErrors, ...]]:
        (variant,) = variants
        path = partial_path(self.target)
        return [read_splat_errors(path, self._recording, variant.rigs, variant.clouds)]


def _fitter(
    kind: str,
    most_joints: int,
    most_shapes: int,
    failures: dict[str, str],
    *,
    nodes: bool,
    alone: bool,
) -> Callable[[BakedVariant, BodyMotion, float], Rig | None]:
    """Finds the smallest rig of a body within an error; None where there is none.

    failures : gets the reason, with what helps.  alone : no other kind is tried.
    """

    def fit(variant: BakedVariant, body: BodyMotion, error: float) -> Rig | None:
        if kind == "shapes":
            found = with_shapes(body, error, most_shapes)
            if found is None:
                many = counted(most_shapes, "blend shape is", "blend shapes are")
                failures[f"{_named(variant, body)}: {many} not enough"] = (
                    "more blend shapes with --max-shapes"
                )
            return found
        *_, last = with_joints(body, error, most_joints)
        if last.error <= error:
            return with_single_joints(last) if nodes else last
        reason = (
            f"{_named(variant, body)}: {counted(last.joints, 'joint leaves', 'joints leave')} an"
            f" error of {percent_text(last.error)} of the radius,"
            f" {length_text(last.error * body.radius)}"
        )
        remedy = "more joints with --max-joints"
        if last.joints < most_joints:
            reason += f"; it has {counted(last.joints, 'distinct point')}, and more joints than"
            reason += " points do not help"
            without = ", without --bind-splats nodes" if nodes else ""
            remedy = f"blend shapes with --as shapes{without}" if alone else ""
        failures[reason] = remedy
        return None

    return fit


def _named(variant: BakedVariant, body: BodyMotion) -> str:
    """The prims of a body as text."""
    paths = [variant.meshes[k] for k in body.meshes]
    paths += [variant.clouds[number].name for number, _ in body.splats]
    more = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
    return f"{variant.name}: <{paths[0]}>{more}" if variant.name else f"<{paths[0]}>{more}"


def _joints_as_large(variants: Sequence[BakedVariant]) -> int:
    """How many joints take about the bytes of the shapes: with more, their file is larger."""
    most = 0
    for variant in variants:
        points = sum(len(rig.body.rest) * rig.blend_shapes for rig in variant.rigs)
        most = max(most, points * OFFSET_BYTES // (JOINT_BYTES * len(variant.time_codes)))
    return most


def _within(
    variants: Sequence[BakedVariant],
    fit: Callable[[BakedVariant, BodyMotion, float], Rig | None],
    error: float,
    files: _Usd | _Glb,
) -> tuple[list[BakedVariant], float, tuple[str, ...]] | None:
    """Fit, write under the partial name and read back; None where the limits do not allow it."""
    aim = MARGIN * error
    while aim > error / 2.0:
        rigged = []
        for variant in variants:
            rigs = [fit(variant, body, aim) for body in variant.bodies]
            if any(rig is None for rig in rigs):
                return None
            rigged.append(replace(variant, rigs=tuple(rig for rig in rigs if rig is not None)))
        notes = files.write(rigged)
        off = files.error(rigged)
        if off <= error:
            return rigged, off, notes
        aim *= AGAIN
    step, far = max(_rounding(body) for variant in variants for body in variant.bodies)
    raise BakeError(
        f"{files.target} differs by {percent_text(off)} of the radius when it is read back, but at"
        f" most {100 * error:g} % is allowed",
        "allow a larger --error"
        if step < error / 4.0
        else f"numbers in single precision have steps of {percent_text(step)} of the radius at the"
        f" {length_text(far)} that the body is from the origin: move the asset closer to it",
    )


def _rounding(body: BodyMotion) -> tuple[float, float]:
    """Step of single precision at the largest coordinate of a body, in radii, and it [m]."""
    far = float(np.abs(body.frames).max())
    return float(np.spacing(np.float32(far))) / body.radius, far
