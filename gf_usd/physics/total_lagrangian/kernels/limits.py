"""Stretch clamp and stress cap of eight particles within a substep."""

import taichi as ti

from gf_usd.physics.laws.simd3x3 import LANES, cofactor, determinant, double_dot
from gf_usd.physics.laws.stress import clipped_matrix
from gf_usd.physics.total_lagrangian.limits import (
    CAP,
    CLAMPED,
    CLIP_BUFFER,
    HIGH,
    LOW,
    STRESS_CAPPED,
)


@ti.func
def flag_particle(body: ti.template(), lane, how):
    """Set a bit in `touched` of a particle that was clipped or capped; see
    `limits.limited_particles`.
    """
    body.touched[lane] = body.touched[lane] | how


@ti.func
def clip(body: ti.template(), b, F: ti.template(), counted: ti.template()):
    """Clip the singular values of F of batch b, in place; where J < 0 the smallest is negative.

    Signs as in `nearest_rotation`: an inverted particle gets the least stretch that is allowed.
    """
    low = body.numbers[LOW]
    high = body.numbers[HIGH]
    square = double_dot(F, F)
    # s1 s2 <= |F|^2 / 2, so that s3 = J / (s1 s2) >= 2 J / |F|^2: most need no decomposition.
    J = determinant(F, cofactor(F))
    beyond = ti.select((square > high * high) | (low * square > 2.0 * J), J * 0.0 + 1.0, J * 0.0)
    if beyond.max() > 0.0:
        buffer = CLIP_BUFFER * b
        for a in ti.static(range(9)):
            body.clip_buffer[buffer + a] = F[a]
        body.clip_buffer[buffer + 9] = beyond
        # A loop over lanes through memory: eight inlined decompositions take minutes to compile.
        for lane in range(LANES):
            if body.clip_buffer[buffer + 9][lane] > 0.0:
                clip_lane(body, b, lane, low, high, counted)
        for a in ti.static(range(9)):
            F[a] = body.clip_buffer[buffer + a]


@ti.func
def clip_lane(body: ti.template(), b, lane, low, high, counted: ti.template()):
    """Clip the matrix that `clip_buffer` holds in one lane of batch b."""
    A = ti.Matrix.rows(
        [
            ti.Vector(
                [body.clip_buffer[CLIP_BUFFER * b + 3 * a + c][lane] for c in ti.static(range(3))]
            )
            for a in ti.static(range(3))
        ]
    )
    B, outside = clipped_matrix(A, low, high)
    if outside > 0:
        if ti.static(counted):
            flag_particle(body, b * LANES + lane, CLAMPED)
        for a in ti.static(range(3)):
            for c in ti.static(range(3)):
                body.clip_buffer[CLIP_BUFFER * b + 3 * a + c][lane] = B[a, c]


@ti.func
def cap_stress(body: ti.template(), b, P: ti.template(), counted: ti.template()):
    """Scale P of batch b down to |P| <= numbers[CAP], in place (stress cap)."""
    cap = body.numbers[CAP]
    size = ti.sqrt(double_dot(P, P))
    scale = ti.min(cap / ti.max(size, 1e-30), 1.0)
    for a in ti.static(range(9)):
        P[a] = P[a] * scale
    if ti.static(counted):
        for lane in ti.static(range(LANES)):
            if size[lane] > cap:
                flag_particle(body, b * LANES + lane, STRESS_CAPPED)
