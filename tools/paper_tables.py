"""The paper's tables beside ours: what it printed, and how ours are put beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

# GaussianFlesh, Tables 1 to 3 and section 4, as printed.
COLUMNS = ("drift mean", "drift max", "spread", "sigma", "clamped")
TABLE_1 = {
    "rubber": dict(zip(COLUMNS, (0.083, 0.202, 0.611, 0.854, 0))),
    "metal": dict(zip(COLUMNS, (0.080, 0.191, 0.349, 0.948, 0))),
    "jelly": dict(zip(COLUMNS, (0.108, 0.274, 1.482, 0.568, 6))),
}
TABLE_2 = {
    0.00: {"drift mean": 0.070, "drift max": 0.215, "spread": 1.978},
    0.02: {"drift mean": 0.083, "drift max": 0.202, "spread": 0.611},
    0.04: {"drift mean": 0.082, "drift max": 0.194, "spread": 0.566},
}
TABLE_3 = {
    "drift mean, last frame": (0.0824, 0.0925),
    "drift max, worst frame": (0.206, 0.229),
    "drift mean, average": (0.0807, 0.0810),
    "least J, mean": (0.80, 0.96),
    "spread, mean": (0.17, 0.07),
}
REST_DRIFT = 0.079
MILLISECONDS = "42 to 72"
DIGITS = {"clamped": 1}


def spread_of(values: Sequence[float], digits: int = 3) -> str:
    """Mean and standard deviation over seeds: .083 +- .006."""
    v = np.asarray(values, float)
    if not np.isfinite(v).all():
        return "diverges"
    return f"{v.mean():.{digits}f} ± {v.std(ddof=1) if len(v) > 1 else 0.0:.{digits}f}"


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table."""
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])


def peak_rows(
    printed: Mapping[Any, Mapping[str, float]],
    ours: Mapping[Any, Sequence[Any]],
    production: Mapping[Any, Sequence[Any]] | None = None,
) -> list[list[str]]:
    """Rows of Tables 1 and 2: the paper's figure, ours over the seeds, our own settings."""
    rows = []
    for key, columns in printed.items():
        if production is not None and key not in production:
            continue
        for column, value in columns.items():
            digits = DIGITS.get(column, 3)
            row = [str(key), column, f"{value:g}"]
            row.append(spread_of([s.at_peak()[column] for s in ours[key]], digits))
            if production is not None:
                row.append(spread_of([s.at_peak()[column] for s in production[key]], digits))
            rows.append(row)
    return rows


def ordering(ours: Mapping[Any, Sequence[Any]], column: str, keys: Sequence[Any]) -> str:
    """In how many seeds the figure rises along the keys, in words."""
    values = np.array([[s.at_peak()[column] for s in ours[k]] for k in keys])
    holds = np.atleast_1d((np.diff(values, axis=0) > 0.0).all(axis=0))
    chain = " < ".join(str(k) for k in keys)
    return f"{chain} in {column}: {int(holds.sum())} of {len(holds)} seeds"


def long_run(series: Any) -> dict[str, float]:
    """The rows of Table 3 for one run."""
    return {
        "drift mean, last frame": series.drift_mean[-1],
        "drift max, worst frame": max(series.drift_max),
        "drift mean, average": float(np.mean(series.drift_mean)),
        "least J, mean": float(np.mean(series.min_J)),
        "spread, mean": float(np.mean(series.spread)),
    }


def fixed_point(series: Any, last: int) -> dict[str, float]:
    """How still the least J is over the last frames: its mean, deviation and slope a frame."""
    J = np.asarray(series.min_J[-last:])
    slope = float(np.polyfit(np.arange(len(J)), J, 1)[0])
    return {"mean": float(J.mean()), "deviation": float(J.std()), "slope a frame": slope}
