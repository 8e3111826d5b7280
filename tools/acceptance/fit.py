"""How well `gf-usd fit` recovers a known material, as tables on stdout.

    python -m tools.acceptance.fit              targets of the Updated Lagrangian solver
    python -m tools.acceptance.fit --genesis    targets of genesis-world's MPM
    python -m tools.acceptance.fit --coverage   intervals under noise of 1 %, over seeds

The targets of the first are point caches that `bake --solver ul` makes of the sphere of `samples`,
with increasing numbers of particles; the fit simulates 1,000 particles with the Total Lagrangian
solver. Those of the second are made by genesis-world, in its own environment: a ball that two
fields compress, and the drop of `tools/bench/scene.py`, with its own contact. Its particles move
the mesh of the sphere. It has no material damping, so that only E and nu are estimated. The third
adds normal noise of 1 % of the radius to every coordinate of a cache of the same solver, so that
the fit can reach the true values, and counts how often each interval of 95 % contains them.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom, Vt
from scipy.spatial import cKDTree

import gf_usd
from gf_usd.core.materials.presets import find_preset
from tools.bench import processes
from tools.bench import scene as drop

SPHERE = Path(__file__).parents[2] / "samples" / "sphere.usda"
TRUTH = {"youngs_modulus": 4e5, "poissons_ratio": 0.33, "damping_time": 6.4e-3}
UPDATED = (1000, 8000, 27000)  # particles of the targets
GENESIS = (("squeeze", 10_000), ("squeeze", 27_000), ("squeeze", 64_000), ("drop", 10_000))
FRAMES = {"squeeze": 15, "drop": 78}  # of 1/120 s: the first vibration, and the whole drop
SQUEEZE = 60.0  # [m/s^2], which takes 4 % of its height
NEAREST = 24  # particles that a point of the mesh moves with
MOST_SECONDS = 500.0  # of a run of genesis-world
SEEDS = 20
NOISE = 0.01  # of the radius, 1 m


def truth() -> gf_usd.Material:
    """The material that is to be found."""
    return replace(find_preset("rubber").material(1.0), name="truth", **TRUTH)


def row(name: str, found: gf_usd.FitResult) -> str:
    """A line of a table: what was found, against the truth."""
    values = {one.name: one.value for one in found.estimates}
    young = np.log10(values["youngs_modulus"] / TRUTH["youngs_modulus"])
    poisson = values["poissons_ratio"] - TRUTH["poissons_ratio"]
    damping = 100.0 * (values["damping_time"] / TRUTH["damping_time"] - 1.0)
    rms = 1000.0 * found.targets[0].fitted
    return (
        f"| {name} | {young:+.4f} | {poisson:+.4f} | {damping:+.1f} % | {rms:.2f} mm |"
        f" {found.simulations} | {found.seconds:.0f} |"
    )


def recovered(folder: Path) -> None:
    """The table of targets of the other solver."""
    print("| target | error of log10 E | of nu | of damping | left | simulations | s |")
    print("|---|---|---|---|---|---|---|")
    scene = {"drop": 1.0, "frames": 40, "only": "mesh"}
    targets = [
        gf_usd.bake(SPHERE, material=truth(), particles=1000, output=folder / "t.usda", **scene)
    ]
    targets += [
        gf_usd.bake(
            SPHERE, material=truth(), solver="ul", particles=count, output=folder / f"{count}.usda",
            **scene,
        )
        for count in UPDATED
    ]  # fmt: skip
    for target in targets:
        found = gf_usd.fit(
            SPHERE, target.root, material="rubber", particles=1000, evaluations=folder / "kept",
            drop=scene["drop"],
        )  # fmt: skip
        name = f"{target.settings.solver}, {target.particles} particles"
        print(row(name, found), flush=True)


def carried(X: np.ndarray, x: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(T, k, 3) points (k, 3) at rest, moved with particles X (n, 3) at rest and x (T, n, 3).

    Each by the affine map that fits its NEAREST particles best, weighted by (1 - (r / R)^2)^2.
    """
    away, near = cKDTree(X).query(points, NEAREST)
    weight = (1.0 - (away / (1.01 * away[:, -1:])) ** 2) ** 2
    basis = np.concatenate([np.ones((*near.shape, 1)), X[near] - points[:, None]], 2)  # (k, m, 4)
    normal = np.einsum("km,kma,kmb->kab", weight, basis, basis)
    # the value of the fit at the point itself is its constant term
    rows = np.linalg.solve(normal, np.swapaxes(weight[..., None] * basis, 1, 2))[:, 0]
    return np.einsum("km,tkma->tka", rows, x[:, near])


def genesis_target(python: str, motion: str, count: int, folder: Path) -> Path:
    """A motion of the sphere's mesh by genesis-world, as a USD file."""
    # a frame is a whole number of substeps
    dt = 1.0 / (drop.FPS * np.ceil(1.0 / (drop.FPS * drop.step(count))))
    made = folder / f"{motion}{count}.npz"
    job = {"kind": "motion", "n": count, "dt": dt, "to": str(made), "frames": FRAMES[motion]}
    if motion == "squeeze":
        job["options"] = {"squeeze": SQUEEZE}
    found = processes.run(python, processes.PEERS["genesis"], job, [0, 1], MOST_SECONDS)
    if "failed" in found:
        raise SystemExit(f"genesis-world with {count:,} particles: {found['failed']}")
    with np.load(made) as kept:
        x, times = kept["x"].astype(float), kept["times"]
    stage = Usd.Stage.Open(Usd.Stage.Open(str(SPHERE)).Flatten())
    mesh = UsdGeom.Mesh.Get(stage, "/Sphere/Geom/Body")
    rest = np.asarray(mesh.GetPointsAttr().Get(), float)
    place = (0.0, drop.RADIUS + drop.GAP, 0.0)  # where genesis_mpm.py has the ball
    X = x[0] - place
    if motion == "squeeze":
        x -= place  # the fit has it about the origin
    stage.SetTimeCodesPerSecond(drop.FPS)
    stage.SetStartTimeCode(1.0)
    stage.SetEndTimeCode(1.0 + drop.FPS * times[-1])
    for time, points in zip(times, carried(X, x, rest), strict=True):
        mesh.GetPointsAttr().Set(
            Vt.Vec3fArray.FromNumpy(points.astype(np.float32)), float(1.0 + drop.FPS * time)
        )
    target = folder / f"{motion}{count}.usdc"
    stage.Export(str(target))
    return target


def of_genesis(folder: Path, into: Path) -> None:
    """The table of targets of genesis-world."""
    print("| target | error of log10 E | of nu | left | simulations | s |")
    print("|---|---|---|---|---|---|")
    python = processes.interpreter("genesis", into)
    begun = replace(
        find_preset("rubber").material(1.0), name="begun", law="corotated", friction=0.0,
        restitution=1.0, damping_time=0.0, density=drop.DENSITY,
        youngs_modulus=0.5 * drop.YOUNG, poissons_ratio=0.3,
    )  # fmt: skip
    scenes = {
        "squeeze": {
            "fields": [f"radial:{SQUEEZE}:at=0,{y},0" for y in (-drop.FIELD_AT, drop.FIELD_AT)],
            "gravity": 0.0,
            "floor": False,
        },
        "drop": {"drop": drop.GAP, "velocity": (0.0, -drop.SPEED, 0.0)},
    }
    for motion, count in GENESIS:
        found = gf_usd.fit(
            SPHERE, genesis_target(python, motion, count, folder), material=begun,
            unknowns=("E", "nu"), particles=1000, evaluations=folder / "kept", fps=drop.FPS,
            filter_rate=0.0, no_settling=True, **scenes[motion],
        )  # fmt: skip
        values = {one.name: one.value for one in found.estimates}
        young = np.log10(values["youngs_modulus"] / drop.YOUNG)
        print(
            f"| genesis-world, {motion}, {count:,} particles | {young:+.4f}"
            f" | {values['poissons_ratio'] - drop.POISSON:+.4f}"
            f" | {1000.0 * found.targets[0].fitted:.2f} mm"
            f" | {found.simulations} | {found.seconds:.0f} |",
            flush=True,
        )


def noisy(source: Path, target: Path, seed: int) -> Path:
    """The motion of a bake, as one file, with noise on every coordinate of the mesh."""
    random = np.random.default_rng(seed)
    layer = Usd.Stage.Open(str(source)).Flatten()
    stage = Usd.Stage.Open(layer)
    for prim in stage.Traverse():
        points = prim.GetAttribute("points")
        for code in points.GetTimeSamples() if points else ():
            x = np.asarray(points.Get(code), np.float64)
            x += NOISE * random.standard_normal(x.shape)
            points.Set(Vt.Vec3fArray.FromNumpy(x.astype(np.float32)), code)
    layer.Export(str(target))
    return target


def covered(folder: Path, seeds: int) -> None:
    """How often the intervals of the values cover the truth."""
    scene = {"drop": 0.3, "fps": 30.0, "particles": 200}
    clean = gf_usd.bake(
        SPHERE, material=truth(), only="mesh", frames=16, output=folder / "clean.usda", **scene
    ).root
    hits = dict.fromkeys(TRUTH, 0)
    halves: dict[str, list[float]] = {name: [] for name in TRUTH}
    errors: dict[str, list[float]] = {name: [] for name in TRUTH}
    for seed in range(seeds):
        target = noisy(clean, folder / f"noisy{seed}.usdc", seed)
        found = gf_usd.fit(
            SPHERE, f"{target}+-1%", material="rubber", evaluations=folder / "kept", **scene
        )
        for one in found.estimates:
            hits[one.name] += one.low <= TRUTH[one.name] <= one.high
            halves[one.name].append(0.5 * (one.high - one.low) / TRUTH[one.name])
            errors[one.name].append(one.value / TRUTH[one.name] - 1.0)
        print(seed, hits, flush=True)
    print("| value | covered | half an interval, median | error, root mean square |")
    print("|---|---|---|---|")
    for name, count in hits.items():
        half = 100.0 * float(np.median(halves[name]))
        error = 100.0 * float(np.sqrt(np.mean(np.square(errors[name]))))
        print(f"| {name} | {count} of {seeds} | {half:.2f} % | {error:.2f} % |")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--coverage", action="store_true")
    parser.add_argument("--genesis", action="store_true")
    parser.add_argument("--into", type=Path, default=Path(".clients"), help="of genesis-world")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if args.coverage:
            covered(Path(folder), args.seeds)
        elif args.genesis:
            of_genesis(Path(folder), args.into)
        else:
            recovered(Path(folder))


if __name__ == "__main__":
    main()
