"""Measure the skins against deformations with a closed form; write the tables of docs/physics.md.

    python -m tools.acceptance.skins [--doc FILE]    between <!-- skins --> and <!-- /skins -->

Every map is applied exactly to the particles of a body (positions, velocities, F), the skins move
the vertices of its mesh, and their positions are compared with the map.  A map takes rest positions
q (n, 3) in radii from the body's center and an amplitude s, 1 at full deformation and 0 at rest, to
deformed positions.  Read as a motion, s is time.  The embedding uses nodal displacements u instead,
which the map does not define; two methods to compute them are measured:

    nodes      u_i = phi(X_i) - X_i at the free nodes
    particles  least squares, W u = x - X and h G u = h (F - I) at the particles
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.frame import Pose
from gf_usd.core.frames.particles import Particles
from gf_usd.geometry.sampling.particles import sample_solid
from gf_usd.geometry.skinning import NEIGHBORS, SKINS, InverseDistance, Skin
from gf_usd.geometry.solid import build_solid
from gf_usd.physics.grid.embedding import embedded_pose
from gf_usd.physics.grid.reference.build import build_stencil
from gf_usd.physics.total_lagrangian.setup.build import CELL_PER_LATTICE
from gf_usd.readers import read_asset

Map = Callable[[Floats, float], Floats]
STEP = 1e-5  # of central differences, in radii and in s: both errors are near 1e-10

BEND = 0.5  # curvature [1/r]: the fiber at one radius on the inside is half as long
TWIST = np.pi / 4.0  # [rad/r]: a quarter turn over two radii
SQUASH = 0.6  # height over rest height


def turn(q: Floats, s: float) -> Floats:
    """A rigid turn of 90 degrees about the diagonal (1, 1, 1)."""
    return rotated(q, np.ones(3) / np.sqrt(3.0), np.full(len(q), s * np.pi / 2.0))


def squash(q: Floats, s: float) -> Floats:
    """diag(c^-1/2, c, c^-1/2) q with c = SQUASH: a pure stretch that keeps the volume."""
    c = 1.0 - s * (1.0 - SQUASH)
    return q * np.array([c**-0.5, c, c**-0.5])


def bend(q: Floats, s: float) -> Floats:
    """The x axis wound on a circle: (y' sin kx, 1/k - y' cos kx, z), y' = 1/k - y, k = s BEND."""
    k = s * BEND
    x, y, z = q.T
    return np.stack([(1 / k - y) * np.sin(k * x), 1 / k - (1 / k - y) * np.cos(k * x), z], 1)


def twist(q: Floats, s: float) -> Floats:
    """A turn about y by the angle s TWIST y."""
    return rotated(q, np.array([0.0, 1.0, 0.0]), s * TWIST * q[:, 1])


def rotated(q: Floats, axis: Floats, angle: Floats) -> Floats:
    """Rodrigues' rotation of q (n, 3) about a unit axis by angles (n,) [rad]."""
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return q * c + np.cross(axis, q) * s + axis * (q @ axis)[:, None] * (1.0 - c)


MAPS: dict[str, Map] = {"squash": squash, "90° turn": turn, "bend": bend, "twist": twist}


@dataclass(frozen=True, kw_only=True)
class Motion:
    """A map at the scale r [m] and the center (3,) [m] of a body, at s = 1."""

    map: Map
    center: Floats
    radius: float

    def x(self, X: Floats, s: float = 1.0) -> Floats:
        """(n, 3) [m] deformed positions of X (n, 3) [m]."""
        return self.center + self.radius * self.map((X - self.center) / self.radius, s)

    def v(self, X: Floats) -> Floats:
        """dx/ds (n, 3) [m] at s = 1."""
        return (self.x(X, 1.0 + STEP) - self.x(X, 1.0 - STEP)) / (2.0 * STEP)

    def F(self, X: Floats, s: float = 1.0) -> Floats:
        """dx/dX (n, 3, 3)."""
        d = STEP * self.radius
        sides = [(self.x(X + d * e, s), self.x(X - d * e, s)) for e in np.eye(3)]
        return np.stack([(a - b) / (2.0 * d) for a, b in sides], -1)

    def dF(self, X: Floats) -> Floats:
        """d^2x/dX ds (n, 3, 3) at s = 1."""
        # A difference of differences: a wider step keeps its rounding near 1e-7.
        d = 100.0 * STEP
        return (self.F(X, 1.0 + d) - self.F(X, 1.0 - d)) / (2.0 * d)

    def pose(self, X: Floats) -> Pose:
        """The exact pose of points X (n, 3) [m]."""
        return Pose(x=self.x(X), v=self.v(X), F=self.F(X))


ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ("sphere", "duck")
PARTICLES = 2000
REPEATS = 7  # of a timing; the least is reported
POWERS = (2.0, 3.0, 4.0, 5.0, 6.0, 8.0)
NOISE = 0.02  # spacings: standard deviation of the positions in the test of powers
ROUNDING = 1e-6  # [r]: the maps' differences leave 1e-10, the solver works in float32
BEGIN, END = "<!-- skins -->", "<!-- /skins -->"

# Made ready for a motion; the call that remains is what a frame costs.
Ride = Callable[[Motion], Callable[[], Pose]]


@dataclass(frozen=True, kw_only=True)
class Error:
    """How far a skin is from the exact map."""

    mean: float  # [r] distance of vertices
    max: float  # [r]
    angle: float  # [deg] mean between the normals of triangles
    folded: int  # triangles whose normal points away from the exact one
    velocity: float  # mean distance of velocities over the mean speed


class Body:
    """A sample filled with particles, and the skins by which its mesh follows them."""

    def __init__(self, name: str) -> None:
        asset = read_asset(ROOT / "samples" / f"{name}.usda")
        (surface,) = asset.surfaces
        self.name = name
        self.vertices: Floats = np.asarray(surface.points, float)
        self.triangles: Ints = surface.triangles
        self.particles: Particles = sample_solid(
            build_solid(asset), particles=PARTICLES, spacing=None, seed=0
        )

    def motion(self, name: str) -> Motion:
        """A map of MAPS about the particles' center, in radii of the body."""
        X = self.particles.X
        return Motion(map=MAPS[name], center=X.mean(0), radius=self.particles.radius)

    def rides(self) -> dict[str, Ride]:
        """Every skin by name."""
        skins = {name: build(self.vertices, self.particles.X) for name, build in SKINS.items()}
        return {**self._embeddings(), **{name: self._follow(s) for name, s in skins.items()}}

    def _follow(self, skin: Skin) -> Ride:
        def ready(motion: Motion) -> Callable[[], Pose]:
            exact = motion.pose(self.particles.X)
            return lambda: skin.pose(exact)

        return ready

    def _embeddings(self) -> dict[str, Ride]:
        p = self.particles
        h = CELL_PER_LATTICE * p.lattice
        stencil = build_stencil(p.X, p.V0, h, p.corner)
        vertices, rows, X = stencil.rows(self.vertices), stencil.rows(p.X), stencil.free_X
        Q, R = np.linalg.qr(sparse.vstack([rows.W, *(h * G for G in rows.G)]).toarray())

        def fit(value: Floats, gradient: Floats) -> Floats:
            b = np.concatenate([value, *(h * gradient[:, :, axis] for axis in range(3))])
            return np.linalg.solve(R, Q.T @ b)

        def at_nodes(motion: Motion) -> Callable[[], Pose]:
            u, v = motion.x(X) - X, motion.v(X)
            return lambda: embedded_pose(vertices, np.concatenate([u, v], 1), np.zeros(3))

        def at_particles(motion: Motion) -> Callable[[], Pose]:
            exact = motion.pose(p.X)
            u = fit(exact.x - p.X, exact.F - np.eye(3))
            v = fit(exact.v, motion.dF(p.X))
            return lambda: embedded_pose(vertices, np.concatenate([u, v], 1), np.zeros(3))

        return {"embed, u at nodes": at_nodes, "embed, u from particles": at_particles}

    def error(self, motion: Motion, skin: Pose) -> Error:
        """The pose of the vertices against the exact one."""
        x, v = motion.x(self.vertices), motion.v(self.vertices)
        away = np.linalg.norm(skin.x - x, axis=1) / motion.radius
        angle = self.angles(skin.x, x)
        return Error(
            mean=float(away.mean()),
            max=float(away.max()),
            angle=float(angle.mean()),
            folded=int((angle >= 90.0).sum()),
            velocity=float(
                np.linalg.norm(skin.v - v, axis=1).mean() / np.linalg.norm(v, axis=1).mean()
            ),
        )

    def angles(self, x: Floats, y: Floats) -> Floats:
        """(T,) [deg] between the normals of the triangles at x and at y; 90 where collapsed."""
        cosine = (self._normals(x) * self._normals(y)).sum(1)
        return np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))

    def _normals(self, x: Floats) -> Floats:
        a, b, c = np.moveaxis(x[self.triangles], 1, 0)
        n = np.cross(b - a, c - a)
        length = np.linalg.norm(n, axis=1, keepdims=True)
        return n / np.where(length > 0.0, length, 1.0)


def milliseconds(frame: Callable[[], Pose]) -> float:
    """The least time [ms] of a frame."""
    took = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        frame()
        took.append(time.perf_counter() - began)
    return 1e3 * min(took)


def compare(body: Body) -> Iterator[str]:
    """The table of one body: every map with every skin."""
    rides = body.rides()
    p = body.particles
    yield (
        f"**{body.name}**: {len(p)} particles {p.spacing / p.radius:.3f} r apart,"
        f" {len(body.vertices)} vertices, {len(body.triangles)} triangles."
    )
    yield ""
    yield "| map | skin | mean [r] | max [r] | normals [deg] | folded | velocity | ms a frame |"
    yield "|---|---|--:|--:|--:|--:|--:|--:|"
    for name in MAPS:
        motion = body.motion(name)
        for skin, ride in rides.items():
            frame = ride(motion)
            e = body.error(motion, frame())
            yield (
                f"| {name} | {skin} | {small(e.mean)} | {small(e.max)} | {e.angle:.2f} | {e.folded}"
                f" | {100.0 * e.velocity:.1f} % | {milliseconds(frame):.1f} |"
            )
    yield ""


def powers(body: Body) -> Iterator[str]:
    """The table of the power of the idw skin: errors on exact and on jittered particles."""
    X, spacing = body.particles.X, body.particles.spacing
    jitter = NOISE * spacing * np.random.default_rng(0).normal(size=X.shape)
    yield f"**{body.name}**, k = {NEIGHBORS}:"
    yield ""
    yield (
        "| power | bend: mean [r] | normals [deg] | twist: mean [r] | normals [deg]"
        " | jitter: normals [deg] |"
    )
    yield "|--:|--:|--:|--:|--:|--:|"
    for power in POWERS:
        skin = InverseDistance(body.vertices, X, power=power)
        cells = []
        for name in ("bend", "twist"):
            motion = body.motion(name)
            e = body.error(motion, skin.pose(motion.pose(X)))
            cells += [small(e.mean), f"{e.angle:.2f}"]
        rest = Pose(x=X + jitter, v=np.zeros_like(X), F=np.broadcast_to(np.eye(3), (len(X), 3, 3)))
        ripple = body.angles(skin.pose(rest).x, body.vertices)
        cells.append(f"{ripple.mean():.2f}")
        yield f"| {power:g} | {' | '.join(cells)} |"
    yield ""


def small(value: float) -> str:
    """Four decimals; 0 for what is rounding."""
    return "0" if value < ROUNDING else f"{value:.4f}"


def tables() -> str:
    """Everything between the markers."""
    bodies = [Body(name) for name in SAMPLES]
    lines = [line for body in bodies for line in compare(body)]
    lines += [
        "The power of `idw`, for the same maps and for the body at rest with its particles",
        f"displaced at random by a standard deviation of {NOISE:g} spacings along each axis.",
        "",
    ]
    return "\n".join([*lines, *(line for body in bodies for line in powers(body))])


def main() -> None:
    """Measure, and write the tables into the file of --doc."""
    parser = argparse.ArgumentParser(description="Measure the skins.")
    parser.add_argument("--doc", type=Path, default=ROOT / "docs" / "physics.md")
    doc: Path = parser.parse_args().doc
    made = tables()
    text = doc.read_text("utf-8")  # after measuring: other sections may have changed meanwhile
    if text.count(BEGIN) != 1 or text.count(END) != 1:
        raise SystemExit(f"{doc}: one line {BEGIN} and one line {END} are needed")
    head, rest = text.split(BEGIN)
    tail = rest.split(END)[1]
    doc.write_text(f"{head}{BEGIN}\n\n{made}\n{END}{tail}", "utf-8")
    print(made)


if __name__ == "__main__":
    main()
