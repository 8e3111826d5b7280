"""Small plots of curves as SVG text: points joined by lines, two axes, a target."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any
from xml.sax.saxutils import escape

WIDTH, HEIGHT = 420, 260
LEFT, RIGHT, TOP, BOTTOM = 82, 16, 34, 46  # [px] around the axes
INK, LINE, TARGET = "#444", "#2266aa", "#bb5522"
MARGIN = 0.08  # of the span, beyond the outermost points
LABEL = 12.0  # [px] between two labels of the vertical axis, at least: the height of a line


class Axis:
    """From values to pixels, straight or by logarithms."""

    def __init__(self, values: Sequence[float], start: float, end: float, logarithmic: bool):
        self.log = logarithmic
        low, high = min(map(self.scale, values)), max(map(self.scale, values))
        pad = MARGIN * (high - low) or 0.5
        self.low, self.high, self.start, self.end = low - pad, high + pad, start, end

    def scale(self, value: float) -> float:
        return math.log10(value) if self.log else value

    def __call__(self, value: float) -> float:
        share = (self.scale(value) - self.low) / (self.high - self.low)
        return self.start + share * (self.end - self.start)


def ticks(axis: Axis, values: Sequence[float]) -> list[float]:
    """Where an axis has marks: at the values on a logarithmic one, else at round numbers."""
    if axis.log:
        return list(values)
    span = axis.high - axis.low
    step = 10.0 ** math.floor(math.log10(span / 5.0))
    step *= next(m for m in (1, 2, 5, 10) if span / (m * step) <= 5.0)
    first, last = math.ceil(axis.low / step), math.floor(axis.high / step)
    return [k * step for k in range(first, last + 1)]


def text(x: float, y: float, content: str, anchor: str = "middle", more: str = "") -> str:
    """A line of text."""
    return (
        f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{INK}" {more}>'
        f"{escape(content)}</text>"
    )


def svg(curve: dict[str, Any]) -> str:
    """A curve of `gf-usd verify --json` as an SVG file.

    curve : title, x_label, y_label, x, y, logarithmic, target.
    """
    xs, ys, level = curve["x"], curve["y"], curve["target"]
    log = curve["logarithmic"]
    across = Axis(xs, LEFT, WIDTH - RIGHT, log)
    upward = Axis([*ys, *([] if level is None else [level])], HEIGHT - BOTTOM, TOP, log)
    floor, left, right = HEIGHT - BOTTOM, LEFT, WIDTH - RIGHT
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}"'
        f' height="{HEIGHT}" font-family="sans-serif" font-size="11">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
        text(WIDTH / 2, 18, curve["title"], more='font-size="13"'),
        text((left + right) / 2, HEIGHT - 8, curve["x_label"]),
        text(14, (TOP + floor) / 2, curve["y_label"],
             more=f'transform="rotate(-90 14 {(TOP + floor) / 2:.1f})"'),
        f'<path d="M{left} {TOP}V{floor}H{right}" fill="none" stroke="{INK}"/>',
    ]  # fmt: skip
    for value in ticks(across, xs):
        x = across(value)
        out.append(f'<path d="M{x:.1f} {floor}v4" stroke="{INK}"/>')
        # three digits, but numbers of particles, such as 1500, whole
        digits = 12 if not log else 3 if value < 1000.0 else 6
        out.append(text(x, floor + 16, f"{value:.{digits}g}"))
    labels: list[float] = []  # [px]
    for value in sorted(ticks(upward, ys)):
        y = upward(value)
        out.append(f'<path d="M{left} {y:.1f}h-4" stroke="{INK}"/>')
        # on a logarithmic axis, marks may be closer than a line of text is high
        if not labels or labels[-1] - y >= LABEL:
            labels.append(y)
            out.append(text(left - 7, y + 4, f"{value:.6g}" if not log else f"{value:.2g}", "end"))
    if level is not None:
        y = upward(level)
        out.append(f'<path d="M{left} {y:.1f}H{right}" stroke="{TARGET}" stroke-dasharray="5 4"/>')
        out.append(text(right, y - 5, "target", "end"))
    points = [(across(x), upward(y)) for x, y in zip(xs, ys)]
    way = "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
    out.append(f'<path d="M{way}" fill="none" stroke="{LINE}" stroke-width="1.5"/>')
    out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3" fill="{LINE}"/>' for x, y in points]
    return "\n".join([*out, "</svg>", ""])
