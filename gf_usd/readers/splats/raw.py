"""``.splat`` files: 32 bytes for each Gaussian and no header.

x, y, z and the three standard deviations as float32; red, green, blue, opacity as bytes over 255;
the quaternion (w, x, y, z) as bytes (b - 128) / 128.  There are no spherical harmonics above
degree 0.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gf_usd.core.asset import Splats
from gf_usd.core.errors import InputError
from gf_usd.core.radiance import Y_0
from gf_usd.readers.mesh.data import REPAIR, refuse_pointer

ROW = np.dtype([("at", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("turn", "u1", 4)])


def read_raw_splats(path: Path) -> Splats:
    """The Gaussians of a .splat file.  Raises InputError where its size is not whole rows."""
    data = path.read_bytes()
    refuse_pointer(path, data)
    if len(data) % ROW.itemsize:
        raise InputError(
            f"{path} has {len(data)} bytes, which is not a multiple of {ROW.itemsize}: it is "
            f"not a .splat file or was truncated",
            REPAIR,
        )
    rows = np.frombuffer(data, ROW)
    return Splats(
        positions=rows["at"],
        orientations=(rows["turn"].astype(np.float64) - 128.0) / 128.0,
        scales=rows["scale"],
        opacities=rows["rgba"][:, 3] / 255.0,
        harmonics=((rows["rgba"][:, None, :3] / 255.0 - 0.5) / Y_0).astype(np.float32),
    )
