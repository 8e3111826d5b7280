"""Stiffness of the contact found by one detection, for the stable step.

With W the interpolation rows of the samples, sample s in contact with a plane carried by samples
c_k with weights w_k, and springs k_s between them, the elongations and nodal forces are

    (B u)_s = (W u)_s - sum_k w_k (W u)_{c_k},        f = -B^T K B u

With their damping coefficients C, the share of the springs in the limit of stability with a step
dt is the largest eigenvalue of M~^-1 B^T (K dt^2 / 4 + C dt / 2) B (`time_step`). Tangential
springs of friction are equally stiff, so that the three axes are alike. For samples near the floor,
which does not move, B is W. A plane that rotates with its carriers also acts on them by moments,
whose contribution is included in K and C.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints, cross, gather, row_dots
from gf_usd.physics.contact.detection.narrow_phase import CLOSER, TRAVEL
from gf_usd.physics.contact.floor import FloorContact
from gf_usd.physics.contact.planes.contact_planes import ContactPlanes
from gf_usd.physics.contact.planes.support_triangles import turn
from gf_usd.physics.contact.self_contact.patch_tables import CHANGE
from gf_usd.physics.contact.self_contact.search import AHEAD, NEARLY
from gf_usd.physics.grid import spectrum
from gf_usd.physics.grid.mass import NodalMass
from gf_usd.physics.time_step import StableStep
from gf_usd.physics.total_lagrangian.setup.body import Body

ACCURACY = 0.05  # relative error bound of an eigenvalue, which is added
COLUMN = 4.0  # mass stopped by one sample in contact, in masses of a sample
CALM = 0.05  # [spacings] as `NEARLY`, for bodies at rest on others
# Of a body with rigid regions, springs that a sample may feel, over the one on the floor: its own,
# those of planes it carries, and each of the two strained by both bodies.
CROWD = 4.0
SPARE = 1.5  # factor on the springs of a crowded sample: few samples are deep


@dataclass(frozen=True, kw_only=True)
class PairSprings:
    """The springs between n samples and their planes, from a detection to the next."""

    planes: ContactPlanes
    k: Floats  # (n,) [N/m]
    values: Mapping[str, Floats]  # of `pair_values`
    hardening: float  # [1/m^2] 1 / a^2: a spring is k d (1 + d^2 / a^2)
    spacing: float  # [m]
    x: Floats  # (n, 3) [m] of the samples now
    v: Floats  # (n, 3) [m/s]
    span: float  # [s] until the next detection
    fall: float  # [m/s] bound of the speed gained from body forces until then
    calm: Ints  # (n,) whether a sample is of a body at rest on others, which gains no speed
    nearly: float = NEARLY  # [spacings] gap below which a sample may be in contact until then

    def step_ratio(
        self, body: Body, contact: FloorContact, near: Ints, stable: float, strained: float
    ) -> float:
        """Substeps of a solver's bodies with these springs over those where nothing touches.

        near : (k,) samples that may reach the floor until the next detection; stable : [s] of the
        substeps where nothing touches; strained : [s] limit of the bodies in their strain.  1 where
        the number of substeps is given.
        """
        if body.settings.substeps:
            return 1.0
        if body.settings.floor is None:
            near = near[:0]
        if body.regions:
            crowded = self.crowded_step(contact, body.step, CROWD * contact.pair_ratio)
            return body.step.substeps_with_contact(stable, crowded.contact_share, strained)
        share = self.share(contact, body.mass, near)
        return body.step.substeps_with_contact(stable, share, strained)

    def share(self, contact: FloorContact, mass: NodalMass, near: Ints) -> Callable[[float], float]:
        """The share that these springs, and those of the floor on the samples `near` (k,), have of
        the limit of stability with a step dt [s]: the largest eigenvalue of M~^-1 B^T (K dt^2 / 4 +
        C dt / 2) B, or an upper bound of it.
        """
        rows, harder = self.touching
        lever = levers(self.planes, rows, self.x, len(contact.mass))
        B = stretches(contact.rows.W, self.planes, rows, near)
        k = np.concatenate([self.k[rows] * harder * lever, contact.stiffness[near]])
        c = np.concatenate([self.values["damping"][rows] * lever, contact.damping[near]])
        return lambda dt: stiffest(B, mass, 0.25 * dt * dt * k + 0.5 * dt * c)

    def crowded_step(self, contact: FloorContact, rest: StableStep, crowd: float) -> StableStep:
        """The stable step of a body with rigid regions: with `crowd` times as many springs on each
        sample as the floor has.
        """
        deepest = float(self.touching[1].max(initial=1.0))
        floor = replace(
            rest, contact=float(np.sqrt(contact.omega2)), contact_damping=contact.damping_rate
        )
        return floor.crowded(crowd * max(1.0, deepest / SPARE))

    @cached_property
    def touching(self) -> tuple[Ints, Floats]:
        """Samples (m,) that may be in contact until the next detection; (m,) >= 1 factor by which
        their springs may harden: 1 + 3 (d / a)^2.
        """
        faces, coming = self.planes.facing, self._coming
        touches = coming > -np.where(self.calm, CALM, self.nearly)[faces] * self.spacing
        return faces[touches], 1.0 + 3.0 * self.hardening * np.maximum(coming[touches], 0.0) ** 2

    @cached_property
    def watched(self) -> Ints:
        """Samples (m,) that may be in contact until then where a body in motion is stopped, too:
        it moves on by `TRAVEL` before that is detected (`intervals.until_stopped`).
        """
        faces, coming = self.planes.facing, self._coming
        return faces[coming > -np.where(self.calm, CALM, TRAVEL)[faces] * self.spacing]

    @cached_property
    def _coming(self) -> Floats:
        """(f,) [m] bound of the depth of samples with a plane until then; negative: a gap."""
        faces, x, v = self.planes.facing, self.x, self.v
        f, normal = self.planes, gather(self.planes.normal, faces)
        away = f.interpolated_to(faces, x) + gather(f.point, faces) - gather(x, faces)
        speed = f.interpolated_to(faces, v) + gather(f.velocity, faces) - gather(v, faces)
        depth, closing = row_dots(away, normal), row_dots(speed, normal)
        fastest = np.maximum(AHEAD * closing, CHANGE * np.sqrt(row_dots(speed, speed)))
        coming = largest_depth(
            depth, fastest, np.where(self.calm, 0.0, self.fall)[faces], self.span, self.k[faces],
            self.values["layer"][faces], self.hardening,
        )  # fmt: skip
        # Detection precedes a closer approach; a larger estimate indicates a failing frame.
        return np.minimum(coming, np.maximum(depth, 0.0) + CLOSER * self.spacing)


def stretches(
    W: sparse.csr_matrix, planes: ContactPlanes, rows: Ints, floor: Ints
) -> sparse.csr_matrix:
    """B (m + l, nodes) of samples `rows` (m,) with a plane, and `floor` (l,) near the floor.

    W : (n, nodes) of all samples; points of obstacles, behind them, move no node.
    """
    carriers, weights = gather(planes.carriers, rows), gather(planes.weights, rows)
    carried = np.flatnonzero(planes.partner[rows] >= 0)
    count = len(rows) + len(floor)
    own = np.append(rows, floor)
    moved = np.flatnonzero(own < W.shape[0])
    row = np.concatenate([moved, np.repeat(carried, 3)])
    column = np.concatenate([own[moved], carriers[carried].ravel()])
    value = np.concatenate([np.ones(len(moved)), -weights[carried].ravel()])
    used, local = np.unique(column, return_inverse=True)
    P = sparse.csr_matrix((value, (row, local.reshape(-1))), shape=(count, len(used)))
    return sparse.csr_matrix(P @ W[used])


def stiffest(B: sparse.csr_matrix, mass: NodalMass, k: Floats) -> float:
    """The largest eigenvalue of M~^-1 B^T K B, or an upper bound of it, in the unit of k over kg; k
    : (m + l,), for example [N/m].
    """
    if not k.any():
        return 0.0
    Bt, start = B.T, np.random.default_rng(0).normal(size=B.shape[1])
    return spectrum.largest_eigenvalue(
        mass.acceleration, lambda a: Bt @ (k * (B @ a)), start, ACCURACY
    )


def levers(planes: ContactPlanes, rows: Ints, x: Floats, samples: int) -> Floats:
    """(m,) >= 1: ratio of |G|^2 of the planes of `rows` to its value without rotation.

    G n = (n, -w_k n + alpha x r_k) is the force on a sample and on its carriers for a unit normal
    force: see `planes.support_triangles`. x : (n + m, 3) [m], of which the first n are `samples`
    and the others points of obstacles, which do not move.
    """
    out = np.ones(len(rows))
    carried = np.flatnonzero(planes.partner[rows] >= 0)
    s = rows[carried]
    if len(s) == 0:
        return out
    corners = gather(x, gather(planes.carriers, s))
    w, n = gather(planes.weights, s), gather(planes.normal, s)
    r = corners - corners.mean(1, keepdims=True)
    arm = x[s] - np.einsum("nk,nka->na", w, corners)
    alpha = turn(r, cross(n, arm))
    back = cross(alpha[:, None], r) - w[:, :, None] * n[:, None]
    own = np.where(s < samples, 1.0, 0.0)
    plain = own + (w * w).sum(1)
    out[carried] = np.maximum(1.0, (own + (back * back).sum((1, 2))) / plain)
    return out


def largest_depth(
    depth: Floats, speed: Floats, gain: Floats, span: float, k: Floats, mass: Floats,
    hardening: float,
) -> Floats:  # fmt: skip
    """(m,) [m] bound of the depth of samples within a span [s].

    depth : (m,) [m] now, negative outside; speed : (m,) [m/s] into the plane; gain : (m,) [m/s]
    by which it grows at most within the span, at a constant rate; k, mass : (m,) of samples;
    hardening : [1/m^2] 1 / a^2. A sample continues for the span, or until the spring k d (1 + d^2 /
    a^2) has absorbed the kinetic energy of `COLUMN` times its mass.
    """
    way = span * np.maximum(speed + 0.5 * gain, 0.0)
    fast = np.maximum(speed + gain, 0.0)
    energy = 0.5 * COLUMN * mass * fast**2
    square = (np.sqrt(1.0 + 4.0 * energy * hardening / np.maximum(k, 1e-300)) - 1.0) / hardening
    return np.minimum(depth + way, np.maximum(depth, 0.0) + np.sqrt(square))
