"""Curves as a picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from gf_usd.view.curve_picture import COLORS, HEIGHT, WIDTH, Curve, Panel, Rows, write_panels


def colors(path: Path) -> set[tuple[int, int, int]]:
    with Image.open(path) as image:
        return set(map(tuple, np.asarray(image.convert("RGB")).reshape(-1, 3).tolist()))


def test_each_kind_of_curve_has_its_color(tmp_path: Path) -> None:
    t = np.linspace(0.0, 2.0, 40)
    fit, start = Curve(kind="fit", x=t, y=np.sin(t)), Curve(kind="start", x=t, y=np.cos(t))
    hidden = np.where(t > 1.0, np.nan, np.sin(t))
    dots = Curve(kind="target", x=t, y=hidden, dots=True)
    path = write_panels(tmp_path / "a.png", [Panel(title="x", unit="m", curves=[fit, start, dots])])
    with Image.open(path) as image:
        assert image.size == (WIDTH, HEIGHT)
    assert set(COLORS.values()) <= colors(path)
    without = write_panels(tmp_path / "b.png", [Panel(title="x", unit="m", curves=[fit])])
    assert COLORS["start"] not in colors(without)


def test_a_curve_that_is_constant_and_numbers_are_drawn(tmp_path: Path) -> None:
    flat = Curve(kind="fit", x=np.array([0.0, 1.0]), y=np.zeros(2))
    rows = Rows(title="numbers", rows=[("rebound", 1.0, np.nan, 0.4)], texts=["0.6, fitted 0.61"])
    path = write_panels(tmp_path / "a.png", [Panel(title="rest", unit="m", curves=[flat]), rows])
    assert {COLORS["fit"], COLORS["target"]} <= colors(path)
