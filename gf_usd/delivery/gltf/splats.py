"""Gaussians as a glTF primitive of points with the extension KHR_gaussian_splatting.

The extension is ratified (Khronos Group, glTF 2.0, kernel "ellipse"): scales are linear standard
deviations, rotations unit quaternions (x, y, z, w), opacities 0 to 1, and

    color = 1/2 + sum_k h_k Y_k(d),

real spherical harmonics with the Condon-Shortley phase at the direction d from the camera.  A
loader that does not support it shows points of COLOR_0.  The extension does not mention skins and
morph targets, which glTF itself defines for every primitive: they move the positions.  A covariance
S under the blended matrix M of a skin becomes M S M^T, as the extension defines for the matrix of a
node.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.matrices import ellipsoids
from gf_usd.core.radiance import Y_0, srgb_to_linear, turned
from gf_usd.delivery.splats.clouds import Cloud

NAME = "KHR_gaussian_splatting"
SHORT = 32767
POINTS = 0  # the mode of the primitive


def extension(cloud: Cloud) -> dict[str, Any]:
    """The extension object of a primitive."""
    return {
        NAME: {
            "kernel": "ellipse",
            "colorSpace": "srgb_rec709_display" if cloud.srgb else "lin_rec709_display",
            "projection": "perspective",
            "sortingMethod": "cameraDistance",
        }
    }


def attributes(
    cloud: Cloud, rows: Ints, turn: Floats
) -> dict[str, tuple[NDArray[np.generic], bool]]:
    """(n, width) of each attribute besides the positions, and whether it is normalized.

    rows : which Gaussians.  turn : (3, 3) rotation of the file's axes against the world's.
    """
    quaternions, scales = ellipsoids(turn @ cloud.axes[0, rows].astype(np.float64))
    light = np.asarray(cloud.harmonics)[rows]
    if not np.array_equal(turn, np.eye(3)):
        light = turned(light, turn)
    base = np.clip(0.5 + Y_0 * light[:, 0], 0.0, 1.0)
    if cloud.srgb:
        base = srgb_to_linear(base)  # COLOR_0 is linear
    opacities = np.asarray(cloud.opacities)[rows, None]
    color = np.column_stack([base, opacities])
    made: dict[str, tuple[NDArray[np.generic], bool]] = {
        f"{NAME}:ROTATION": (np.rint(quaternions * SHORT).astype(np.int16), True),
        f"{NAME}:SCALE": (scales.astype(np.float32), False),
        f"{NAME}:OPACITY": (opacities.astype(np.float32), False),
        "COLOR_0": (np.rint(255.0 * color).astype(np.uint8), True),
    }
    for k in range(light.shape[1]):
        degree = int(np.sqrt(k))
        name = f"{NAME}:SH_DEGREE_{degree}_COEF_{k - degree**2}"
        made[name] = (light[:, k].astype(np.float32), False)
    return made
