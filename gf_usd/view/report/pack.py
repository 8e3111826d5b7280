"""Packing of arrays into a page: quantized, delta-encoded over time, deflated, base64.

A value of 16 bits is ``low + step * code``.  The codes of a frame are stored as differences to
those of the previous frame, modulo 2^16, all low bytes before all high bytes; this deflates to
about half the size.  The page decodes them (page/data.js).
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

OCTAVES = 2.0  # range of stretches on either side of 1: 1/4 to 4
REACHES = (0.125, 0.25, 0.5, 1.0, OCTAVES)  # [octaves] of the colors, on either side of 1
COVERED = 0.98  # of the area of the bodies, or of the Gaussians, in all frames: within the colors


@dataclass
class Packer:
    """Concatenates arrays to one blob, with a table of their types, shapes and offsets."""

    table: dict[str, dict[str, Any]] = field(default_factory=dict)
    parts: list[bytes] = field(default_factory=list)
    size: int = 0

    def add(self, name: str, values: NDArray[Any], *, moving: bool = False, **about: Any) -> None:
        """Append an array of uint8, int16, uint16 or uint32.

        moving : the first axis is time, along which differences are stored.
        about : more entries of the table.
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
        """The deflated bytes (zlib format) as base64."""
        return base64.b64encode(zlib.compress(b"".join(self.parts), 6)).decode("ascii")


def pack(motion: Motion) -> tuple[dict[str, dict[str, Any]], str]:
    """The array table and the blob of a variant."""
    packer, mesh = Packer(), motion.mesh
    packer.add("corners", mesh.corners.astype(np.uint32))
    packer.add("source", mesh.source.astype(np.uint32))
    packer.add("shade", mesh.shade.astype(np.uint32))
    packer.add("meshColors", mesh.colors)
    add_positions(packer, "points", motion.points)
    codes = encode_stretch(motion.stretch)
    packer.add("stretch", codes, moving=True, reach=color_reach(codes, motion.areas))
    if motion.gaussians is not None:
        colors = np.clip(motion.gaussians.colors[motion.gaussian_indices], 0.0, 1.0)
        # the square root avoids banding of dark colors in 8 bits
        packer.add("gaussianColors", np.round(np.sqrt(colors) * 255.0).astype(np.uint8))
        add_positions(packer, "positions", motion.positions)
        packer.add("turns", np.round(motion.rotations * 127.0).astype(np.int8), moving=True)
        add_scales(packer, motion.scales)
        codes = encode_stretch(motion.ratio)
        reach = color_reach(codes, np.ones(codes.shape[1]))  # their volumes are about the same
        packer.add("ratio", codes, moving=True, reach=reach)
    if motion.flow is not None:
        flow = motion.flow
        packer.add("flowStarts", flow.starts.astype(np.uint32))
        packer.add("flowCorners", flow.corners.astype(np.uint32))
        packer.add("flowColors", flow.colors)
        add_positions(packer, "flowPoints", flow.points, moving=False)
    for name, values in motion.measured.items():
        top = float(np.percentile(values, 99.5)) or 1.0
        code = np.clip(values / top, 0.0, 1.0)
        packer.add(name, np.round(code * 255.0).astype(np.uint8), moving=True, top=top)
    return packer.table, packer.blob()


def encode_stretch(values: Floats) -> NDArray[np.uint8]:
    """Codes 1 to 255 of stretches 1/4 to 4, logarithmic; 128 is a stretch of 1."""
    log = np.log2(np.maximum(values, 1e-9)) / OCTAVES
    return np.round(128.0 + 127.0 * np.clip(log, -1.0, 1.0)).astype(np.uint8)


def color_reach(codes: NDArray[np.uint8], weights: Floats) -> float:
    """[octaves] the least of `REACHES` that holds `COVERED` of codes (F, n) of `encode_stretch`.

    weights : (n,) of each; 0 in all: the least of `REACHES`.
    """
    counts = np.zeros(256)
    for row in codes:
        counts += np.bincount(row, weights, minlength=256)
    away = (np.abs(np.arange(256) - 128) - 0.5) / 127.0 * OCTAVES  # codes are rounded
    total = counts.sum()
    return next(r for r in REACHES if counts[away <= r].sum() >= COVERED * total or r == OCTAVES)


def add_positions(
    packer: Packer, name: str, values: NDArray[np.float32], *, moving: bool = True
) -> None:
    """Add positions (F, n, 3), or (n, 3) if not moving, in 65536 steps over their bounding box."""
    flat = values.reshape(-1, 3)
    low = flat.min(axis=0) if len(flat) else np.zeros(3)
    high = flat.max(axis=0) if len(flat) else np.ones(3)
    step = np.maximum(np.asarray(high - low, dtype=np.float64) / 65535.0, 1e-30)
    code = np.round((values - low) / step).astype(np.uint16)
    packer.add(name, code, moving=moving, low=low.tolist(), step=step.tolist())


def add_scales(packer: Packer, scales: NDArray[np.float32], least: float = 0.0) -> float:
    """Add semi-axes (F, n, 3) [m] as logarithms, in 255 steps from the smallest to the largest.

    least : [m] lower bound of semi-axes; 0: a thousandth of the largest.
    Returns the largest relative rounding error of semi-axes above this bound.
    """
    top = float(scales.max(initial=0.0)) or 1.0
    # thinner ellipsoids look like discs
    log = np.log(np.maximum(scales, least or 1e-3 * top))
    low, high = (float(log.min()), float(log.max())) if log.size else (0.0, 0.0)
    step = (high - low) / 255.0 or 1.0
    packer.add(
        "scales", np.round((log - low) / step).astype(np.uint8), moving=True, low=low, step=step
    )
    return 0.5 * step
