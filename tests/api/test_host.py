"""gf_usd as a guest of another program, which is a process of its own in every test here."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FEW = "output='out/', particles=60, frames=3, overwrite=True"
START = """
import gf_usd
SPHERE = {sphere!r}
bake = lambda **more: gf_usd.bake(SPHERE, {few}, **more)
"""


def run(folder: Path, code: str) -> str:
    """What a program prints that may use bake()."""
    start = START.format(sphere=str(ROOT / "samples" / "sphere.usda"), few=FEW)
    done = subprocess.run(
        [sys.executable, "-c", start + code], cwd=folder, capture_output=True, text=True,
        check=False, env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=100,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


LATE = """
from pxr import Usd, UsdGeom
UsdGeom.Xform.Define(Usd.Stage.CreateInMemory(), '/A')
seen = []
"""


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_bake_after_stages_were_opened(tmp_path: Path) -> None:
    output = run(
        tmp_path,
        LATE
        + """
result = bake(progress=lambda done, total: seen.append((done, total)), material=gf_usd.Material(
    name='soft', law='neoHookean', density=1e3, youngs_modulus=1e5, poissons_ratio=.3))
print(type(result).__name__, result.root, result.bakes[0].material.name, seen)
print([note for note in result.notes if 'separate' in note])
read = gf_usd.read(result.root)
print(gf_usd.check(result.root).ok, len(read), len(read.health))
print(gf_usd.inspect(SPHERE, particles=60).refusal)
""",
    )
    first, notes, *rest = output.splitlines()
    assert first == "BakeResult out/sphere.soft.usda soft [(1, 3), (2, 3), (3, 3)]"
    assert "a separate process: USD read its schema definitions before" in notes
    assert rest[0].startswith("True 3 2")
    assert rest[1:] == ["None"]


@pytest.mark.slow
@pytest.mark.acceptance
def test_errors_of_a_bake_in_another_process_are_the_same(tmp_path: Path) -> None:
    code = """
def report(**more):
    try:
        bake(**more)
    except gf_usd.GfUsdError as error:
        print(type(error).__name__, '|', error.message, '|', error.hint, '|', more, end=' ')
        print(sorted(set(vars(error)) - {'message', 'hint'}))
report(spacing=0.1)
report(max_hours=1e-9)
report(clip_frames=1, slice=1)
"""
    away, here = run(tmp_path, LATE + code), run(tmp_path, code)
    assert away == here
    assert "UsageError | particles=60 and spacing=0.1 were both given" in away
    assert "Unfinished" in away.splitlines()[-1]
    assert away.endswith("['done', 'frames', 'variant']")


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_program_that_uses_taichi_keeps_it(tmp_path: Path) -> None:
    output = run(
        tmp_path,
        """
import taichi as ti
ti.init(arch=ti.cpu, log_level=ti.ERROR)
mine = ti.field(float, 3)
mine.fill(7.0)
result = bake()
print(any('already runs Taichi' in note for note in result.notes), mine.to_numpy())
for call in (lambda: gf_usd.inspect(SPHERE), lambda: gf_usd.simulate(gf_usd.Scene())):
    try:
        call()
    except gf_usd.UsageError as error:
        print(error.message)
print(gf_usd.preview(result.root, size=(32, 24)).pixels.shape, mine.to_numpy())
""",
    ).splitlines()
    assert output[2:5] == [  # behind Taichi's own words
        "True [7. 7. 7.]",
        "another part of this program already runs Taichi, and a process can run it only once:"
        " inspect would end that computation",
        "another part of this program already runs Taichi, and a process can run it only once:"
        " simulate would end that computation",
    ]
    assert output[5] == "(24, 32, 3) [7. 7. 7.]"


@pytest.mark.slow
@pytest.mark.acceptance
def test_a_program_that_starts_taichi_after_us_keeps_it(tmp_path: Path) -> None:
    output = run(
        tmp_path,
        """
def report(simulation):
    try:
        next(simulation)
    except gf_usd.UsageError as error:
        print(error.message)

scene = gf_usd.Scene()
scene.add_body([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], [
    [0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
bake()
running = gf_usd.simulate(scene, particles=60)
next(running)
import taichi as ti
ti.reset()
report(running)
print(bake().frames)
running = gf_usd.simulate(scene, particles=60)
ti.init(arch=ti.cpu, log_level=ti.ERROR)
mine = ti.field(float, 3)
mine.fill(7.0)
report(running)
result = bake()
print(any('already runs Taichi' in note for note in result.notes), mine.to_numpy())
""",
    )
    ended = "another part of this program started or reset Taichi, which ended the simulation"
    lines = [line for line in output.splitlines() if not line.startswith("[Taichi]")]
    assert lines == [ended, "3", ended, "True [7. 7. 7.]"]


@pytest.mark.slow
@pytest.mark.acceptance
def test_nothing_stays_replaced(tmp_path: Path) -> None:
    output = run(
        tmp_path,
        """
import gc, inspect, logging, os, signal, sys, threading, types
import numpy as np
import taichi as ti
import taichi.lang.ast.ast_transformer, taichi.lang.kernel_impl

COUNTERS = {'pytaichi', '_root_fb', '_instance_count', 'function_counter', 'counter'}

def parts():
    found = {}
    for name, module in list(sys.modules.items()):
        if name.split('.')[0] not in ('taichi', 'inspect', 'ast', 'textwrap', 'linecache'):
            continue
        for key, value in list(vars(module).items()):
            found[name, key] = id(value)
            if isinstance(value, type):
                found |= {(name, key, k): id(v) for k, v in list(vars(value).items())}
    return found

def process():
    return (
        {number: signal.getsignal(number) for number in signal.valid_signals()},
        dict(os.environ), sys.excepthook, sys.stdout, sys.stderr, np.geterr(),
        list(logging.root.handlers), logging.root.level, gc.get_threshold(), gc.isenabled(),
        threading.active_count(), os.getcwd(), inspect.getsourcelines, np.linalg.norm,
    )

before, known = process(), parts()
result = bake()
gf_usd.preview(result.root, size=(32, 24))
after, now = process(), parts()
print([i for i, (a, b) in enumerate(zip(before, after)) if a != b])
print([key for key in known if key in now and now[key] != known[key] and key[-1] not in COUNTERS])
""",
    )
    assert output.splitlines()[-2:] == ["[]", "[]"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "late",
    [pytest.param("", id="here"), pytest.param(LATE, id="away", marks=pytest.mark.acceptance)],
)
def test_it_may_be_called_from_a_thread_and_interrupted(tmp_path: Path, late: str) -> None:
    output = run(
        tmp_path,
        late
        + """
import threading
def stop(done, total):
    raise KeyboardInterrupt
try:
    bake(progress=stop)
except KeyboardInterrupt:
    print('interrupted')
def work(name):
    results.append(gf_usd.bake(SPHERE, output=f'{name}/', particles=60, frames=3).frames)
results = []
threads = [threading.Thread(target=work, args=(name,)) for name in ('a', 'b')]
for thread in threads:
    thread.start()
for thread in threads:
    thread.join()
print(results, bake().frames)
""",
    )
    assert output.splitlines() == ["interrupted", "[3, 3] 3"]


def test_a_crash_of_the_separate_process_is_a_bake_error(tmp_path: Path) -> None:
    lines = run(
        tmp_path,
        """
from gf_usd.api.host.own_process import call
for task in ('os:abort', 'gf_usd.api.host.guest:nothing'):
    try:
        call(task, {})
    except gf_usd.BakeError as error:
        print(error.message)
""",
    ).splitlines()
    assert lines[0].startswith("the process that did the work ended by signal 6")
    assert "with status 1: AttributeError: module 'gf_usd.api.host.guest'" in lines[1]


EDITED = """
from pathlib import Path
from pxr import Sdf, Usd, UsdGeom
Path('over.usda').write_text('#usda 1.0\\n(subLayers = [@' + SPHERE + '@])\\n')
Path('root.usda').write_text('#usda 1.0\\n(defaultPrim = "Sphere"\\nsubLayers = [@over.usda@])\\n')
over = Sdf.Layer.FindOrOpen('over.usda')
{open}
Sdf.CreatePrimInLayer(over, '/Sphere').typeName = 'Scope'
def report(call, **more):
    try:
        call('root.usda', particles=60, **more)
    except gf_usd.InputError as error:
        print(error.message, '|', error.hint)
report(gf_usd.bake, output='out/', frames=3)
report(gf_usd.inspect)
print(over.dirty)
"""


@pytest.mark.slow
@pytest.mark.parametrize("schema", ["", "import gf_usd.system.usd_schema"])
def test_what_the_program_has_not_saved_is_neither_baked_nor_passed_over(
    tmp_path: Path, schema: str
) -> None:
    opened = "stage = Usd.Stage.Open('root.usda')"
    lines = run(tmp_path, schema + EDITED.replace("{open}", opened)).splitlines()
    assert len(lines) == 3
    for line in lines[:2]:
        assert line.startswith("root.usda: the layer over.usda has unsaved changes in this program")
        assert "layer.Save()" in line
    assert lines[2] == "True"
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_sublayer_with_edits_is_found_where_the_asset_is_not_open(tmp_path: Path) -> None:
    lines = run(tmp_path, EDITED.replace("{open}", "")).splitlines()
    assert len(lines) == 3
    assert all("over.usda has unsaved changes" in line for line in lines[:2])


FORKED = """
import os
from gf_usd.system.taichi_runtime import init_taichi
scene = gf_usd.Scene()
scene.add_body([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], [
    [0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
running = gf_usd.simulate(scene, particles=60)
next(running)

def report(call):
    try:
        call()
    except gf_usd.GfUsdError as error:
        print(type(error).__name__, error.message, '|', error.hint, flush=True)

if not os.fork():
    {work}
    os._exit(0)
print(os.wait()[1], next(running).index)
"""


@pytest.mark.slow
def test_a_forked_process_says_that_taichi_does_not_run_in_it(tmp_path: Path) -> None:
    calls = "inspect(SPHERE)", "simulate(scene, particles=60)"
    work = [f"report(lambda: gf_usd.{call})" for call in calls]
    work += ["report(lambda: next(running))", "report(init_taichi)"]
    *lines, last = run(tmp_path, FORKED.replace("{work}", "; ".join(work))).splitlines()
    assert last == "0 1"
    assert len(lines) == 4
    for line in lines:
        assert "this process was forked from one that had started Taichi" in line
        assert "use the spawn method" in line
    assert lines[-1].startswith("GfUsdError")


@pytest.mark.slow
def test_a_forked_process_bakes_in_one_of_its_own(tmp_path: Path) -> None:
    work = "result = bake(); print(result.frames, result.notes[-1], flush=True)"
    line, last = run(tmp_path, FORKED.replace("{work}", work)).splitlines()
    assert line.startswith("3 baked in a separate process: this process was forked")
    assert last == "0 1"
