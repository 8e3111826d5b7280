"""docs/reproduction.md from the results of `python -m tools.paper`: no figure is typed by hand.

It has the paper's tables as printed, next to ours.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tools.paper.runs import Series

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
COMMAND = "python -m tools.paper"
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
    """In how many seeds the figure rises along the keys, as text."""
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


Runs = dict[Any, list[Series]]
LAST = 500  # frames at the end of the long run that are searched for a fixed point
STILL = 1e-5  # deviation of the least J: "to five-decimal precision"


def load(kept: Mapping[str, Any]) -> dict[str, Runs]:
    """Series by table and key."""
    return {
        table: {key: [Series(**s) for s in runs] for key, runs in keys.items()}
        for table, keys in kept["tables"].items()
    }


def verdict(holds: bool) -> str:
    return "**holds**" if holds else "**does not hold**"


def orderings(tables: Mapping[str, Runs]) -> list[str]:
    """Which of the paper's orderings hold, over all seeds."""
    one, two = tables["table 1"], {float(k): v for k, v in tables["table 2"].items()}
    return [
        "- " + ordering(one, "spread", ("metal", "rubber", "jelly")),
        "- " + ordering(one, "sigma", ("jelly", "rubber", "metal")),
        "- " + ordering(one, "drift mean", ("metal", "rubber", "jelly")),
        "- alpha, " + ordering(two, "spread", (0.04, 0.02, 0.0)),
        "- alpha, " + ordering(two, "spread", (0.02, 0.0)),
    ]


def table_3(tables: Mapping[str, Runs]) -> str:
    """TL and UL, the paper's figures against ours."""
    tl, ul = ([long_run(s) for s in tables["table 3"][key] if not s.failed] for key in ("tl", "ul"))
    rows = []
    for name, printed in TABLE_3.items():
        ours = [spread_of([r[name] for r in runs], 3) if runs else "none" for runs in (tl, ul)]
        rows.append([name, f"{printed[0]:g}", ours[0], f"{printed[1]:g}", ours[1]])
    return markdown(("", "paper TL", "ours TL", "paper UL", "ours UL"), rows)


def fixed_points(tables: Mapping[str, Runs]) -> list[str]:
    """Whether the least J becomes constant, seed by seed."""
    out = []
    for key, name in (("tl", "TL"), ("ul", "UL")):
        runs = [s for s in tables["table 3"][key] if not s.failed]
        found = [fixed_point(s, min(LAST, len(s.min_J) // 2)) for s in runs]
        still = sum(f["deviation"] < STILL for f in found)
        low, high = (f([x["deviation"] for x in found]) for f in (min, max))
        out.append(
            f"- {name}: the least J is constant to {STILL:g} in {still} of {len(found)} seeds over"
            f" the last {LAST} frames; its deviation there is {low:.2g} to {high:.2g}, its mean"
            f" {spread_of([f['mean'] for f in found])}."
        )
    return out


def drift_lines(tables: Mapping[str, Runs]) -> list[str]:
    """What the drift does over the long run."""
    out = []
    for key, name in (("tl", "TL"), ("ul", "UL")):
        runs = [s for s in tables["table 3"][key] if not s.failed]
        ends = [s.drift_mean[-1] / s.drift_mean[0] for s in runs]
        out.append(f"{name} ends at {spread_of(ends, 2)} times its drift at rest")
    return ["; ".join(out) + "."]


def speeds(tables: Mapping[str, Runs]) -> str:
    """Milliseconds per frame of every preset."""
    rows = [
        [look, MILLISECONDS, spread_of([s.milliseconds for s in runs], 2)]
        for look, runs in tables["table 1"].items()
    ]
    rows.append(["rubber, UL", "", spread_of(
        [s.milliseconds for s in tables["table 3"]["ul"]], 2)])  # fmt: skip
    return markdown(("", "paper, RTX 4070 [ms]", "ours, one CPU core [ms]"), rows)


def laws(tables: Mapping[str, Runs]) -> str:
    """Neo-Hookean against corotated from the identical particles."""
    rows = []
    for look, runs in tables["neo-Hookean"].items():
        for column in ("spread", "sigma"):
            rows.append(
                [
                    look,
                    column,
                    spread_of([s.at_peak()[column] for s in tables["table 1"][look]]),
                    spread_of([s.at_peak()[column] for s in runs]),
                ]
            )
        least = [[min(s.min_J) for s in t] for t in (tables["table 1"][look], runs)]
        rows.append([look, "least J of all frames", *(spread_of(v) for v in least)])
    return markdown(("", "", "corotated", "Neo-Hookean"), rows)


def trouble(tables: Mapping[str, Runs]) -> list[str]:
    """Runs that ended early, and how often frames were recomputed."""
    out = []
    for table, keys in tables.items():
        for key, runs in keys.items():
            ended = [s for s in runs if s.failed]
            redone = int(np.sum([s.rollbacks for s in runs]))
            if ended:
                out.append(
                    f"- {table}, {key}: {len(ended)} of {len(runs)} seeds ended early, the first at"
                    f" {ended[0].failed.split(',')[0]}."
                )
            elif redone:
                out.append(
                    f"- {table}, {key}: frames were recomputed {redone} times with half a step."
                )
    return out or ["- None."]


def rest_drift(tables: Mapping[str, Runs]) -> str:
    """Mean drift at rest over the seeds."""
    return spread_of([s.drift_mean[0] for s in tables["table 1"]["rubber"]])


def page(kept: Mapping[str, Any], folder: Path) -> str:
    """The page, as Markdown."""
    tables, about = load(kept), kept["about"]
    template = (Path(__file__).with_name("words.md")).read_text()
    alphas = {float(k): v for k, v in tables["table 2"].items()}
    head = ("", "", "paper", "ours, `--preset paper`")
    figures = {
        "about": f"Made by `{COMMAND}` with seeds {about['seeds'][0]} to"
        f" {about['seeds'][-1]}, commit {about['commit']}, {about['date']}.",
        "rest": f"paper {REST_DRIFT:g} m, ours {rest_drift(tables)} m",
        "table1": markdown(
            (*head, "our own settings"), peak_rows(TABLE_1, tables["table 1"], tables["production"])
        ),
        "no_options": markdown(
            (*head, "the same without WLS, Procrustes, clamp and cap"),
            peak_rows(TABLE_1, tables["table 1"], tables["no options"]),
        ),
        "table2": markdown(head, peak_rows(TABLE_2, alphas)),
        "orderings": "\n".join(orderings(tables)),
        "table3": table_3(tables),
        "fixed": "\n".join(fixed_points(tables)),
        "drifts": "\n".join(drift_lines(tables)),
        "speeds": speeds(tables),
        "laws": laws(tables),
        "trouble": "\n".join(trouble(tables)),
        "deformed": spread_of([s.at_peak()["drift mean"] for s in tables["deformed"]["rubber"]]),
    }
    for name, text in figures.items():
        template = template.replace("{{" + name + "}}", text)
    return template
