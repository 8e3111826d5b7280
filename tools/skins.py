"""Measure the skins against deformations with a closed form; write the tables of docs/physics.md.

    python tools/skins.py [--doc FILE]    between the lines <!-- skins --> and <!-- /skins -->

Every map is applied exactly to the particles of a body (positions, velocities, F), the skins carry
the vertices of its mesh, and where these come to lie is compared with the map.  The embedding rides
on nodal displacements u instead, which the map does not give; two ways to find them are measured:

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
from skins_maps import MAPS, Motion

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames import Particles, Pose
from gf_usd.geometry.sampling import sample_solid
from gf_usd.geometry.skinning import NEIGHBOURS, SKINS, InverseDistance, Skin
from gf_usd.geometry.solid import build_solid
from gf_usd.physics.grid.embedding import pose
from gf_usd.physics.grid.reference import build_stencil
from gf_usd.physics.total_lagrangian.solver import CELL_PER_LATTICE
from gf_usd.readers import read_asset

ROOT = Path(__file__).resolve().parent.parent
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
    """A sample filled with particles, and the ways for its mesh to ride on them."""

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
        """A map of MAPS about the particles' centre, in radii of the body."""
        X = self.particles.X
        return Motion(map=MAPS[name], centre=X.mean(0), radius=self.particles.radius)

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
            return lambda: pose(vertices, u, v, np.zeros(3))

        def at_particles(motion: Motion) -> Callable[[], Pose]:
            exact = motion.pose(p.X)
            u = fit(exact.x - p.X, exact.F - np.eye(3))
            v = fit(exact.v, motion.dF(p.X))
            return lambda: pose(vertices, u, v, np.zeros(3))

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
    yield f"**{body.name}**, k = {NEIGHBOURS}:"
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
