"""Arrays in a page: quantized, as differences over time, deflated, base64.

A number of 16 bits is ``low + step * code``.  The codes of a frame are stored as differences to
those of the frame before (they wrap), all low bytes before all high bytes, which deflates to
about half.  The page undoes it (report_page/data.js).
"""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats
from gf_usd.view.report.motion import Motion

OCTAVES = 2.0  # stretches from 1/4 to 4 have colors of their own


@dataclass
class Packer:
    """Collects arrays into one blob with a table of contents."""

    table: dict[str, dict[str, Any]] = field(default_factory=dict)
    parts: list[bytes] = field(default_factory=list)
    size: int = 0

    def add(self, name: str, values: NDArray[Any], *, moving: bool = False, **about: Any) -> None:
        """Append an array of uint8, int16, uint16 or uint32.

        moving : the first axis is time, and differences are stored.   about : kept in the table.
        """
        values = np.ascontiguousarray(values)
        if moving and len(values):
            codes = values.view(np.dtype(f"u{values.itemsize}"))
            codes = np.concatenate([codes[:1], codes[1:] - codes[:-1]])
        else:
            codes = values
        flat = np.ascontiguousarray(codes, dtype=codes.dtype.newbyteorder("<")).reshape(-1)
        raw = flat.view(np.uint8).reshape(-1, values.itemsize).T.tobytes()
        self.table[name] = {
            "type": values.dtype.name,
            "shape": list(values.shape),
            "offset": self.size,
            "moving": moving,
            **about,
        }
        self.parts.append(raw)
        self.size += len(raw)

    def blob(self) -> str:
        """Base64 of the deflated bytes (zlib's format)."""
        return base64.b64encode(zlib.compress(b"".join(self.parts), 6)).decode("ascii")


def pack(motion: Motion) -> tuple[dict[str, dict[str, Any]], str]:
    """Table of contents and blob of a variant."""
    packer, skin = Packer(), motion.skin
    packer.add("corners", skin.corners.astype(np.uint32))
    packer.add("source", skin.source.astype(np.uint32))
    packer.add("shade", skin.shade.astype(np.uint32))
    packer.add("meshColors", skin.colors)
    add_places(packer, "points", motion.points)
    packer.add("stretch", octaves(motion.stretch), moving=True)
    if motion.gaussians is not None:
        colors = np.clip(motion.gaussians.colors[motion.chosen], 0.0, 1.0)
        # linear light in 8 bits would show steps in the dark
        packer.add("gaussianColors", np.round(np.sqrt(colors) * 255.0).astype(np.uint8))
        add_places(packer, "positions", motion.positions)
        packer.add("turns", np.round(motion.turns * 127.0).astype(np.int8), moving=True)
        add_scales(packer, motion.scales)
        packer.add("ratio", octaves(motion.ratio), moving=True)
    if motion.flow is not None:
        flow = motion.flow
        packer.add("flowStarts", flow.starts.astype(np.uint32))
        packer.add("flowCorners", flow.corners.astype(np.uint32))
        packer.add("flowColors", flow.colors)
        add_places(packer, "flowPoints", flow.points, moving=False)
    for name, values in motion.measured.items():
        top = float(np.percentile(values, 99.5)) or 1.0
        code = np.clip(values / top, 0.0, 1.0)
        packer.add(name, np.round(code * 255.0).astype(np.uint8), moving=True, top=top)
    return packer.table, packer.blob()


def octaves(values: Floats) -> NDArray[np.uint8]:
    """1/4 to 4 as 1 to 255 by their logarithm; 1 is 128."""
    log = np.log2(np.maximum(values, 1e-9)) / OCTAVES
    return np.round(128.0 + 127.0 * np.clip(log, -1.0, 1.0)).astype(np.uint8)


def add_places(
    packer: Packer, name: str, values: NDArray[np.float32], *, moving: bool = True
) -> None:
    """Positions (F, n, 3) in 65536 steps over the box of the whole motion; (n, 3) if not moving."""
    flat = values.reshape(-1, 3)
    low = flat.min(axis=0) if len(flat) else np.zeros(3)
    high = flat.max(axis=0) if len(flat) else np.ones(3)
    step = np.maximum(np.asarray(high - low, dtype=np.float64) / 65535.0, 1e-30)
    code = np.round((values - low) / step).astype(np.uint16)
    packer.add(name, code, moving=moving, low=low.tolist(), step=step.tolist())


def add_scales(packer: Packer, scales: NDArray[np.float32], least: float = 0.0) -> float:
    """Semi-axes (F, n, 3) by their logarithm, 255 steps from the smallest to the largest.

    least : [m] smaller ones are as large as that; 0: a thousandth of the largest.  Returns the
    largest relative error of those that are not.
    """
    top = float(scales.max(initial=0.0)) or 1.0
    # an ellipsoid that is a thousandth as thick as the largest is a disc to the eye
    log = np.log(np.maximum(scales, least or 1e-3 * top))
    low, high = (float(log.min()), float(log.max())) if log.size else (0.0, 0.0)
    step = (high - low) / 255.0 or 1.0
    packer.add(
        "scales", np.round((log - low) / step).astype(np.uint8), moving=True, low=low, step=step
    )
    return 0.5 * step
