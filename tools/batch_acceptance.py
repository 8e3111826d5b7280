"""A batch with injected failures: killed bakes, a damaged asset, a full disk, SIGTERM, kill -9.

    python tools/batch_acceptance.py [--json] [--seeds N] [--few N] [--only local,dask,openjd]

Jobs are small: 120 particles and 4 frames.  The same is done on this machine's processes, on a Dask
cluster and by `openjd run`.  Exit status 1 if a claim does not hold.
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from batch_openjd import openjd
from batch_runs import (
    Claim,
    Claims,
    Event,
    Run,
    bakes_in,
    broken,
    cluster,
    figure,
    kill_a_bake,
    later,
    manifest,
    none_left,
    results,
    run,
    tmpfs,
)

SMALL, LARGE = "8m", "2g"  # of the disk: first it holds about twenty results
FULL = 3  # jobs that fail for the disk before it is given room
PORT = 28786


def local(folder: Path, seeds: int) -> list[Claim]:
    """Processes of this machine, results on a small disk."""
    claim = Claims("processes")
    out = folder / "out"
    asked = manifest(folder, seeds, 2)
    good = 9 * seeds
    words = [asked, "--out", out]
    with tmpfs(out, SMALL) as enlarge:
        first = run(words, lambda r, e: _full_disk_kill_and_term(r, e, out, enlarge))
        disk = [e for e in first.ended("failed") if "space" in json.dumps(e)]
        claim("jobs on the full disk failed and reported it", len(disk), len(disk) >= FULL)
        crashed = [e for e in first.events if e["event"] == "retry" and "SIGKILL" in e["why"]]
        again = {e["job"] for e in crashed} & {e["job"] for e in first.ended("done")}
        claim("a bake that was killed was baked again", sorted(again), len(again) == 1)
        claim("SIGTERM: exit status", first.process.returncode, first.process.returncode == 143)
        claim("SIGTERM: seconds until no bake was left", figure(none_left(out)), not bakes_in(out))

        second = run(
            words, lambda r, e: _kill_the_batch(r, e, (len(first.ended("done")) + good) // 2)
        )
        gone = none_left(out)
        claim("kill -9 of the batch: exit status", second.process.returncode,
              second.process.returncode == -signal.SIGKILL)  # fmt: skip
        claim("kill -9 of the batch: seconds until its bakes were gone", figure(gone),
              gone is not None)  # fmt: skip
        kept = {e["job"] for e in first.ended("done")}
        wrong = kept & set(second.begun)
        claim("the second run baked no finished job again", sorted(wrong), not wrong)

        third = run(words)
        claim("only the damaged asset failed", third.counts,
              third.counts.get("refused") == 2 and set(third.counts) <= {"done", "kept", "refused"}
              and third.process.returncode == 1)  # fmt: skip
        done = kept | {e["job"] for e in second.ended("done")}
        wrong = done & set(third.begun)
        claim("the third run baked no finished job again", sorted(wrong), not wrong)
        claim(f"results of {good + 2} jobs", len(results(out)), len(results(out)) == good)

        fourth = run(words)
        claim("a final run attempts only the damaged jobs", sorted(fourth.begun),
              sorted(fourth.begun) == [f"corrupt.rubber.seed{i}" for i in range(2)])  # fmt: skip
        faults = broken(out)
        claim(f"check of {good} results", faults or "no errors", not faults)
    return claim.all


def _full_disk_kill_and_term(found: Run, event: Event, out: Path, enlarge) -> None:
    """Give the disk room once it was full, then kill a bake, then end the batch."""
    if event["event"] != "finished":
        return
    full = [e for e in found.ended("failed") if "space" in json.dumps(e)]
    if len(full) >= FULL and "room" not in found.done:
        found.done["room"] = len(found.ended("done"))
        enlarge(LARGE)
    since = len(found.ended("done")) - found.done.get("room", len(found.ended("done")))
    if since >= 5 and "killed" not in found.done:
        found.done["killed"] = kill_a_bake(out)
    if since >= 20 and "ended" not in found.done:
        found.done["ended"] = True
        found.process.send_signal(signal.SIGTERM)


def _kill_the_batch(found: Run, event: Event, after: int) -> None:
    if event["event"] == "finished" and len(found.ended("done", "kept")) >= after:
        found.process.kill()


def dask(folder: Path, seeds: int) -> list[Claim]:
    """A scheduler and two workers."""
    claim = Claims("Dask")
    out = folder / "out"
    words = [manifest(folder, seeds, 1), "--out", out, "--scheduler", f"tcp://127.0.0.1:{PORT}"]
    good = 9 * seeds
    with cluster(folder, PORT) as workers:

        def meddle(found: Run, event: Event) -> None:
            ended = len(found.ended("done"))
            if event["event"] == "started" and ended >= 3 and "killed" not in found.done:
                # in the middle of a bake: the job has to be done by the other worker
                found.done["killed"] = event["job"]
                later(1.0, workers[0].kill)
            if (
                event["event"] == "finished"
                and ended >= 2 * good // 3
                and "ended" not in found.done
            ):
                found.done["ended"] = True
                found.process.send_signal(signal.SIGTERM)

        first = run(words, meddle)
        ended = workers[0].poll()
        claim("a worker was killed", ended, ended == -signal.SIGKILL)
        claim("SIGTERM: exit status", first.process.returncode, first.process.returncode == 143)
        left = none_left(out)
        claim("SIGTERM: seconds until no bake was left", figure(left), left is not None)
        second = run(words)
        twice = [job for job, n in first.begun.items() if n > 1]
        claim("a job of the dead worker was started again", twice, bool(twice))
        kept = {e["job"] for e in first.ended("done")}
        wrong = kept & set(second.begun)
        claim("the second run baked no finished job again", sorted(wrong), not wrong)
        claim("only the damaged asset failed", second.counts,
              second.counts.get("refused") == 1
              and set(second.counts) <= {"done", "kept", "refused"})  # fmt: skip
        claim(f"results of {good + 1} jobs", len(results(out)), len(results(out)) == good)
        third = run(words)
        claim("a final run attempts only the damaged jobs", sorted(third.begun),
              sorted(third.begun) == ["corrupt.rubber"])  # fmt: skip
    faults = broken(out)
    claim(f"check of {good} results", faults or "no errors", not faults)
    return claim.all


def main(words: Sequence[str] | None = None) -> None:
    """Run all and print what came of them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--seeds", type=int, default=22, help="9 jobs each on this machine")
    parser.add_argument("--few", type=int, default=2, help="9 jobs each for Dask and OpenJD")
    parser.add_argument("--only", default="local,dask,openjd")
    asked = parser.parse_args(words)
    few = asked.few
    engines = {"local": (local, asked.seeds), "dask": (dask, few), "openjd": (openjd, few)}
    claims: list[Claim] = []
    seconds: dict[str, float] = {}
    for name in asked.only.split(","):
        engine, seeds = engines[name]
        print(name, file=sys.stderr)
        began = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="gf-usd-night-") as folder:
            claims += engine(Path(folder), seeds)
        seconds[name] = round(time.monotonic() - began, 1)
    if asked.json:
        rows = [asdict(claim) for claim in claims]
        print(json.dumps({"claims": rows, "seconds": seconds, "jobs": 9 * asked.seeds + 2}))
    sys.exit(0 if all(claim.holds for claim in claims) else 1)


if __name__ == "__main__":
    main()
