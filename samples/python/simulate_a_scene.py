"""Build a scene out of arrays and step it: a bar that is held at one end, and a hammer.

python samples/python/simulate_a_scene.py
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

import gf_usd

FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> NDArray[np.float64]:
    """(8, 3) [m] corners of a box, in the order of FACES."""
    ends = np.array([low, high])
    return np.array([[ends[i, 0], ends[j, 1], ends[k, 2]] for i, j, k in np.ndindex(2, 2, 2)])


def strike(time: float) -> NDArray[np.float64]:
    """(4, 4) where the hammer is: down by 5 cm within a tenth of a second, and up again."""
    matrix = np.eye(4)
    matrix[1, 3] = -0.05 * np.sin(np.pi * min(time / 0.2, 1.0))
    return matrix


def main(frames: int = 24, particles: int = 2000) -> list[float]:
    scene = gf_usd.Scene(gravity=9.81)
    scene.add_body(box((0, 0, 0), (0.4, 0.05, 0.1)), FACES, material="silicone", name="bar")
    scene.pin((-0.01, -0.01, -0.01), (0.05, 0.06, 0.11))
    scene.add_obstacle(box((0.3, 0.06, 0.0), (0.4, 0.1, 0.1)), FACES, motion=strike, name="hammer")
    tips: list[float] = []
    with gf_usd.simulate(scene, frames=frames, fps=100.0, particles=particles) as simulation:
        for frame in simulation:
            points = frame.meshes["bar"]
            tips.append(float(points[4:, 1].mean()))  # [m] of the free end
            print(f"{frame.time:.2f} s: the tip is at {1e3 * tips[-1]:6.1f} mm", end="")
            print(f", {frame.health.elastic:.3g} J are stored")
    return tips


if __name__ == "__main__":
    main()
