"""Read a bake as arrays: how high the body is, how much it is squashed, and where it is strained.

python samples/python/read_a_bake.py out/duck.rubber-soft-foam.usda table.csv
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import numpy as np

import gf_usd


def main(root: Path, table: Path) -> None:
    bake = gf_usd.read(root)
    masses = bake.rest["masses"]
    at_rest = np.ptp(bake.rest["positions"] @ bake.up)  # [m]
    with table.open("w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["time [s]", "height [m]", "squash", "most strained particle"])
        for frame in bake:
            heights = frame.positions @ bake.up
            # the longest axis of each Gaussian, over that of all at rest
            covariances = frame.covariances
            worst = -1
            if covariances is not None:
                worst = int(np.linalg.eigvalsh(covariances)[:, 2].argmax())
            rows.writerow(
                [
                    f"{frame.time:.4f}",
                    f"{masses @ heights / masses.sum():.5f}",
                    f"{np.ptp(heights) / at_rest:.3f}",
                    worst,
                ]
            )
    deepest = bake.health["penetration"].max()
    print(f"{table}: {len(bake)} frames; it went {1e3 * deepest:.3g} mm into the floor at most")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
