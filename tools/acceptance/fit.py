"""How well `gf-usd fit` recovers a known material, as tables on stdout.

    python -m tools.acceptance.fit              targets of the Updated Lagrangian solver
    python -m tools.acceptance.fit --coverage   intervals under noise of 1 %, over seeds

The targets of the first are point caches that `bake --solver ul` makes of the sphere of `samples`,
with more and more particles; the fit simulates 1,000 particles with the Total Lagrangian solver.
The second adds normal noise of 1 % of the radius to every coordinate of a cache of the solver that
fits, so that the truth is known to be within its reach, and counts how often each interval of 95 %
covers it.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from pxr import Usd, Vt

import gf_usd
from gf_usd.core.materials.presets import find_preset

SPHERE = Path(__file__).parents[2] / "samples" / "sphere.usda"
TRUTH = {"youngs_modulus": 4e5, "poissons_ratio": 0.33, "damping_time": 6.4e-3}
UPDATED = (1000, 8000, 27000)  # particles of the targets
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
    parser.add_argument("--seeds", type=int, default=SEEDS)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if asked.coverage:
            covered(Path(folder), asked.seeds)
        else:
            recovered(Path(folder))


if __name__ == "__main__":
    main()
