"""Gaussians that move, as a reader of a bake would hand them out: no USD, no solver."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from gf_usd.core.radiance import srgb_to_linear
from gf_usd.core.scene import Harmonics, RenderSplats

Y_0 = 0.28209479177387814


class Splats:
    """A set that turns by a right angle about the up axis from its first frame to its last.

    Parameters
    ----------
    positions : (n, 3) [m].  scales : (n, 3) [m].  colors : (n, 3) sRGB.
    light : (n, K, 3) coefficients above degree 0.
    """

    def __init__(
        self,
        positions: Sequence[Sequence[float]],
        scales: Sequence[Sequence[float]],
        colors: Sequence[Sequence[float]],
        *,
        opacities: Sequence[float] | None = None,
        light: np.ndarray | None = None,
        up: tuple[float, float, float] = (0.0, 1.0, 0.0),
        frames: int = 5,
        name: str = "Set",
        variant: str = "rubber",
    ) -> None:
        self.positions, self.scales = np.array(positions, float), np.array(scales, float)
        self.colors = np.array(colors, float)
        self.opacities = np.ones(len(colors)) if opacities is None else np.array(opacities)
        self.light, self.up, self.name, self.variant = light, up, name, variant
        self.rate, self.notes = 24.0, ("a <b>note</b>",)
        self.time_codes = tuple(float(code) for code in range(1, frames + 1))

    def rotation(self, frame: int) -> np.ndarray:
        """(3, 3) of a frame."""
        angle = 0.5 * np.pi * frame / max(1, len(self.time_codes) - 1)
        return Rotation.from_rotvec(angle * np.array(self.up)).as_matrix()

    def frames(self, time_codes: Sequence[float]) -> Iterator[tuple[RenderSplats, ...]]:
        for code in time_codes:
            R = self.rotation(self.time_codes.index(code))
            harmonics = None
            if self.light is not None:
                h = np.concatenate([((self.colors - 0.5) / Y_0)[:, None], self.light], axis=1)
                harmonics = Harmonics(coefficients=h, frame=np.eye(3), srgb=True)
            yield (
                RenderSplats(
                    name="/Set/Splats",
                    positions=self.positions @ R.T,
                    axes=R * self.scales[:, None, :],
                    colors=srgb_to_linear(self.colors),
                    opacities=self.opacities,
                    harmonics=harmonics,
                ),
            )


def shell(count: int, frames: int = 5) -> Splats:
    """A ball of opaque discs."""
    rng = np.random.default_rng(0)
    at = rng.normal(size=(count, 3))
    at /= np.linalg.norm(at, axis=1, keepdims=True)
    return Splats(at, np.full((count, 3), 0.05), rng.uniform(0.0, 1.0, (count, 3)), frames=frames)
