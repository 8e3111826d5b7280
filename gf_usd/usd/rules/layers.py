"""Rules about the metadata of layers and the time line."""

from __future__ import annotations

import math
from collections.abc import Iterator

from pxr import Usd

from gf_usd.usd.rules.base import Finding, about, rule
from gf_usd.usd.rules.read import prims

TIME_CODES = "time-codes-per-second"


@rule(
    TIME_CODES,
    "timeCodesPerSecond and framesPerSecond of every layer are positive and finite",
    reads_samples=False,
)
def time_codes_per_second(stage: Usd.Stage) -> Iterator[Finding]:
    """Zero or NaN over a sublayer makes USD search for samples for ever, so this comes first."""
    for layer in stage.GetUsedLayers():
        for key, authored in (
            ("timeCodesPerSecond", layer.HasTimeCodesPerSecond()),
            ("framesPerSecond", layer.HasFramesPerSecond()),
        ):
            value = getattr(layer, key)
            if authored and not (math.isfinite(value) and value > 0.0):
                yield about(TIME_CODES, "/").error(
                    f"layer {layer.identifier} authors {key} = {value:g}",
                    f"author a positive {key} in that layer, for example 24",
                )


@rule("stage-units", "metersPerUnit and kilogramsPerUnit are positive", reads_samples=False)
def stage_units(stage: Usd.Stage) -> Iterator[Finding]:
    """Unauthored is fine: USD then means 0.01 and 1."""
    for key in ("metersPerUnit", "kilogramsPerUnit"):
        if not stage.HasAuthoredMetadata(key):
            continue
        value = stage.GetMetadata(key)
        usable = isinstance(value, (int, float)) and math.isfinite(value) and value > 0.0
        if not usable:
            yield about("stage-units", "/").error(
                f"the stage authors {key} = {value}",
                f"author the size of a unit as a positive number, for example {key} = 1",
            )


@rule("time-range", "every time sample lies between startTimeCode and endTimeCode")
def time_range(stage: Usd.Stage) -> Iterator[Finding]:
    """Samples outside are no error: a shot may use a part of a longer animation."""
    speak = about("time-range", "/")
    start, end = stage.GetStartTimeCode(), stage.GetEndTimeCode()
    bounded = stage.HasAuthoredTimeCodeRange()
    if bounded and not start <= end:
        yield speak.error(
            f"startTimeCode {start:g} lies after endTimeCode {end:g}",
            "author the first and the last time code of the animation",
        )
        return
    animated = 0
    for prim in prims(stage):
        outside: list[str] = []
        low, high = math.inf, -math.inf
        for attribute in prim.GetAuthoredAttributes():
            codes = attribute.GetTimeSamples()
            if not codes:
                continue
            animated += 1
            if codes[0] < start or codes[-1] > end:
                outside.append(attribute.GetName())
                low, high = min(low, codes[0]), max(high, codes[-1])
        if bounded and outside:
            yield about("time-range", prim).warning(
                f"{len(outside)} attributes ({', '.join(outside[:3])}"
                f"{', ...' if len(outside) > 3 else ''}) have samples from {low:g} to {high:g}, "
                f"the stage runs from {start:g} to {end:g}",
                "widen startTimeCode and endTimeCode, or drop the samples outside",
            )
    if animated and not bounded:
        yield speak.warning(
            f"{animated} attributes have time samples, but the stage says no time range",
            "author startTimeCode and endTimeCode in the root layer",
        )
