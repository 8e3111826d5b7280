"""The paper's options of a body, and how often they acted.

    clamp   singular values of the F that the stress is taken of, clipped        (section 3.2)
    cap     |P| cut to a largest value, |P| = sqrt(P : P) (Frobenius)            (section 3.2)
    WLS     F anchored anew once a frame: see `shape_correction`       (section 3.2)

Off, none of them leaves a trace in the kernels.  The particles that the first two touch are counted
each frame, however often they are touched.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames import LUMPED, Settings
from gf_usd.physics.total_lagrangian import layout

LOW, HIGH, CAP, PER_H, CONVERGED = range(5)  # of the numbers in the pack
# [m/s] no contact sample falls faster; [m] it keeps to spare; from SLACK on, in turn, how far [m] a
# sample, and all samples of a node, may fall until they are asked again: see `contact.kernels`.
FALL, CLEARANCE, SLACK = range(5, 8)
CLIP_BUFFER = 10  # lane vectors of a batch: F, and which lanes may have to be clipped
NO_GOALS, SPRINGS, LIMITED = range(3)  # nothing, springs to goals, limits besides
CLAMPED, STRESS_CAPPED = 1, 2  # bits of what happened to a particle


@dataclass(frozen=True, kw_only=True)
class Options:
    """What is compiled into the kernels."""

    anchored: bool = False  # F = F0 + G u with an F0 of each particle, instead of I
    clamped: bool = False
    capped: bool = False
    meets: bool = False  # bodies meet each other, themselves or obstacles
    coupled: bool = True  # the mass of a node is coupled to its neighbors' (`grid.mass`)
    plain: bool = False  # one thread a particle (`kernels.scalar`): the reference
    cells: bool = False  # one thread a cell (`kernels.cell`): on GPUs
    slides: bool = False  # a pin holds some axes and lets the others slide
    goals: int = NO_GOALS  # whether springs draw the nodes to a given pose
    driven: bool = False  # pins move contact samples
    rigid: int = 0  # regions that move as rigid bodies


DEFAULT = Options()


def options_of(
    settings: Settings,
    meets: bool = False,
    plain: bool = False,
    cells: bool = False,
    slides: bool = False,
    goals: int = NO_GOALS,
    driven: bool = False,
    rigid: int = 0,
) -> Options:
    """The options that the settings ask for."""
    return Options(
        anchored=settings.wls,
        clamped=settings.clamp is not None,
        capped=settings.stress_cap is not None,
        meets=meets,
        coupled=settings.mass != LUMPED,
        plain=plain,
        cells=cells,
        slides=slides,
        goals=goals,
        driven=driven,
        rigid=rigid,
    )


def arrays(
    batches: layout.Batches, settings: Settings, h: float, converged: float, watched: int
) -> dict[str, Floats]:
    """The options' part of the pack, and numbers of the body; of what is off, one number.

    h : [m] of a cell; converged : change of a rotation that ends its iteration; watched : contact
    samples or nodes, whichever are more.
    """
    asked, lanes = options_of(settings), batches.source.size
    particles = int(batches.source.max()) + 1
    low, high = settings.clamp or (0.0, 0.0)
    return {
        "F0": layout.lanes(batches, np.tile(np.eye(3).ravel(), (particles, 1)), fill=True)
        if asked.anchored
        else np.zeros((1, layout.LANES)),
        "numbers": np.concatenate(
            [
                [low, high, settings.stress_cap or 0.0, 1.0 / h, converged],
                np.zeros(SLACK - FALL + 2 * watched),
            ]
        ),
        "clip_buffer": np.zeros(
            (CLIP_BUFFER * len(batches.source) if asked.clamped else 1, layout.LANES)
        ),
        "touched": np.zeros(lanes if asked.clamped or asked.capped else 1, int),
    }


def touched(
    bits: Ints, options: Options, batches: layout.Batches, m: Floats
) -> dict[str, NDArray[np.bool_]]:
    """(N,) bool for "clamped" and "stress_capped": particles touched since `bits` were cleared.

    bits : the pack's array; m : (N,) [kg], 0 for what a pin holds, which has no stress.
    """
    out = {}
    for name, bit, on in (
        ("clamped", CLAMPED, options.clamped),
        ("stress_capped", STRESS_CAPPED, options.capped),
    ):
        out[name] = np.zeros(len(m), bool)
        if on:
            lanes = (bits & bit > 0) & (batches.filled.ravel() > 0.0)
            out[name][batches.source.ravel()[lanes]] = True
            out[name] &= m > 0.0
    return out
