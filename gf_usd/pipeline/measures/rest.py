"""Detects when all bodies are at rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from gf_usd.core.errors import BakeError, counted
from gf_usd.core.frames.frame import AT_REST, Health
from gf_usd.core.materials.dimensionless import G0, time_scale


class Rest:
    """Detects that all bodies have been at rest for a time T, and for two frames; see `AT_REST`.

    A single frame is not sufficient: a body is at rest in the first frame before it falls, and a
    bouncing one at its highest point.

    frame_time : [s] between frames; radius : [m] of a ball of the bodies' volume; moving_frames :
        frames at the start in which an obstacle moves, or may move again. Bodies that have fallen
        past every obstacle do not count.
    """

    def __init__(self, frame_time: float, radius: float, moving_frames: int = 0) -> None:
        self._step, self._radius, self._moving_frames = frame_time, radius, moving_frames
        self.still = 0.0  # [s] for which all bodies have been at rest

    def limit(self, health: Health) -> float:
        """[J] of kinetic energy that counts as rest."""
        return AT_REST * health.mass * G0 * self._radius

    def reached(self, health: Health, index: int) -> bool:
        """Whether this frame, the next one of the motion, completes a time T at rest."""
        still = index >= self._moving_frames and _moving(health) <= self.limit(health)
        before, self.still = self.still, self.still + self._step if still else 0.0
        return before > 0.0 and self.still >= time_scale(self._radius)

    def message(
        self,
        variant: str,
        frames: Sequence[Health],
        most: int,
        *,
        settled: bool,
        summary: Mapping[str, Any],
    ) -> str:
        """Text on when a material came to rest.

        most : maximum number of frames; summary : the totals of the frames.
        """
        if settled:
            rested = at_rest(len(frames), summary)
            return f"{variant}: {rested or _all_fell(len(frames), summary)}"
        return (
            f"{variant}: not at rest within {counted(most, 'frame')}: {self._reason(frames[-1])};"
            f" --frames rest:{2 * most} simulates longer"
        )

    def refusal(self, variant: str, last: Health, most: int, path: Path) -> BakeError:
        """The error of --settle-only where a body still moves in the last of `most` frames."""
        return BakeError(
            f"{path}, {variant}: not at rest within {counted(most, 'frame')}: {self._reason(last)}",
            f"simulate longer with --frames {2 * most}, or slow the motion with --drag, "
            f"--friction or another material; a body that is driven by a moving pin or "
            f"obstacle, or drifts without gravity, never comes to rest",
        )

    def _reason(self, last: Health) -> str:
        """Why the last frame does not end a time at rest."""
        if _moving(last) > self.limit(last):
            return (
                f"the kinetic energy of the last one is {_moving(last):.3g} J, but at most"
                f" {self.limit(last):.3g} J counts as rest"
            )
        if self.still == 0.0:
            return "an obstacle moves until the last one"
        return (
            f"at the end the bodies have been at rest for {self.still:.3g} s, but"
            f" {time_scale(self._radius):.3g} s are needed"
        )


def at_rest(frame: int, summary: Mapping[str, Any]) -> str:
    """Text on the frame, from 1, at which all bodies rest that have not fallen past every
    obstacle; "" where none is left.

    summary : the totals of the frames.
    """
    fallen = summary.get("fallen_bodies", 0)
    if not fallen:
        return f"at rest at frame {frame}"
    if fallen == summary["fallen_of"]:
        return ""
    return (
        f"at rest at frame {frame} (without {fallen} of {summary['fallen_of']} bodies, which fell)"
    )


def _all_fell(frame: int, summary: Mapping[str, Any]) -> str:
    count = summary["fallen_of"]
    who = "the body has" if count == 1 else f"all {count} bodies have"
    return f"ends at frame {frame}: {who} fallen past every obstacle"


def _moving(health: Health) -> float:
    """[J] kinetic energy without that of bodies that fell past every obstacle."""
    return health.kinetic - (health.fallen_kinetic or 0.0)
