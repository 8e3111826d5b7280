"""The paper's figures from our own runs: pictures of bakes, and curves as SVG."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from PIL import Image

from tools.acceptance.plot import BOTTOM, INK, LEFT, RIGHT, TOP, Axis, text, ticks

COLORS = ("#c0392b", "#2266aa", "#2e8b57", "#8e5bb5")
WIDTH, HEIGHT = 720, 260
POINTS = 600  # of a curve: more are not seen
LEGEND = 150  # [px] between the names of two curves


def curves(
    title: str, x_label: str, y_label: str, lines: Mapping[str, Sequence[float]], level: float
) -> str:
    """Several curves over frames, and a dashed level, as an SVG file."""
    values = [v for line in lines.values() for v in line]
    longest = max(len(line) for line in lines.values())
    across = Axis([0.0, float(longest - 1)], LEFT, WIDTH - RIGHT, False)
    upward = Axis([*values, level], HEIGHT - BOTTOM, TOP, False)
    floor, right = HEIGHT - BOTTOM, WIDTH - RIGHT
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" width="{WIDTH}"'
        f' height="{HEIGHT}" font-family="sans-serif" font-size="11">',
        f'<rect width="{WIDTH}" height="{HEIGHT}" fill="white"/>',
        text(WIDTH / 2, 18, title, more='font-size="13"'),
        text((LEFT + right) / 2, HEIGHT - 8, x_label),
        text(14, (TOP + floor) / 2, y_label,
             more=f'transform="rotate(-90 14 {(TOP + floor) / 2:.1f})"'),
        f'<path d="M{LEFT} {TOP}V{floor}H{right}" fill="none" stroke="{INK}"/>',
        f'<path d="M{LEFT} {upward(level):.1f}H{right}" stroke="{INK}" stroke-dasharray="4 4"/>',
    ]  # fmt: skip
    for value in ticks(across, list(range(longest))):
        out.append(text(across(value), floor + 16, f"{value:g}"))
    for value in ticks(upward, sorted(set(values))):
        out.append(text(LEFT - 7, upward(value) + 4, f"{value:.3g}", "end"))
    for number, (name, line) in enumerate(lines.items()):
        step = max(1, len(line) // POINTS)
        # the last value stays, whatever the step
        at = sorted({*range(0, len(line), step), len(line) - 1})
        path = " ".join(f"{across(k):.1f},{upward(line[k]):.1f}" for k in at)
        color = COLORS[number % len(COLORS)]
        out.append(f'<polyline points="{path}" fill="none" stroke="{color}"/>')
        more = f'fill="{color}" font-weight="bold"'
        # above the axes, where no curve runs
        out.append(text(LEFT + 8 + LEGEND * number, TOP - 4, name, "start").replace(
            f'fill="{INK}"', more))  # fmt: skip
    return "\n".join([*out, "</svg>"]) + "\n"


def gf_usd(*arguments: object) -> str:
    """Run the command line of this environment; what it printed."""
    done = subprocess.run(
        [sys.executable, "-m", "gf_usd", *map(str, arguments)], check=True, capture_output=True,
        text=True,
    )  # fmt: skip
    return done.stdout


def peak_picture(
    asset: Path, material: str, folder: Path, *, show: str = "mesh", seed: int = 0,
    preset: str | None = "paper", size: str = "960x840",
) -> Image.Image:  # fmt: skip
    """A bake at its hardest squash: the frame whose body is lowest in the first bounce."""
    root = folder / f"{asset.stem}.{material}.usda"
    if not root.exists():
        arguments = ["--preset", preset] if preset else []
        gf_usd("bake", asset, "--material", material, "--seed", seed, "--overwrite", "--quiet",
               "-o", root, *arguments)  # fmt: skip
    report = json.loads(root.with_name(f"{root.stem}.report.json").read_text())
    frames = report["bakes"][0]["per_frame"]
    stored = [f["elastic"] for f in frames]
    first = next(i for i, f in enumerate(frames) if f["penetration"] > 0.0)
    window = stored[first : first + max(12, len(frames) // 8)]
    peak = first + int(np.argmax(window))
    code = report["start"] + peak
    out = folder / f"{root.stem}.{show}.png"
    gf_usd("preview", root, "--frame", code, "--show", show, "--size", size, "-o", out)
    # the camera is fitted to the whole fall: the squash is in the lower middle of the picture
    w, h = (int(v) for v in size.split("x"))
    picture = Image.open(out).convert("RGB").crop((w // 6, 2 * h // 5, 5 * w // 6, h))
    return picture.resize(
        (picture.width * 3 // 4, picture.height * 3 // 4), Image.Resampling.LANCZOS
    )


def side_by_side(pictures: Sequence[Image.Image], path: Path) -> None:
    """Pictures of one height in a row, as a JPEG."""
    width = sum(p.width for p in pictures)
    row = Image.new("RGB", (width, pictures[0].height))
    x = 0
    for picture in pictures:
        row.paste(picture, (x, 0))
        x += picture.width
    path.parent.mkdir(parents=True, exist_ok=True)
    row.save(path, quality=90, optimize=True)
