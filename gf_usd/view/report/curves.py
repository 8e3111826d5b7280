"""The plots of a report: values over playback time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gf_usd.view.compare import Comparison
from gf_usd.view.report.motion import Motion
from gf_usd.view.report.record import Record, finite

Curve = dict[str, Any]
Plot = dict[str, Any]

LENGTHS = ((1.0, "m"), (1e-2, "cm"), (1e-3, "mm"), (1e-6, "µm"))
ENERGIES = ((1e6, "MJ"), (1e3, "kJ"), (1.0, "J"), (1e-3, "mJ"), (1e-6, "µJ"), (1e-9, "nJ"))


def plots(motion: Motion, record: Record) -> list[Plot]:
    """Every plot that there is data for; each has a title, a unit and curves with x [s] and y."""
    made = [
        _height(motion, record),
        _stretch(motion, record),
        _volume(motion, record),
        _energy(motion, record),
        _contact(motion, record),
        *_drift(motion, record),
    ]
    return [plot for plot in made if plot["curves"]]


def comparison_plots(found: Comparison, names: tuple[str, str]) -> list[Plot]:
    """How far two motions are apart over time; names : of the two."""
    x = found.seconds.tolist()
    distance = _plot(
        "Distance",
        "between the same points in the two files",
        [
            {"name": "largest", "x": [*x], "y": found.largest.tolist()},
            {"name": "rms", "x": [*x], "y": found.rms.tolist()},
            {"name": "centers of mass", "x": [*x], "y": found.center.tolist()},
        ],
        LENGTHS,
    )
    factor = distance.pop("factor")
    if found.tolerance is not None:
        distance["line"], distance["line_name"] = found.tolerance / factor, "tolerance"
    first = found.volumes[0, 0] or 1.0
    volume = _plot(
        "Volume",
        f"relative to that of {names[0]} in the first frame",
        [
            {"name": name, "x": [*x], "y": (found.volumes[:, i] / first).tolist()}
            for i, name in enumerate(names)
        ],
    )
    return [distance, volume]


def unit_for(values: Sequence[float | None], units: Sequence[tuple[float, str]]) -> float:
    """The factor of the unit in which the largest value is at least 1, or the smallest unit's."""
    top = max((abs(v) for v in values if v is not None), default=0.0)
    return next((factor for factor, _ in units if top >= factor), units[-1][0])


def _height(motion: Motion, record: Record) -> Plot:
    up = motion.recording.up
    known = motion.curves
    center = [
        None
        if (c := frame.get("center", frame.get("centre"))) is None
        else sum(a * b for a, b in zip(c, up))
        for frame in record.frames
    ]
    path = _health(motion, record, "center of mass", center)
    path["band"] = _band(record, path)
    curves = [
        _geometry(motion, "highest", known.get("highest")),
        path
        if any(c is not None for c in center)
        else _geometry(motion, "center", known.get("center")),
        _geometry(motion, "lowest", known.get("lowest")),
    ]
    plot = _plot("Height", "along the up axis", curves, LENGTHS)
    if motion.recording.ground is not None:
        plot["line"] = motion.recording.ground / plot.pop("factor")
        plot["line_name"] = "floor"
    return plot


def _band(record: Record, curve: Curve) -> list[float | None]:
    """Half width [m] of what is known about a curve of every frame; None where it is not known."""
    known = record.certificate.get("center", {}).get("half_width", ())
    if not known or len(curve["y"]) < len(record.frames):
        return []
    return [*known, *[None] * (len(curve["y"]) - len(known))][: len(curve["y"])]


def _stretch(motion: Motion, record: Record) -> Plot:
    known = motion.curves
    return _plot(
        "Stretch",
        "of particles and of the surface; 1 is undeformed",
        [
            _health(motion, record, "largest", _column(record, "max_stretch")),
            _geometry(motion, "surface, largest", known.get("surface_max")),
            _geometry(motion, "surface, smallest", known.get("surface_min")),
            _health(motion, record, "smallest", _column(record, "min_stretch")),
        ],
    )


def _volume(motion: Motion, record: Record) -> Plot:
    high, low = _column(record, "max_J"), _column(record, "min_J")
    if any(v is not None for v in high):
        curves = [
            _health(motion, record, "largest", high),
            _health(motion, record, "smallest", low),
        ]
    else:
        curves = [
            _geometry(motion, "largest", motion.curves.get("ratio_max")),
            _geometry(motion, "smallest", motion.curves.get("ratio_min")),
        ]
    return _plot("Volume ratio J", "1 is undeformed; below 0 is inverted", curves)


def _energy(motion: Motion, record: Record) -> Plot:
    names = ("kinetic", "elastic", "potential", "contact")
    columns = [_column(record, name) for name in names]
    total = [None if None in row else sum(row) for row in zip(*columns)]  # type: ignore[arg-type]
    curves = [_health(motion, record, name, values) for name, values in zip(names, columns)]
    return _plot(
        "Energy",
        "only pins and moving obstacles may increase the total",
        [_health(motion, record, "total", total), *curves],
        ENERGIES,
    )


def _contact(motion: Motion, record: Record) -> Plot:
    depth = _column(record, "penetration")
    return _plot(
        "Depth in the floor",
        "of the deepest point of the surface",
        [_health(motion, record, "penetration", depth)],
        LENGTHS,
    )


def _drift(motion: Motion, record: Record) -> list[Plot]:
    names = sorted({key for frame in record.frames for key in frame if key.startswith("drift")})
    curves = [
        _health(motion, record, name.replace("_", " "), _column(record, name)) for name in names
    ]
    return [_plot("Drift", "of the mesh from its Gaussians", curves, LENGTHS)] if names else []


def _column(record: Record, name: str) -> list[float | None]:
    return [finite(frame.get(name)) for frame in record.frames]


def _health(motion: Motion, record: Record, name: str, values: Sequence[float | None]) -> Curve:
    """A curve over the frames of the bake that are in the recording."""
    recording = motion.recording
    codes = [finite(frame.get("time_code")) for frame in record.frames]
    if len(codes) == len(values) and None not in codes:
        # a range, handles and samples between frames part the two
        first, last = recording.time_codes[0], recording.time_codes[-1]
        held = [(c, v) for c, v in zip(codes, values) if c is not None and first <= c <= last]
        return {
            "name": name,
            "x": [recording.seconds(code) for code, _ in held],
            "y": [value for _, value in held],
        }
    if len(values) == len(recording.time_codes):
        x = [recording.seconds(code) for code in recording.time_codes]
    else:
        fps = finite(record.settings.get("fps")) or recording.time_codes_per_second
        x = [i / fps for i in range(len(values))]
    return {"name": name, "x": x, "y": list(values)}


def _geometry(motion: Motion, name: str, values: Sequence[float] | None) -> Curve:
    """A curve over the frames that the page holds."""
    if values is None or len(values) != len(motion.time_codes):
        return {"name": name, "x": [], "y": []}
    return {
        "name": name,
        "x": [motion.recording.seconds(code) for code in motion.time_codes],
        "y": [finite(float(v)) for v in values],
    }


def _plot(
    title: str, meaning: str, curves: Sequence[Curve], units: Sequence[tuple[float, str]] = ()
) -> Plot:
    there = [curve for curve in curves if any(y is not None for y in curve["y"])]
    plot: Plot = {"title": title, "meaning": meaning, "unit": "", "factor": 1.0}
    if units:
        factor = unit_for([y for curve in there for y in curve["y"]], units)
        plot |= {"unit": dict(units)[factor], "factor": factor}
        for curve in there:
            curve["y"] = [None if y is None else y / factor for y in curve["y"]]
            curve["band"] = [None if y is None else y / factor for y in curve.get("band", ())]
    for curve in there:
        # six digits are more than a screen shows
        curve["x"] = [float(f"{x:.6g}") for x in curve["x"]]
        for key in ("y", "band"):
            curve[key] = [None if y is None else float(f"{y:.6g}") for y in curve.get(key, ())]
        if not curve["band"]:
            del curve["band"]
    return {**plot, "curves": there}
