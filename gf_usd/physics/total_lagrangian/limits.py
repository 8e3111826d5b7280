"""The stretch clamp, the stress cap and WLS (GaussianFlesh section 3.2), and counts of their use.

    clamp   clips the singular values of the F from which the stress is computed
    cap     scales P down to a largest norm |P| = sqrt(P : P) (Frobenius)
    WLS     recomputes F once a frame by weighted least squares: see `shape_correction`

An option that is off is not compiled into the kernels. The particles that the clamp or the cap
changed are counted per frame, each at most once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.settings import LUMPED, Settings
from gf_usd.physics.total_lagrangian import layout

LOW, HIGH, CAP, PER_H, CONVERGED = range(5)  # indices in the array `numbers`
# Bound of the falling speed of contact samples [m/s]; safety margin of their distances [m]; from
# SLACK on, alternately, the distance [m] that a sample, and the samples of a node, may fall before
# the floor is tested again: see `contact.kernels`.
FALL, CLEARANCE, SLACK = range(5, 8)
CLIP_BUFFER = 10  # lane vectors per batch: F, and a flag of the lanes that may need clipping
NO_GOALS, SPRINGS, LIMITED = range(3)  # no goals, springs to goals, springs and distance limits
CLAMPED, STRESS_CAPPED = 1, 2  # bits in `touched` of a particle


@dataclass(frozen=True, kw_only=True)
class Options:
    """Options that are compiled into the kernels."""

    anchored: bool = False  # F = F0 + G u with an F0 per particle, instead of F0 = I
    clamped: bool = False
    capped: bool = False
    pair_contact: bool = False  # contact between bodies, self-contact, or contact with obstacles
    coupled: bool = True  # the mass matrix has off-diagonal entries (`grid.mass`)
    plain: bool = False  # one thread per particle (`kernels.scalar`): the reference implementation
    cells: bool = False  # one thread per cell (`kernels.cell`): for GPUs
    slides: bool = False  # a pin holds some axes only
    goals: int = NO_GOALS  # springs that pull the nodes to a given pose
    driven: bool = False  # pins move contact samples
    rigid: int = 0  # number of rigid regions


DEFAULT = Options()


def options_of(
    settings: Settings,
    pair_contact: bool = False,
    plain: bool = False,
    cells: bool = False,
    slides: bool = False,
    goals: int = NO_GOALS,
    driven: bool = False,
    rigid: int = 0,
) -> Options:
    """The kernel options for the settings of a bake."""
    return Options(
        anchored=settings.wls,
        clamped=settings.clamp is not None,
        capped=settings.stress_cap is not None,
        pair_contact=pair_contact,
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
    """The arrays of the options and the array `numbers`; arrays of unused options have one element.

    h : [m] edge of a cell; converged : change at which the iteration for a rotation ends.
    watched : the number of contact samples or of nodes, whichever is greater.
    """
    chosen, lanes = options_of(settings), batches.source.size
    particles = int(batches.source.max()) + 1
    low, high = settings.clamp or (0.0, 0.0)
    return {
        "F0": layout.lanes(batches, np.tile(np.eye(3).ravel(), (particles, 1)), fill=True)
        if chosen.anchored
        else np.zeros((1, layout.LANES)),
        "numbers": np.concatenate(
            [
                [low, high, settings.stress_cap or 0.0, 1.0 / h, converged],
                np.zeros(SLACK - FALL + 2 * watched),
            ]
        ),
        "clip_buffer": np.zeros(
            (CLIP_BUFFER * len(batches.source) if chosen.clamped else 1, layout.LANES)
        ),
        "touched": np.zeros(lanes if chosen.clamped or chosen.capped else 1, int),
    }


def limited_particles(
    bits: Ints, options: Options, batches: layout.Batches, m: Floats
) -> dict[str, NDArray[np.bool_]]:
    """(N,) bool for "clamped" and "stress_capped": particles changed since `bits` was cleared.

    bits : the array `touched`; m : (N,) [kg], 0 for pinned particles, which have no stress.
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
