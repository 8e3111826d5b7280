"""`gf_usd.materials`: the presets.  `gf_usd.fit`: the material that reproduces an observation."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from gf_usd.api.call import asset_path, keywords
from gf_usd.api.host.guest import run_here_or_separately
from gf_usd.core.errors import UsageError
from gf_usd.prepare.options import values

if TYPE_CHECKING:
    from gf_usd.core.materials.presets import Preset
    from gf_usd.fitting.fit import FitRequest
    from gf_usd.fitting.result import FitResult

PICTURES = (".png",)
LAYERS = (".usd", ".usda", ".usdc")


def materials() -> Mapping[str, Preset]:
    """The material presets by name, those without dimensions first.

    >>> gf_usd.materials()["silicone"].youngs_modulus
    2000000.0
    >>> gf_usd.materials()["rubber"].material(radius=0.1).name
    'rubber'

    A preset without dimensions (rubber, metal, jelly, ...) has its moduli in units of rho g0 r and
    its times in sqrt(r / g0), with r the radius [m] of a ball of the body's volume, so that bodies
    of all sizes deform alike; the others have values of real materials in SI.
    `material(radius)` returns the `Material` of the preset for a body, to change or to bake with.
    """
    from gf_usd.core.materials.presets import presets

    return MappingProxyType(presets())


def fit(
    path: str | os.PathLike[str],
    targets: str | os.PathLike[str] | Mapping[str, float | str] | Sequence[str | os.PathLike[str]],
    *,
    unknowns: Sequence[str] = (),
    bounds: Mapping[str, tuple[float, float]] | str | Sequence[str] | None = None,
    output: str | os.PathLike[str] | None = None,
    picture: str | os.PathLike[str] | None = None,
    evaluations: str | os.PathLike[str] | None = None,
    max_minutes: float = 10.0,
    jobs: int | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int], None] | None = None,
    **options: Any,
) -> FitResult:
    """Find the material values that reproduce an observed motion of an asset.

    >>> found = gf_usd.fit(
    ...     "duck.usda", {"squash": 0.3}, unknowns=["E"], material="jelly", particles=100, frames=16
    ... )
    >>> (modulus,) = found.estimates
    >>> modulus.low < found.material.youngs_modulus < modulus.high
    True

    Nonlinear least squares over simulations: docs/fit.md describes the possible targets and how
    the intervals are computed.

    Parameters
    ----------
    path : the asset.
    targets : USD files with the motion of its meshes or of tracked points, and strings such as
        "rebound=0.6+-0.02"; or a mapping of figures to numbers [stage units], or to strings such as
        "0.6+-0.02".
    unknowns : names of the values to find, or a string with commas between them: fields of
        `Material`, parameters of its law, or E, nu, tau and rho; empty: E, nu, the damping time
        and, for laws with plastic flow, the yield stress.
    bounds : {name: (low, high)} [SI], or strings such as "E=1e4:1e6", instead of the default
        bounds.
    output : layer for the material; picture : .png; None: not written.
    evaluations : folder in which to keep the simulations; None: they are not kept.
    max_minutes : the search ends after this time [min], with the best values so far.
    jobs : number of parallel simulations; None: one per core.
    overwrite : replace an existing layer and picture.
    progress : called with (simulations so far, usual number of simulations).
    options : those of `gf_usd.bake` that decide the motion: material, particles, drop, ...

    Returns
    -------
    FitResult : the `Material`, each value with its interval, the sensitivities, and what the
        targets do not determine.

    Raises
    ------
    UsageError : targets, unknowns or options that make no sense, or an output that exists.
    InputError : the asset or a target cannot be used.
    BakeError : no simulation runs through.
    """
    from gf_usd.prepare.options.table import FITTED, taken

    with keywords(
        "bounds", "unknowns", "evaluations", "overwrite", "jobs", "max_minutes", target="targets"
    ) as names:
        if isinstance(targets, Mapping):
            texts = [
                f"{name}={value if isinstance(value, str) else f'{values.real(name, value):g}'}"
                for name, value in targets.items()
            ]
        else:
            texts = list(values.paths("targets", targets))
        for name in options:
            if name not in FITTED:
                raise UsageError(
                    f"fit() has no option {name!r}", f"its options are {', '.join(sorted(FITTED))}"
                )
        wanted = prepared_fit(
            asset_path(path),
            texts,
            unknowns=_names(unknowns),
            bounds=_bounds(bounds),
            output=None if output is None else Path(values.path("output", output)),
            picture=None if picture is None else Path(values.path("picture", picture)),
            evaluations=None
            if evaluations is None
            else Path(values.path("evaluations", evaluations)),
            max_minutes=values.real("max_minutes", max_minutes),
            jobs=None if jobs is None else values.positive("jobs", jobs),
            overwrite=values.switch("overwrite", overwrite),
            options=taken(options, "fit"),
        )
        arguments, progress = {"request": wanted}, values.progress_callback("progress", progress)
        done, _ = run_here_or_separately("gf_usd.fitting.fit:fit_counted", arguments, progress)
        return names.in_notes(done)


def _names(unknowns: object) -> list[str]:
    """The names of `fit`.  Raises UsageError for anything but texts."""
    wanted = "names such as ['E', 'nu'], or 'E,nu'"
    given = () if unknowns is None else values.texts("unknowns", unknowns, wanted)
    return [name for one in given for name in names_of(one)]


def names_of(unknowns: str | Sequence[str] | None) -> list[str]:
    """The names of "E,nu", or of a list."""
    if isinstance(unknowns, str):
        return [name.strip() for name in unknowns.split(",")]
    return list(unknowns or ())


def _bounds(bounds: Mapping[str, tuple[float, float]] | str | Sequence[str] | None) -> list[str]:
    """The bounds as the command line has them.  Raises UsageError for anything else."""
    wanted = "bounds by name [SI], such as {'E': (1e4, 1e6)}"
    if not isinstance(bounds, Mapping):
        return list(values.texts("bounds", bounds or (), wanted))
    pairs = []
    for name, pair in bounds.items():
        ends = tuple(pair) if isinstance(pair, Iterable) else ()
        if len(ends) != 2 or not all(map(values.is_number, ends)):
            raise values.refuse("bounds", bounds, wanted)
        pairs.append(f"{name}={':'.join(map(values.digits, ends))}")
    return pairs


def prepared_fit(
    asset: Path,
    targets: Sequence[str],
    *,
    unknowns: Sequence[str],
    bounds: Sequence[str],
    output: Path | None,
    picture: Path | None,
    evaluations: Path | None,
    max_minutes: float,
    jobs: int | None,
    overwrite: bool,
    options: Mapping[str, Any],
) -> FitRequest:
    """A fit with parsed texts.  Raises UsageError where one is invalid."""
    from gf_usd.core.units import number
    from gf_usd.fitting.fit import FitRequest
    from gf_usd.system.resources import cores

    form = "NAME=LOW:HIGH [SI], such as E=1e4:1e6"
    limits = {}
    for text in bounds:
        name, _, pair = text.partition("=")
        low, _, high = pair.partition(":")
        if not (name and low and high):
            raise UsageError(f"--bounds {text!r} is not a pair of bounds", f"give {form}")
        where = f"--bounds {text}"
        limits[name.strip()] = (number(where, low, form), number(where, high, form))
    for file, kinds, option in ((output, LAYERS, "-o"), (picture, PICTURES, "--picture")):
        if file is None:
            continue
        if file.suffix.lower() not in kinds:
            raise UsageError(f"{option} {file} does not end in {' or '.join(kinds)}", "rename it")
        if file.exists() and not overwrite:
            raise UsageError(
                f"{file} exists", f"add --overwrite, or give another file with {option}"
            )
        if not file.absolute().parent.is_dir():
            raise UsageError(f"the folder of {file} does not exist", "create it first")
    if not max_minutes >= 0.0:
        raise UsageError(f"--max-minutes is {max_minutes:g}", "give minutes, 0 or more")
    known = {name: value for name, value in options.items() if value not in (None, [], ())}
    one = known.get("device") == "cuda"
    limited = {**known, "limits": options.get("limits")}
    return FitRequest(
        asset=asset, targets=list(targets), unknowns=list(unknowns), bounds=limits, layer=output,
        picture=picture, evaluations=evaluations, max_minutes=max_minutes,
        processes=jobs or (1 if one else cores()), options=limited,
    )  # fmt: skip
