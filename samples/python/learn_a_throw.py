"""A loop that learns: find the speed at which a ball of jelly is over a mark after half a second.

python samples/python/learn_a_throw.py
"""

from __future__ import annotations

import trimesh

import gf_usd

MARK = 0.5  # [m] along x
CLOSE = 0.005  # [m]


class Throw:
    """A ball that is thrown again and again: the scene is built once, and its start is loaded."""

    def __init__(self, particles: int, frames: int) -> None:
        scene = gf_usd.Scene(floor=0.0)
        ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
        ball.apply_translation((0.0, 0.3, 0.0))
        scene.add_body(ball, material="jelly")
        self.simulation = gf_usd.simulate(scene, frames=frames, particles=particles)
        next(self.simulation)
        self.start = self.simulation.save()

    def __call__(self, speed: float) -> float:
        """[m] of the middle of the ball in the last frame; speed : [m/s] along x at the start."""
        self.simulation.load(self.start)
        self.simulation.set_velocities((speed, 0.0, 0.0))
        middle = 0.0
        for frame in self.simulation:
            middle = frame.health.center[0]
        return middle


def main(particles: int = 500, frames: int = 12, tries: int = 8) -> float:
    throw = Throw(particles, frames)
    one, other = 0.5, 1.5  # [m/s]
    at_one, at_other = throw(one), throw(other)
    for number in range(tries):
        slope = (at_other - at_one) / (other - one)
        one, at_one = other, at_other
        other += (MARK - at_other) / slope
        at_other = throw(other)
        print(f"try {number}: {other:.3f} m/s ends at {at_other:.3f} m")
        if abs(at_other - MARK) < CLOSE:
            break
    return at_other


if __name__ == "__main__":
    main()
