"""A loop that learns: find the speed at which a ball of jelly comes to lie at a mark.

python samples/python/learn_a_throw.py
"""

from __future__ import annotations

import trimesh

import gf_usd

MARK = 0.5  # [m] along x
CLOSE = 0.005  # [m]


def thrown(speed: float, particles: int, frames: int) -> float:
    """[m] where the middle of the ball is in the end; speed : [m/s] along x at the start."""
    scene = gf_usd.Scene(floor=0.0)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.1)
    ball.apply_translation((0.0, 0.3, 0.0))
    scene.add_body(ball, material="jelly", velocity=(speed, 0.0, 0.0))
    middle = 0.0
    with gf_usd.simulate(scene, frames=frames, particles=particles) as simulation:
        for frame in simulation:
            middle = frame.health.center[0]
    return middle


def main(particles: int = 500, frames: int = 12, tries: int = 8) -> float:
    one, other = 0.5, 1.5  # [m/s]
    at_one, at_other = (thrown(speed, particles, frames) for speed in (one, other))
    for number in range(tries):
        slope = (at_other - at_one) / (other - one)
        one, at_one = other, at_other
        other += (MARK - at_other) / slope
        at_other = thrown(other, particles, frames)
        print(f"try {number}: {other:.3f} m/s ends at {at_other:.3f} m")
        if abs(at_other - MARK) < CLOSE:
            break
    return at_other


if __name__ == "__main__":
    main()
