"""Contact of surface samples with the floor: stiffness, damping, interpolation rows.

Stiffness per mass (docs/physics.md) for particles at a spacing s and an impact at speed v:

    k/m = max(1.3 E* / (rho s^2), (v / (0.25 s))^2, p0 / (0.045 rho s^2)),    E* = E / (1 - nu^2)

The first term is the compliance of a half space at the scale of a particle, which the grid does not
resolve, so that the duration of an impact agrees with Hertz's theory. The second stops an impact
within about a quarter of a spacing where the body is soft. The third limits the depth of a body at
rest to a tenth of s under the largest pressure of its own weight, which for a sphere is Hertz's p0
(Johnson 1985, eq. 4.24; half a spacing without this term, measured).

A sample of area A has the mass m = rho A s of a layer one spacing thick. In a blade, at a sharp
edge or on a face that encloses nothing it moves less (`layers_moved`): the mass in its damping is
at most LIGHT times that, and the mass in its stiffness at most STIFF times that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints, nonzero_rows
from gf_usd.core.frames.particles import SurfaceSamples
from gf_usd.physics.grid import spectrum
from gf_usd.physics.grid.mass import NodalMass, lumped_mass
from gf_usd.physics.grid.reference.stencil import Rows, Stencil
from gf_usd.physics.taichi_arrays import DeviceState, host_view
from gf_usd.physics.time_step import StableStep

# Of E* / (rho s^2). The grid of quadratic B-splines already has a part of the compliance of a half
# space. With stiffer springs an impact is too short, by 7 % at an approach of .05 R and 13 % at .01
# R with 8,000 particles, with softer ones too long. With 1.3 both agree with Hertz's theory to 2
# and 4 %, for nu of 0, .3 and .45 (measured), which is not so for a scaling by c^2 instead of E*.
HALF_SPACE = 1.3
STOPPING_DISTANCE = 0.25  # of s
# Factor on the second and third term between two bodies, or a body and an obstacle, whose relative
# speed may be twice that of one body: twice the stiffness for half the (reduced) mass. Jelly balls
# overlap by .41 spacings with it, by .54 without (measured, at 3 m/s each).
PAIR_STIFFNESS = 2.0
# [spacings] a: at this depth below the onset of hardening, the force is increased by k a. The
# springs between bodies harden from depth 0 on, by the same term.
HARD = 0.2
REST_DEPTH = 0.045  # of s; twice as deep for jelly, whose strain is too large for Hertz's theory
# Largest mass of a sample in its damping and its stiffness, in masses that it moves. A layer one
# spacing thick is 1 of these on the faces of a thick body, 2 at the edges of a cube, up to 3.4 at
# its corners and in the samples, 4 on a sheet half a spacing thick (measured). Damping of the layer
# would be overcritical at a knife edge, which takes more substeps than stiffness. Thin parts also
# bear what lies on them: with STIFF = 4 leaves under a ball overlap by .3 spacings, with 16 by .08.
LIGHT = 4.0
STIFF = 16.0


NO_FLOOR = -1e9  # [m] height of the floor where there is none

# The constants of a sample are one row of `sample_constants`, to limit the number of arrays.
FLOOR_ROW = 7
# [N/m], [N s/m], [N/m] along the floor, friction, [kg], d0 [m] and 1 / a^2 [1/m^2] of hardening
K, C, K_T, MU, M_S, LINEAR, HARDENING = range(FLOOR_ROW)
# Prescribed motion of a sample by pins: its height [m] above the floor without u and the offset,
# its velocity [m/s], and the work [J] of the pins on it.
GIVEN_ROW = 5
HEIGHT, DRIFT, WORK = 0, 1, 4


@dataclass(frozen=True, kw_only=True)
class FloorContact:
    """Contact samples of all bodies, in the form that the kernels need."""

    samples: SurfaceSamples  # without pinned ones
    rows: Rows  # on the free nodes
    # (n, dependent) weights of the constants of dependent nodes; None: there are no pins
    constants: sparse.csr_matrix | None
    driven: sparse.csr_matrix | None  # the same for prescribed nodes; None: there are none
    # (n + points, nodes) weights of free nodes, and of those of rigid regions
    nodes: sparse.csr_matrix
    layer: Floats  # (n,) [kg] of a layer one spacing thick: rho * area * s
    mass: Floats  # (n,) [kg] in the damping: that, or less where it moves less
    stiffness: Floats  # (n,) [N/m]
    pair_stiffness: Floats  # (n,) [N/m] in contact with a body or an obstacle
    damping: Floats  # (n,) [N s/m]
    tangential: Floats  # (n,) [N/m] of the tangential springs of friction; 0: none
    friction: Floats  # (n,)
    restitution: Floats  # (n,)
    linear: float  # [m] d0, depth down to which springs are linear
    hardening: float  # [1/m^2] 1 / a^2 beyond it
    omega2: float  # [1/s^2] largest eigenvalue of M^-1 W^T K W: the contact's stiffest vibration
    damping_rate: float  # [1/s] the same bound for M^-1 W^T C W
    points: int = 0  # rows of points of obstacles, which no node moves: see `obstacles.edge_points`

    @property
    def count(self) -> int:
        """Rows of samples and points."""
        return len(self.mass) + self.points

    @cached_property
    def pair_ratio(self) -> float:
        """Largest ratio of the stiffness of a sample in contact with a body or an obstacle to that
        on the floor, at least 1.
        """
        return float((self.pair_stiffness / self.stiffness).max(initial=1.0))

    @property
    def law(self) -> Floats:
        """(n + points, FLOOR_ROW) values for the kernels."""
        alike = np.ones_like(self.mass)
        rows = np.stack(
            [
                self.stiffness, self.damping, self.tangential, self.friction, self.mass,
                self.linear * alike, self.hardening * alike,
            ], 1
        )  # fmt: skip
        return np.pad(rows, ((0, self.points), (0, 0)))

    def normal_energy(self, depth: Floats) -> float:
        """sum_s k (d^2 / 2 + e^4 / (4 a^2)) [J] of depths (n,) [m]."""
        deeper = np.maximum(0.0, depth - self.linear)
        square = 0.5 * depth**2 + 0.25 * self.hardening * deeper**4
        return float(self.stiffness @ square)

    def stiffer(self, depth: float) -> float:
        """1 + 3 e^2 / a^2: ratio of a spring's tangent stiffness at a depth [m] to that at
        depth 0.
        """
        return 1.0 + 3.0 * self.hardening * max(0.0, depth - self.linear) ** 2


def pressed_step(contact: FloorContact | None, step: StableStep, depth: float) -> StableStep:
    """The step at rest, with the floor's springs as stiff as at a depth [m] of the deepest
    sample.
    """
    return step if contact is None else step.hardened(contact.stiffer(depth))


def stiffness_per_mass(
    *,
    modulus: Floats,
    spacing: float,
    impact_speed: Floats,
    pressure: Floats,
    density: Floats,
    times: float = 1.0,
) -> Floats:
    """k/m [1/s^2] of the module's formula; modulus : E* [Pa]; times : factor on all but the first
    term.
    """
    elastic = HALF_SPACE * modulus / (density * spacing**2)
    stopping = (impact_speed / (STOPPING_DISTANCE * spacing)) ** 2
    resting = pressure / (REST_DEPTH * density * spacing**2)
    return np.maximum(elastic, times * np.maximum(stopping, resting))


def plane_modulus(youngs: Floats, poisson: Floats) -> Floats:
    """E* = E / (1 - nu^2) [Pa], for contact with a rigid surface."""
    return youngs / (1.0 - poisson**2)


def hertz_pressure(*, weight: Floats, radius: Floats, modulus: Floats) -> Floats:
    """p0 = (6 W E*^2 / (pi^3 r^2))^(1/3) [Pa]: a sphere on a rigid plane; modulus : E* [Pa]."""
    return np.cbrt(6.0 * weight * modulus**2 / (np.pi**3 * radius**2))


def damping_coefficient(k: Floats, m: Floats, restitution: Floats) -> Floats:
    """c = -2 sqrt(k m) ln r / sqrt(pi^2 + ln^2 r) [N s/m] (GaussianFlesh section 3.4).

    A point mass on such a spring rebounds with r times its impact speed, slightly more because the
    floor does not pull (.855 for r = .85); r = 0 is critical damping.
    """
    ln = np.log(np.maximum(restitution, 1e-6))
    return -2.0 * np.sqrt(k * m) * ln / np.sqrt(np.pi**2 + ln**2)


def build_contact(
    samples: SurfaceSamples,
    stencil: Stencil,
    *,
    spacing: float,
    density: Floats,
    modulus: Floats,
    friction: Floats,
    restitution: Floats,
    impact_speed: Floats,
    pressure: Floats,
    rate: float | None = None,
    mass: NodalMass | None = None,
    points: int = 0,
    carried: sparse.csr_matrix | None = None,
) -> FloorContact:
    """Contact samples with their rows; material values are per sample (n,).

    rate : [1/s^2] stiffness per mass instead of the formula. The floor then does not harden, and
    friction is viscous as in the paper.
    mass : of the free nodes; None: lumped.
    points : rows of points of obstacles.
    carried : (n, nodes) weights by which samples move, where these are not their rows.
    """
    # The floor acts on sliding nodes too: a sample has one row for all axes.
    rows = stencil.across.rows(samples.X, samples.body, samples.cell_copy, gradients=False)
    constants = None
    driven, nodes = None, rows.W
    if stencil.held.any:
        free = stencil.free_count
        constants = driven = rows.W[:, free:]
        rows = Rows(X=rows.X, W=rows.W[:, :free], G=rows.G)
        nodes = rows.W
        if stencil.region is not None:
            own = sparse.diags_array((stencil.region[free:] >= 0).astype(float))
            mine = sparse.csr_matrix(constants @ own)
            driven = sparse.csr_matrix(constants - mine)
            driven.eliminate_zeros()
            mine.eliminate_zeros()
            nodes = sparse.csr_matrix(sparse.hstack([rows.W, mine], format="csr"))
            nodes.sort_indices()
    mass = lumped_mass(stencil) if mass is None else mass
    W = rows.W if carried is None else carried
    layer = density * samples.area * spacing
    moved = layers_moved(W, layer, mass) if rate is None else np.zeros_like(layer)
    m = layer * (LIGHT / np.maximum(LIGHT, moved))
    stiff = layer * (STIFF / np.maximum(STIFF, moved))

    def stiffness(times: float) -> Floats:
        if rate is not None:
            return stiff * rate
        return stiff * stiffness_per_mass(
            modulus=modulus, spacing=spacing, impact_speed=impact_speed, pressure=pressure,
            density=density, times=times,
        )  # fmt: skip

    k = stiffness(1.0)
    c = damping_coefficient(k, m, restitution)
    return FloorContact(
        samples=samples,
        rows=rows,
        constants=constants,
        driven=driven,
        nodes=_with_empty_rows(nodes, points),
        layer=layer,
        mass=m,
        stiffness=k,
        pair_stiffness=stiffness(PAIR_STIFFNESS),
        damping=c,
        tangential=k.copy() if rate is None else np.zeros_like(k),
        friction=np.broadcast_to(friction, m.shape).astype(float),
        restitution=np.broadcast_to(restitution, m.shape).astype(float),
        linear=STOPPING_DISTANCE * spacing,
        hardening=(HARD * spacing) ** -2 if rate is None else 0.0,
        omega2=contact_eigenvalue(W, k, mass),
        damping_rate=contact_eigenvalue(W, c, mass),
        points=points,
    )


def _with_empty_rows(W: sparse.csr_matrix, more: int) -> sparse.csr_matrix:
    """The same matrix with `more` empty rows at its end."""
    start = np.append(W.indptr, np.full(more, W.indptr[-1], W.indptr.dtype))
    shape = (W.shape[0] + more, W.shape[1])
    return sparse.csr_matrix((W.data, W.indices, start), shape=shape)


def layers_moved(W: sparse.csr_matrix, layer: Floats, mass: NodalMass) -> Floats:
    """(n,) masses of samples, relative to what they move: y = |W| M^-1 |W|^T layer.

    With forces proportional to `layer` (n,) [kg] on all samples, sample s accelerates y_s times as
    fast as a mass of `layer` would alone. With masses m of at most STIFF / y of the layer, the
    largest eigenvalue of M^-1 W^T diag(m) W, which is that of diag(m / layer) W M^-1 W^T
    diag(layer), is at most STIFF: its rows have sums of at most that (lumped M).
    """
    size = abs(W)
    return np.asarray(size @ ((size.T @ layer) / mass.lumped))


def contact_eigenvalue(W: sparse.csr_matrix, k: Floats, mass: NodalMass) -> float:
    """Largest eigenvalue of M~^-1 W^T diag(k) W."""
    if W.shape[0] == 0:
        return 0.0
    if mass.is_lumped:
        return largest_eigenvalue(W, k, mass.lumped)
    start = np.random.default_rng(0).uniform(0.5, 1.5, W.shape[1])
    return spectrum.largest_eigenvalue(mass.acceleration, lambda a: W.T @ (k * (W @ a)), start)


def largest_eigenvalue(W: sparse.csr_matrix, k: Floats, mass: Floats) -> float:
    """Largest eigenvalue of M^-1 W^T diag(k) W, by power iteration from a fixed start.

    Power iteration converges from below; the residual bounds the difference and is added.
    """
    if W.shape[0] == 0:
        return 0.0
    root = 1.0 / np.sqrt(mass)
    q = np.random.default_rng(0).uniform(0.5, 1.5, W.shape[1])
    value = 0.0
    for _ in range(60):
        q /= np.linalg.norm(q)
        p = root * (W.T @ (k * (W @ (root * q))))
        value = float(q @ p)
        residual = float(np.linalg.norm(p - value * q))
        if residual <= 0.01 * value:
            break
        q = p
    return value + residual


def move_springs(
    state: DeviceState, velocity: Callable[[Ints], Floats], normal: Floats, time: float
) -> None:
    """Advance the friction springs of the floor with their samples by a time [s].

    velocity : of samples (k,), (k, 3) [m/s]. Forces are evaluated half a substep after the start of
    a frame and half a substep before its end; frames and restarts refer to the end.
    """
    held = nonzero_rows(host_view(state.arrays["sample_spring"]).reshape(-1, 3))
    if len(held):
        xi, v = state.rows("sample_spring"), velocity(held)
        xi[held] += time * (v - np.outer(v @ normal, normal))
        state.put("sample_spring", xi)


def spring_energy(tangential: Floats, xi: Floats) -> float:
    """sum_s k_t |xi|^2 / 2 [J] of tangential (n,) [N/m] and xi (n, 3) [m]."""
    return float(0.5 * tangential @ (xi * xi).sum(1))
