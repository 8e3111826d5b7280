"""A motion made by hand, as a reader of a bake would hand it out: no USD, no solver."""

from __future__ import annotations

import base64
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gf_usd.core.scene import GaussianSet, MotionFrame, Recording, RenderMesh

SIDE = 0.2  # [m] of the box
DROP = 0.5  # [m] that it starts above the floor
BOX = np.array([(x, y, z) for x in (-1, 1) for y in (0, 2) for z in (-1, 1)]) * (SIDE / 2)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])


def squash(frame: int) -> tuple[float, float]:
    """Height of the lowest point [m] and stretch along up: a fall, a squash, and a rebound."""
    return [(DROP, 1.0), (0.3, 1.0), (0.0, 0.8), (0.0, 0.5), (0.0, 0.9), (0.1, 1.1), (0.0, 1.0)][
        frame
    ]


FRAMES = 7


class FallingBox:
    """A box with Gaussians inside that falls on a floor at height 0."""

    def __init__(
        self,
        name: str = "Box",
        variant: str = "rubber",
        about: Mapping[str, Any] | None = None,
        gaussians: int = 40,
        notes: tuple[str, ...] = (),
        flows: bool = False,
    ) -> None:
        self._flows = flows  # the bake wrote elastic and plastic strain
        self._inside = np.random.default_rng(3).uniform(-0.9, 0.9, (gaussians, 3)) * SIDE / 2
        self._inside[:, 1] += SIDE / 2
        self._recording = Recording(
            path=Path("box.rubber.usda"),
            name=name,
            variant=variant,
            up=(0.0, 1.0, 0.0),
            ground=0.0,
            unit=1.0,
            time_codes=tuple(float(t) for t in range(1, FRAMES + 1)),
            time_codes_per_second=24.0,
            meshes=(
                RenderMesh(
                    name="/Box",
                    points=self.points(0),
                    triangles=TRIANGLES,
                    colors=np.broadcast_to((0.8, 0.2, 0.1), (12, 3, 3)),
                    roughness=np.array(0.5),
                    metallic=np.array(0.0),
                ),
            ),
            baked=(True,),
            gaussians=GaussianSet(
                name="/Box/Gaussians",
                colors=np.full((gaussians, 3), 0.4),
                opacities=np.ones(gaussians),
                rest_scales=np.full((gaussians, 3), 0.01),
                masses=np.full(gaussians, 1.0),
            )
            if gaussians
            else None,
            about=about or {},
            notes=notes,
        )

    def points(self, frame: int) -> np.ndarray:
        """(8, 3) [m] corners of the box."""
        low, stretch = squash(frame)
        return BOX * (1.0, stretch, 1.0) + (0.0, low, 0.0)

    def recording(self) -> Recording:
        return self._recording

    def frames(self, time_codes: Sequence[float]) -> Iterator[MotionFrame]:
        for code in time_codes:
            low, stretch = squash(int(code) - 1)
            cloud = len(self._inside) > 0
            yield MotionFrame(
                time_code=code,
                meshes=(self.points(int(code) - 1),),
                positions=self._inside * (1.0, stretch, 1.0) + (0.0, low, 0.0) if cloud else None,
                axes=np.tile(np.diag([0.01, 0.01 * stretch, 0.01]), (len(self._inside), 1, 1))
                if cloud
                else None,
                measured=self._measured(stretch) if self._flows else {},
            )

    def _measured(self, stretch: float) -> dict[str, np.ndarray]:
        """Elastic strain that is even, and plastic strain that grows from one to the next."""
        rise = np.linspace(0.0, 1.0 - stretch, len(self._inside))
        return {"elastic": np.full(len(rise), 0.5 * (1.0 - stretch)), "plastic": rise}


class MeltingBox(FallingBox):
    """The same motion as a surface whose faces change: every other frame has one of them less."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        (self._shape,) = self._recording.meshes
        self._recording = replace(self._recording, meshes=(), baked=(), flows=("/Box/Surface",))

    def frames(self, time_codes: Sequence[float]) -> Iterator[MotionFrame]:
        for frame in super().frames(time_codes):
            (points,) = frame.meshes
            left = len(TRIANGLES) - int(frame.time_code) % 2
            mesh = replace(
                self._shape,
                points=points,
                triangles=TRIANGLES[:left],
                colors=np.asarray(self._shape.colors)[:left],
            )
            yield replace(frame, meshes=(), flows=(mesh,))


def health(frame: int) -> dict[str, Any]:
    """The health of a frame of the box, as a solver could measure it."""
    low, stretch = squash(frame)
    return {
        "kinetic": 1.0 * frame, "elastic": 0.5, "potential": 2.0 * low, "contact": 0.0,
        "center": [0.0, low + stretch * SIDE / 2, 0.0], "min_J": stretch, "max_J": 1.0,
        "min_stretch": stretch, "max_stretch": 1.1, "penetration": 0.001 if low == 0.0 else 0.0,
    }  # fmt: skip


def report_of(look: str = "rubber", **more: Any) -> dict[str, Any]:
    """A report as ``gf-usd bake`` writes it, of the box."""
    return {
        "command": "gf-usd bake box.usda --material rubber",
        "version": "1.2.3",
        "input_sha256": "abc",
        "source": "/somewhere/box.usda",
        "particles": 40,
        "settings": {"frames": FRAMES, "fps": 24.0, "gravity": [0.0, -9.81, 0.0]},
        "notes": ["a note of the bake"],
        "check": [],
        "bakes": [
            {
                "variant": look,
                "material": {"name": look, "law": "corotated", "density": 1100.0},
                "health": {"min_J": 0.5, "inverted_particle_frames": 0, "rollbacks": 0},
                "per_frame": [health(i) for i in range(FRAMES)],
            }
        ],
        **more,
    }


def unpack(table: dict[str, Any], blob: str, name: str) -> np.ndarray:
    """An array of a page as data.js unpacks it: byte planes, then sums over time that wrap."""
    entry = table[name]
    dtype = np.dtype(entry["type"])
    count = int(np.prod(entry["shape"]))
    raw = zlib.decompress(base64.b64decode(blob))
    planes = np.frombuffer(raw, np.uint8, count * dtype.itemsize, entry["offset"])
    values = planes.reshape(dtype.itemsize, count).T.copy().view(dtype).reshape(entry["shape"])
    return np.cumsum(values, axis=0, dtype=dtype) if entry["moving"] else values
