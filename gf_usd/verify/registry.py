"""The registry of cases, and functions that run them."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence

from gf_usd.core.errors import SolverError, UsageError, did_you_mean
from gf_usd.verify.case import Case, Measure, Result
from gf_usd.verify.cases import (
    drop,
    flight,
    floor,
    law,
    limbs,
    patch,
    sampling,
    sides,
)
from gf_usd.verify.cases.contact import arms, collisions, hertz, slope
from gf_usd.verify.cases.elastic import (
    bar,
    cantilever,
    finite,
    locking,
    manufactured,
    slanted,
    thin,
    vibration,
)
from gf_usd.verify.cases.flesh import driven, rigid
from gf_usd.verify.cases.plastic import (
    expansion,
    membrane,
    rim,
    slump,
    taylor,
    uniaxial,
)
from gf_usd.verify.cases.plastic.flowing import (
    both,
    column,
    conversion,
    dam,
    hydrostatic,
    incline,
    puddle,
)

CASES: tuple[Case, ...] = (
    *flight.CASES,
    *patch.CASES,
    *sampling.CASES,
    *law.CASES,
    *bar.CASES,
    *bar.VERTICAL_CASES,
    *cantilever.CASES,
    *limbs.CASES,
    *thin.CASES,
    *locking.CASES,
    *manufactured.CASES,
    *finite.CASES,
    *slanted.CASES,
    *vibration.CASES,
    *floor.CASES,
    *slope.CASES,
    *hertz.CASES,
    *collisions.CASES,
    *arms.CASES,
    *drop.CASES,
    *uniaxial.CASES,
    *expansion.CASES,
    *slump.CASES,
    *incline.CASES,
    *column.CASES,
    *hydrostatic.CASES,
    *dam.CASES,
    *puddle.CASES,
    *both.CASES,
    *conversion.CASES,
    *membrane.CASES,
    *taylor.CASES,
    *rim.CASES,
    *sides.CASES,
    *driven.CASES,
    *rigid.CASES,
)


def select(names: Sequence[str] = ()) -> tuple[Case, ...]:
    """The cases of these names, or all for no names, in the order of the registry.

    Raises UsageError for an unknown name.
    """

    cases_by_name = {case.name: case for case in CASES}
    for name in names:
        if name not in cases_by_name:
            guess = did_you_mean(name, cases_by_name)
            raise UsageError(f"there is no case {name!r}", f"{guess}gf-usd verify --list shows all")
    return tuple(case for case in CASES if not names or case.name in names)


def verify(
    cases: Sequence[Case], *, full: bool = False, device: str = "cpu", processes: int = 1
) -> Iterator[Result]:
    """Run cases, those in double precision last, because Taichi is restarted for them.

    processes : number of parallel worker processes; 1: this process.

    Raises UsageError before the first case where the device is not available.
    """
    from gf_usd.system.taichi_runtime import init_taichi
    from gf_usd.verify.parallel import verify_in

    init_taichi(device)
    ordered = sorted(cases, key=lambda case: case.f64)
    processes = min(processes, len(ordered))
    if processes > 1:
        yield from verify_in(ordered, run_named, full=full, device=device, processes=processes)
        return
    for case in ordered:
        yield run_case(case, full=full, device=device)


def run_named(name: str, full: bool, device: str) -> tuple[tuple[Measure, ...], float]:
    """Measures and seconds [s] of the case of a name, for worker processes."""
    (case,) = select((name,))
    result = run_case(case, full=full, device=device)
    return result.measures, result.seconds


def run_case(case: Case, *, full: bool = False, device: str = "cpu") -> Result:
    """Run one case; an error of the solver becomes a failed measure."""
    run = case.full if full and case.full else case.quick
    start_time = time.perf_counter()
    try:
        measures = tuple(run(device))
    except SolverError as error:
        measures = (
            Measure(
                name="run", value=math.nan, target=0.0, bound=0.0,
                why=f"the solver must reach the end: {error.message}",
            ),
        )  # fmt: skip
    return Result(case=case, measures=measures, seconds=time.perf_counter() - start_time)
