"""What of a bake is written, and in which form: output choices as resolved."""

from __future__ import annotations

from dataclasses import dataclass

from gf_usd.errors import UsageError

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
    clip_frames: int = 0  # frames of a value clip; 0: the cache is one file
    flat: bool = False  # one file instead of layers

    @property
    def mesh(self) -> bool:
        """Whether the meshes move."""
        return "mesh" in self.shapes

    @property
    def particles(self) -> bool:
        """Whether any form of the particles is written."""
        return "gaussians" in self.shapes or "points" in self.shapes


def parse_only(text: str | None) -> tuple[str, ...]:
    """The shapes of "mesh" or "gaussians,points", in the order of SHAPES; None: all of them.

    Raises UsageError for words that are none of them.
    """
    if text is None:
        return SHAPES
    words = [word.strip() for word in text.split(",")]
    for word in words:
        if word not in SHAPES:
            raise UsageError(
                f"--only {text}: there is no {word!r}",
                f"give one or more of {', '.join(SHAPES)}, with commas between",
            )
    return tuple(shape for shape in SHAPES if shape in words)


def clip_length(asked: int | None, frame_bytes: float, frames: int) -> int:
    """Frames of a clip: as asked, or by the size of the cache; 0: one file.

    frame_bytes : of one frame with all its samples; frames : how many are written.
    """
    if asked is not None:
        return asked
    if frame_bytes * frames <= LARGE:
        return 0
    return max(1, int(CLIP / frame_bytes))
