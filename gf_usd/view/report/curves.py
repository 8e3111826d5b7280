"""The plots of a report: values over playback time."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from gf_usd.view.compare import Comparison
from gf_usd.view.report.motion import OMITTED, Motion
from gf_usd.view.report.record import Record, finite

Curve = dict[str, Any]
Plot = dict[str, Any]

LENGTHS = ((1.0, "m"), (1e-2, "cm"), (1e-3, "mm"), (1e-6, "µm"))
ENERGIES = (
    (1e12, "TJ"), (1e9, "GJ"), (1e6, "MJ"), (1e3, "kJ"), (1.0, "J"), (1e-3, "mJ"), (1e-6, "µJ"),
    (1e-9, "nJ"),
)  # fmt: skip


def plots(motion: Motion, record: Record) -> list[Plot]:
    """All plots with data.  Each has a title, a unit, and curves of y over x, playback time [s]."""
    all_plots = [
        _height_plot(motion, record),
        _stretch_plot(motion, record),
        _volume_plot(motion, record),
        _energy_plot(motion, record),
        _penetration_plot(motion, record),
        *_drift_plots(motion, record),
    ]
    return [plot for plot in all_plots if plot["curves"]]


def comparison_plots(comparison: Comparison, names: tuple[str, str]) -> list[Plot]:
    """Plots of the distance and the volumes of two motions over time; names : of the two."""
    x = comparison.seconds.tolist()
    distance = _make_plot(
        "Distance",
        "between the same points in the two files",
        [
            {"name": "largest", "x": [*x], "y": comparison.largest.tolist()},
            {"name": "rms", "x": [*x], "y": comparison.rms.tolist()},
            {"name": "centers of mass", "x": [*x], "y": comparison.center.tolist()},
        ],
        LENGTHS,
    )
    factor = distance.pop("factor")
    if comparison.tolerance is not None:
        distance["line"], distance["line_name"] = comparison.tolerance / factor, "tolerance"
    first = comparison.volumes[0, 0] or 1.0
    volume = _make_plot(
        "Volume",
        f"relative to that of {names[0]} in the first frame",
        [
            {"name": name, "x": [*x], "y": (comparison.volumes[:, i] / first).tolist()}
            for i, name in enumerate(names)
        ],
    )
    return [distance, volume]


def unit_for(values: Sequence[float | None], units: Sequence[tuple[float, str]]) -> float:
    """The factor of the largest unit in which the largest value is 1 or more, else the smallest."""
    top = max((abs(v) for v in values if v is not None), default=0.0)
    return next((factor for factor, _ in units if top >= factor), units[-1][0])


def _height_plot(motion: Motion, record: Record) -> Plot:
    up = motion.recording.up
    values_by_name = motion.curves
    center = [
        None
        if (c := frame.get("center", frame.get("centre"))) is None
        else sum(a * b for a, b in zip(c, up))
        for frame in record.frames
    ]
    center_curve = _health_curve(motion, record, "center of mass", center)
    center_curve["band"] = _certified_band(record, center_curve)
    curves = [
        _geometry_curve(motion, "highest", values_by_name.get("highest")),
        center_curve
        if any(c is not None for c in center)
        else _geometry_curve(motion, "center", values_by_name.get("center")),
        _geometry_curve(motion, "lowest", values_by_name.get("lowest")),
    ]
    plot = _make_plot("Height", "along the up axis", curves, LENGTHS)
    if motion.recording.ground is not None:
        plot["line"] = motion.recording.ground / plot.pop("factor")
        plot["line_name"] = "floor"
    return plot


def _certified_band(record: Record, curve: Curve) -> list[float | None]:
    """Half width [m] of the certified interval in each frame of a curve; None: unknown."""
    half_widths = record.certificate.get("center", {}).get("half_width", ())
    if not half_widths or len(curve["y"]) < len(record.frames):
        return []
    return [*half_widths, *[None] * (len(curve["y"]) - len(half_widths))][: len(curve["y"])]


def _stretch_plot(motion: Motion, record: Record) -> Plot:
    values_by_name = motion.curves
    return _make_plot(
        "Stretch",
        f"of particles and of {100 * (1 - OMITTED):g} % of the surface; 1 is undeformed",
        [
            _health_curve(motion, record, "largest", _health_column(record, "max_stretch")),
            _geometry_curve(motion, "surface, largest", values_by_name.get("surface_max")),
            _geometry_curve(motion, "surface, smallest", values_by_name.get("surface_min")),
            _health_curve(motion, record, "smallest", _health_column(record, "min_stretch")),
        ],
    )


def _volume_plot(motion: Motion, record: Record) -> Plot:
    high, low = _health_column(record, "max_J"), _health_column(record, "min_J")
    if any(v is not None for v in high):
        curves = [
            _health_curve(motion, record, "largest", high),
            _health_curve(motion, record, "smallest", low),
        ]
    else:
        curves = [
            _geometry_curve(motion, "largest", motion.curves.get("ratio_max")),
            _geometry_curve(motion, "smallest", motion.curves.get("ratio_min")),
        ]
    return _make_plot("Volume ratio J", "1 is undeformed; below 0 is inverted", curves)


def _energy_plot(motion: Motion, record: Record) -> Plot:
    names = ("kinetic", "elastic", "potential", "contact")
    columns = [_health_column(record, name) for name in names]
    total = [None if None in row else sum(row) for row in zip(*columns)]  # type: ignore[arg-type]
    curves = [_health_curve(motion, record, name, values) for name, values in zip(names, columns)]
    return _make_plot(
        "Energy",
        "only pins and moving obstacles may increase the total",
        [_health_curve(motion, record, "total", total), *curves],
        ENERGIES,
    )


def _penetration_plot(motion: Motion, record: Record) -> Plot:
    depth = _health_column(record, "penetration")
    return _make_plot(
        "Depth in the floor",
        "of the deepest point of the surface",
        [_health_curve(motion, record, "penetration", depth)],
        LENGTHS,
    )


def _drift_plots(motion: Motion, record: Record) -> list[Plot]:
    names = sorted({key for frame in record.frames for key in frame if key.startswith("drift")})
    curves = [
        _health_curve(motion, record, name.replace("_", " "), _health_column(record, name))
        for name in names
    ]
    return [_make_plot("Drift", "of the mesh from its Gaussians", curves, LENGTHS)] if names else []


def _health_column(record: Record, name: str) -> list[float | None]:
    return [finite(frame.get(name)) for frame in record.frames]


def _health_curve(
    motion: Motion, record: Record, name: str, values: Sequence[float | None]
) -> Curve:
    """A curve of health values over the frames of the bake within the recording."""
    recording = motion.recording
    codes = [finite(frame.get("time_code")) for frame in record.frames]
    if len(codes) == len(values) and None not in codes:
        # the recording differs from the frames by a range, handles or samples between frames
        first, last = recording.time_codes[0], recording.time_codes[-1]
        in_range = [(c, v) for c, v in zip(codes, values) if c is not None and first <= c <= last]
        return {
            "name": name,
            "x": [recording.seconds(code) for code, _ in in_range],
            "y": [value for _, value in in_range],
        }
    if len(values) == len(recording.time_codes):
        x = [recording.seconds(code) for code in recording.time_codes]
    else:
        fps = finite(record.settings.get("fps")) or recording.time_codes_per_second
        x = [i / fps for i in range(len(values))]
    return {"name": name, "x": x, "y": list(values)}


def _geometry_curve(motion: Motion, name: str, values: Sequence[float] | None) -> Curve:
    """A curve of geometric values over the frames of the page."""
    if values is None or len(values) != len(motion.time_codes):
        return {"name": name, "x": [], "y": []}
    return {
        "name": name,
        "x": [motion.recording.seconds(code) for code in motion.time_codes],
        "y": [finite(float(v)) for v in values],
    }


def _make_plot(
    title: str, meaning: str, curves: Sequence[Curve], units: Sequence[tuple[float, str]] = ()
) -> Plot:
    with_data = [curve for curve in curves if any(y is not None for y in curve["y"])]
    plot: Plot = {"title": title, "meaning": meaning, "unit": "", "factor": 1.0}
    if units:
        factor = unit_for([y for curve in with_data for y in curve["y"]], units)
        plot |= {"unit": dict(units)[factor], "factor": factor}
        for curve in with_data:
            curve["y"] = [None if y is None else y / factor for y in curve["y"]]
            curve["band"] = [None if y is None else y / factor for y in curve.get("band", ())]
    for curve in with_data:
        # six digits are beyond the resolution of a screen
        curve["x"] = [float(f"{x:.6g}") for x in curve["x"]]
        for key in ("y", "band"):
            curve[key] = [None if y is None else float(f"{y:.6g}") for y in curve.get(key, ())]
        if not curve["band"]:
            del curve["band"]
    return {**plot, "curves": with_data}
