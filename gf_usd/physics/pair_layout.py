"""Where the numbers of a contact between bodies stand in the kernels' arrays."""

import numpy as np

from gf_usd.model import Floats

NOBODY = -1
OBSTACLE = -2

# A kernel takes few arrays: all numbers of a sample stand in one row of `pair`, ...
ROW = 30
REST, DRIFT, PLACE, RATE, FORCE = 0, 3, 6, 9, 12  # X, its rate by a pin, x, v, f
POINT, NORMAL, VELOCITY = 15, 18, 21  # q (of a body's plane: from x_b), n, v_q of an obstacle
STIFFNESS, DAMPING, FRICTION, MASS = 24, 25, 26, 27
DEPTH, WORK = 28, 29  # deepest [m] and work of an obstacle [J] since they were cleared
# ... and its whole numbers in one of `links`: b; where its list starts; one entry of all lists.
LINKS = 3
PARTNER, START, FACING = 0, 1, 2


def pack_arrays(n: int) -> dict[str, Floats]:
    """The meeting's part of the kernels' pack for n samples; n = 0 where nobody meets."""
    return {
        "pair": np.zeros(ROW * max(1, n)),
        "links": np.full(LINKS * (n + 1), NOBODY),
    }
