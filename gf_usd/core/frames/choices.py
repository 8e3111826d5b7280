"""What a bake writes, and in which form."""

from __future__ import annotations

from dataclasses import dataclass

from gf_usd.core.units import Precision

SHAPES = ("mesh", "gaussians", "points")


# Caches above LARGE bytes are split into value clips of about CLIP bytes unasked: a file of tens of
# gigabytes can neither be copied in parts nor resumed.
LARGE = 2_000_000_000


CLIP = 500_000_000


@dataclass(frozen=True, kw_only=True)
class Choices:
    """Output choices of a bake, resolved."""

    shapes: tuple[str, ...] = SHAPES  # of SHAPES, in that order: what the cache holds
    half: bool = False  # half precision where the schema has it and it is safe
    precision: Precision | None = None  # tolerance of stored values; None: single precision
    adaptive: bool = False  # samples are left out where that is within `precision`
    velocities: bool = True  # they are written
    clip_frames: int = 0  # frames of a value clip; 0: the cache is one file
    flat: bool = False  # one file instead of layers
    settled: bool = False  # one pose, that at rest, without time samples
    tets: bool = False  # tetrahedra of each body
    until_rest: bool = False  # the last frame is the first at rest
    open_end: bool = False  # because no option states the length
    certify: bool = False  # the figures are to have intervals
    flows: tuple[int, ...] = ()  # bodies of which the surface of what flows is written
    flowing: tuple[str, ...] = ()  # meshes replaced by surfaces or particles of flowing bodies
    # the same, and the body of each: once the first particle of that is converted
    converting: tuple[tuple[str, int], ...] = ()

    @property
    def mesh(self) -> bool:
        """Whether the meshes move."""
        return "mesh" in self.shapes

    def drawn(self, path: str) -> bool:
        """Whether the mesh at a prim path moves."""
        return self.mesh and path not in self.flowing

    @property
    def replaced(self) -> tuple[str, ...]:
        """Meshes that surfaces or particles of flowing bodies replace, from the start or later."""
        return (*self.flowing, *(path for path, _ in self.converting))

    @property
    def particles(self) -> bool:
        """Whether any form of the particles is written, or tetrahedra, or flowing particles in
        addition to meshes.
        """
        both = bool({"gaussians", "points"} & set(self.shapes))
        return both or self.tets or bool(self.flowing or self.converting or self.flows)


def clip_length(requested: int | None, frame_bytes: float, frames: int) -> int:
    """Frames of a clip: as requested, or by the size of the cache; 0: one file.

    frame_bytes : of one frame with all its samples; frames : how many are written.
    """
    if requested is not None:
        return requested
    if frame_bytes * frames <= LARGE:
        return 0
    return max(1, int(CLIP / frame_bytes))


SOURCE_VARIANT = "none"  # taken: usd.variants calls the asset without a bake so
