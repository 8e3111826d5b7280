"""Values for the options of a bake, right and wrong, to be combined at random."""

from __future__ import annotations

import random
from pathlib import Path
from typing import Any

from hostile_files import STAGE

from gf_usd.core.errors import InputError, UsageError
from gf_usd.pipeline.prepared import prepare
from gf_usd.prepare.options.option import Option
from gf_usd.prepare.options.table import OPTIONS as TABLE

NAN, INF = float("nan"), float("inf")
NUMBERS = (0.0, -1.0, 1e-300, 1e300, NAN, INF, -INF)
BY_KIND: dict[type, tuple[Any, ...]] = {
    bool: (True, False),
    int: (1, 2, 0, -1),
    float: (0.5, *NUMBERS),
    str: ("1", "none", "0", "-1", "nan", "1e300", ":", "x", "", "a,b", "1:2:3"),
}
# What its type does not say; the first value of each is one that is right.
# A number of particles that would really be filled stays small: what is tried is the judging.
SPECIAL: dict[str, tuple[Any, ...]] = {
    "material": ("rubber", "jelly", "metal", "steel", "rubber,jelly", "rubber,rubber", "", ",",
                 "auto", "auto:nobody", "no.usda", "none", "rubber, metal"),
    "law": ("corotated", "neoHookean", "hooke", ""),
    "prims": (["/A"], ["/A/M"], ["/A/S"], ["/gone"], ["A"], [""], ["/A/M", "/A/M"]),
    "meters_per_unit": (0.01, 1.0, *NUMBERS),
    "up_axis": ("Y", "Z", "-Y", "X", ""),
    "output": ("o/", "o.usda", "o.usdz", "o.usdc", "o.txt", "", ".", "o/o/o.usd", "a\0b.usda"),
    "particles": (60, 300, 1, 0, -5, 10**12, 10**18),
    "spacing": (0.3, 0.5, 1e-6, 1e9, *NUMBERS),
    "frames": (1, 2, 24, 0, -3, 10**5),
    "fps": (24.0, 1.0, 1e6, 1e-6, *NUMBERS),
    "start": (1.0, 2.5, -1e9, 1e18, *NUMBERS),
    "drop": ("3r", "0", "1.5", "-1", "r", "", "nan", "1e300", "infr", "3 r", "3rr"),
    "gravity": ("9.81", "0", "0,0,0", "0,-9.81,0", "1,2", "-9.81", "nan", "1e300", "", "a",
                "gone.csv", "."),
    "seed": (0, 7, 2**31, 2**63, 2**200, -1),
    "device": ("cpu", "gpu", "CPU", ""),  # not every machine that has cuda is to start it
    "filter_rate": (10.0, *NUMBERS),
    "damping_time": (0.01, *NUMBERS),
    "time_scale": ("1", "0.2", "auto", "0", "-1", "nan", "1e300", "1e-300", "", "x"),
    "material_boxes": (("jelly:0,0,0,1,1,1",), ("jelly:1,1,1,0,0,0",), ("jelly",),
                       ("x:0,0,0,1,1,1",), ("jelly:nan,0,0,1,1,1",), ("jelly:0,0,0,1,1",), ("",)),
    "material_labels": (("a=b:jelly",), ("a=b",), ("=:",), ("a=b:x",), ("",)),
    "conversions": (("honey@time:3",), ("/A=water@strain:0.1", "-9,-9,-9,9,9,9=mud@stress:1e3"),
                    ("/gone=honey@time:3",), ("9,9,9,10,10,10=honey@time:3",), ("jelly@time:3",),
                    ("honey@time:nan",), ("honey@time:1e300",), ("honey@strain:0",),
                    ("honey@stress:-1",), ("honey@",), ("@time:3",), ("=honey@time:3",),
                    ("nan,0,0,1,1,1=honey@time:3",), ("1,2=honey@time:3",), ("honey",), ("",)),
    "pins": (("/A",), ("/A/M",), ("/gone",), ("box:-1,-1,-1,0,0,0",), ("box:0,0,0,0,0,0",),
             ("box:1,2",), ("box:nan,0,0,1,1,1",), ("box:-9,-9,-9,9,9,9",), ("",)),
    "procrustes": (0.02, 1.0, 2.0, *NUMBERS),
    "clamp": ("0.2:5", "none", "5:0.2", "1:1", "nan:1", ":", "x", "0:inf"),
    "stress_cap": ("1e4", "none", "0", "-1", "nan", "x"),
    "export_ply": ("frames", "a.usda"),
    "export_spz": ("frames",),
    "floor": ("none", "0", "0.5", "0,1,0", "0.5:0.2,1,0", "0,-1,0", "0,0,0", "1,2", "nan", "1e300",
              "", "1:2:3", "nan:0,1,0", "0,nan,0"),
    "only": ("mesh", "gaussians", "gaussians,points", "all", "", "mesh,mesh"),
    "precision": ("0.5%", "0.2mm", "1cm", "0", "0%", "-1%", "nan%", "infm", "1e-300m", "1e-9%",
                  "50%", "0.5", "%", "mm", "", "x", "5 parsecs"),
    "samples_per_frame": (1, 3, 0, -1),
    "range": ("1:2", "2:1", "1", ":", "nan:2", "1:1e18", "-5:3"),
    "handles": (0, 2, -1),
    "mass_scaling": (1.0, 10.0, *NUMBERS),
    "rolling_resistance": (0.0, 0.05, 2.0, *NUMBERS),
    "clip_frames": (0, 1, 2, -1),
    "velocity": ("1,0,0", "0,0,0", "1,2", "nan,0,0", "1e300,0,0", "inf,0,0", "", "x"),
    "spin": ("0,1,0", "0,0,0", "1,2", "nan,0,0", "1e300,0,0", "inf,0,0", "", "x"),
    "colliders": (("gone.usda",), ("a.usda",), (".",), ("a\0b.usda",), ("",)),
    "fields": (("wind:3,0,0",), ("radial:-5:at=0,1,0:radius=1", "noise:4:length=0.2:rate=1"),
               ("wind",), ("wind:nan,0,0",), ("radial:5",), ("noise:1:length=0",), ("",), ("x:1",),
               ("wind:1,0,0:radius=1",), ("wind:1e9,0,0",)),
    "material_sweep": ("youngs=1e4:1e5:2", "friction=0:1:3", "youngs=1e4:1e5", "youngs=0:1:3",
                       "youngs=1:nan:2", "x=1:2:3", "youngs=1e4:1e5:1000000", "poisson=0:0.6:2", "",
                       "="),
    "rigid": (("box:-1,-1,-1,0,0,0",), ("/A/M",), ("/A",), ("/gone",), ("box:1,2",), ("",)),
}  # fmt: skip
OF_THE_RUN = {"strict", "max_hours", "slice", "limits", "until"}  # what no plan hangs on


def values(option: Option) -> tuple[Any, ...]:
    """Values to try: those named above, else of its choices, else of its type."""
    of_choices = (*option.choices, f"{option.choices[-1]}s", "") if option.choices else ()
    return SPECIAL.get(option.name) or of_choices or BY_KIND[option.kind]


OPTIONS = {name: values(row) for name, row in TABLE.items() if name not in OF_THE_RUN}
assert set(SPECIAL) <= set(OPTIONS)


def drawn(dice: random.Random) -> dict[str, Any]:
    """One to eight options, of values that are right more often than not."""
    names = dice.sample(sorted(OPTIONS), dice.randint(1, 8))
    return {
        name: OPTIONS[name][0] if dice.random() < 0.5 else dice.choice(OPTIONS[name])
        for name in names
    }


def asset(folder: Path) -> Path:
    """A box and a ball, with a body of physics, in a folder to work in."""
    path = folder / "a.usda"
    path.write_text(STAGE)
    return path


def planned(path: Path, options: dict[str, Any]) -> bool:
    """Whether there is a plan; False where it is refused with a message and a hint.

    Any other error is a finding, and passes through.
    """
    small = {} if {"particles", "spacing"} & set(options) else {"particles": 100}
    try:
        prepared = prepare(path, **{**small, **options})
        for variant in prepared.plan.variants:
            prepared.solvers.substeps(variant)  # builds the solver
    except (UsageError, InputError) as refusal:
        if not (refusal.message.strip() and refusal.hint.strip()):
            raise AssertionError(f"no words: {refusal!r}") from refusal
        return False
    return True
