"""The output options of a bake, checked against the size of its files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Asset, Surface
from gf_usd.core.errors import UsageError
from gf_usd.core.frames.choices import SHAPES, Choices, clip_length
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings, written
from gf_usd.core.units import Precision, bytes_text, length_text
from gf_usd.prepare.bodies.flow import Flow
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.outputs.outputs import Outputs
from gf_usd.prepare.plan import frame_bytes


def chosen(
    request: Request,
    files: Outputs,
    settings: Settings,
    asset: Asset,
    particles: int,
    open_end: bool,
    flow: Flow,
) -> tuple[Choices, tuple[str, ...]]:
    """The output choices, with notes on those that were not requested.

    flow : the bodies that flow.
    Raises UsageError where --surface finds none, and --certify some.
    """
    if request.surface and not flow.bodies:
        raise UsageError(
            "--surface needs a material that flows without limit, and this bake has none",
            "leave it out: the mesh moves with the body",
        )
    if files.flat and request.clip_frames:
        raise UsageError(
            f"--clip-frames {request.clip_frames} and a package were both given",
            "a package is one file: leave one of them out",
        )
    if request.certify and flow.bodies:
        raise UsageError(
            "--certify does not support materials that flow without limit: it measures meshes",
            "leave it out",
        )
    choices = Choices(
        shapes=request.parsed["only"] or SHAPES,
        half=request.half,
        precision=request.parsed["precision"],
        adaptive=request.adaptive_samples,
        velocities=not request.no_velocities,
        flat=request.flatten or files.flat,
        settled=request.settle_only,
        tets=request.tets,
        until_rest=request.until_rest or open_end,
        open_end=open_end,
        certify=request.certify,
        flows=flow.bodies if request.surface else (),
        flowing=flow.meshes if request.surface else (),
        converting=flow.converting,
    )
    size = frame_bytes(asset, particles, settings, choices)
    length = (
        0
        if choices.flat or choices.settled
        else clip_length(request.clip_frames, size, written(settings))
    )
    unasked = length and request.clip_frames is None
    notes = (split_note(size, written(settings), length),) if unasked else ()
    return replace(choices, clip_frames=length), notes


def split_note(frame_bytes: float, frames: int, length: int) -> str:
    """Note that a cache is split automatically into value clips of `length` frames."""
    return (
        f"the cache, about {bytes_text(frame_bytes * frames)}, is split into value clips"
        f" of {length} frames: --clip-frames 0 keeps it in one file"
    )


def split_again(
    choices: Choices, notes: tuple[str, ...], frame_bytes: float, planned: int, frames: int
) -> tuple[Choices, tuple[str, ...]]:
    """The choices and notes of a bake with fewer frames than planned.

    A cache that would be split automatically is split only if it is still large.
    """
    note = split_note(frame_bytes, planned, choices.clip_frames)
    if note not in notes:
        return choices, notes
    length = clip_length(None, frame_bytes, frames)
    now = (split_note(frame_bytes, frames, length),) if length else ()
    at = notes.index(note)
    return replace(choices, clip_frames=length), (*notes[:at], *now, *notes[at + 1 :])


LOST = 0.5  # of the spacing of particles: the order of neighbors is lost
COARSE = 0.01  # of the spacing: motion at the end of a bake becomes steps
MOVED = 2.0  # times as far from the origin of its space as authored: the bake makes it coarser
SINGLE = 2.0  # of the distance between neighboring numbers: rounding in three axes, and of a line


def rounding_at(farthest: float) -> float:
    """[m] rounding error of points at this distance [m] from the origin, in single precision."""
    return SINGLE * float(np.finfo(np.float32).eps) * farthest


def require_stored(precision: Precision | None, particles: Particles, settings: Settings) -> None:
    """Raise UsageError for a precision below the rounding of single precision at the bodies."""
    if precision is None:
        return
    farthest = float(np.abs(particles.X + np.asarray(settings.lift)).max())
    rounding = rounding_at(farthest)
    radii = particles.radii
    least = precision.meters(float(radii[radii > 0.0].min()))
    if least < rounding:
        raise UsageError(
            f"--precision {precision.text} is {length_text(least)} for the smallest body, and"
            f" points have single precision, with a rounding error of {length_text(rounding)} at"
            f" {length_text(farthest)} from the origin",
            f"give {rounding:.2g}m or more",
        )


def require_resolved(request: Request, settings: Settings, gap: float, spacing: float) -> None:
    """Raise UsageError where --floor or --drop moves bodies too far from the origin for single
    precision.

    gap : [m] of the bodies above the floor; spacing : [m] of the particles.
    An asset that is itself far from the origin is written in a local space.
    """
    floor = settings.floor or 0.0
    lifted = math.hypot(*settings.lift)
    height = max(min(abs(floor), abs(gap)), min(lifted, abs(floor + gap)))
    rounding = rounding_at(height)
    if rounding <= LOST * spacing:
        return
    placed = {"--floor": request.floor, "--drop": request.drop}
    placement = " ".join(f"{name} {text}" for name, text in placed.items() if text is not None)
    raise UsageError(
        f"{placement or 'the stage'}: bodies would be {length_text(height)} from the origin, where"
        f" points, in single precision, have a rounding error of {length_text(rounding)};"
        f" particles are {length_text(spacing)} apart",
        f"give heights of up to {length_text(LOST * spacing / rounding * height)}, or check the"
        " unit of the asset (--meters-per-unit)",
    )


def own_space_notes(surfaces: Sequence[Surface], lift: Floats, spacing: float) -> tuple[str, ...]:
    """Notes on prims that a move leaves far from the origins of their own spaces, in which their
    points are written in single precision.

    lift : (3,) [m] by which bodies are moved at the start; spacing : [m] of the particles.
    Raises UsageError where that loses the shape of a prim.
    """
    notes = []
    for one in surfaces:
        own = one.points - np.asarray(one.origin)
        authored, moved = float(np.abs(own).max()), float(np.abs(own + lift).max())
        rounding = rounding_at(moved)
        if moved <= MOVED * authored or rounding <= COARSE * spacing:
            continue
        text = (
            f"<{one.path}> is moved by {length_text(float(np.linalg.norm(lift)))} to its height"
            f" above the floor, and its points {'would be' if rounding > LOST * spacing else 'are'}"
            f" {length_text(moved)} from the origin of its own space, where they, in single"
            f" precision, have a rounding error of {length_text(rounding)}; particles are"
            f" {length_text(spacing)} apart"
        )
        fix = "place it near the floor in its stage, or put --floor near it"
        if rounding > LOST * spacing:
            raise UsageError(text, fix)
        notes.append(f"{text}: {fix}")
    return tuple(notes)
