"""A batch with injected failures: killed bakes, a damaged asset, a full disk, SIGTERM, kill -9.

    python -m tools.acceptance.batch [--json] [--seeds N] [--few N] [--only local,dask,openjd]

Jobs are small: 120 particles and 4 frames.  The same jobs run in local processes, on a Dask cluster
and by the real `openjd run`. Exit status 1 if a check fails.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from tools.acceptance.batch_runs import (
    ROOT,
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

CHUNK = 4  # jobs in a task
NOTICE = 30.0  # [s] that the template grants between the request to end and the end
ENDED = re.compile(r"\d+ of \d+ done; (\S+): (done|kept|refused|failed|crashed|stopped)")
BEGUN = re.compile(r"\d+ of \d+ done; (\S+): running")


@dataclass
class Session:
    """One run of a bundle, with all that its tasks printed."""

    process: subprocess.Popen[str]
    lines: list[str] = field(default_factory=list)
    seconds_to_end: float | None = None  # after a SIGTERM

    def jobs(self, *states: str) -> list[str]:
        """Jobs that ended so."""
        found = (ENDED.search(line) for line in self.lines)
        return [m[1] for m in found if m and m[2] in states]

    @property
    def begun(self) -> list[str]:
        """Jobs of which a bake was begun."""
        return [m[1] for line in self.lines if (m := BEGUN.search(line))]


def program() -> str:
    """The openjd next to this Python, or on the path.  Raises SystemExit where there is none."""
    installed = Path(sys.executable).with_name("openjd")
    found = str(installed) if installed.is_file() else shutil.which("openjd")
    if found is None:
        raise SystemExit("openjd is not installed: pip install openjd-cli")
    return found


def session(bundle: Path, disturb: Callable[[Session], None] = lambda session: None) -> Session:
    """Run a whole bundle here; `disturb` is called after every line and may do harm."""
    command = [program(), "run", bundle / "template.json", "-p", f"file://{bundle}/parameters.json"]
    process = subprocess.Popen(
        list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        cwd=ROOT,
    )  # fmt: skip
    assert process.stdout is not None
    found, stopped_at = Session(process), 0.0
    for line in process.stdout:
        found.lines.append(line.rstrip())
        disturb(found)
        if "Interruption signal" in line:
            stopped_at = time.monotonic()
    process.wait()
    if stopped_at:
        found.seconds_to_end = time.monotonic() - stopped_at
    return found


def openjd(folder: Path, seeds: int) -> list[Claim]:
    """Check, run, SIGTERM, kill, run again."""
    claim = Claims("OpenJD")
    out, bundle, good = folder / "out", folder / "bundle", 9 * seeds
    arguments = [manifest(folder, seeds, 1), "--output", out, "--openjd", bundle, "--chunk", CHUNK]
    subprocess.run(
        [sys.executable, "-m", "gf_usd", "batch", *map(str, arguments)], check=True, cwd=ROOT
    )
    checked = subprocess.run(
        [program(), "check", bundle / "template.json"], capture_output=True, text=True, check=False
    )
    claim("openjd check", checked.stdout.strip().rpartition("/")[2], checked.returncode == 0)
    done: dict[str, bool] = {}

    def end(now: Session) -> None:
        if len(now.jobs("done")) >= 6 and "ended" not in done:
            done["ended"] = True
            now.process.send_signal(signal.SIGTERM)

    first = session(bundle, end)
    took = first.seconds_to_end
    claim("SIGTERM: seconds until openjd ended", figure(took), took is not None and took < NOTICE)
    left = none_left(out)
    claim("SIGTERM: seconds until no bake was left", figure(left), left is not None)

    def kill(now: Session) -> None:
        if len(now.jobs("done")) >= 2 and "killed" not in done and BEGUN.search(now.lines[-1]):
            done["killed"] = kill_a_bake(out)

    second = session(bundle, kill)
    wrong = set(first.jobs("done")) & set(second.begun)
    claim("the second run baked no finished job again", sorted(wrong), not wrong)
    twice = sorted({job for job in second.begun if second.begun.count(job) > 1})
    claim(
        "a bake that was killed was baked again",
        twice,
        bool(done.get("killed")) and len(twice) == 1,
    )
    failed = [line for line in second.lines if "openjd_fail: " in line]
    claim("a damaged asset failed its task with a message", failed[-1:] and failed[-1][-120:],
          len(failed) == 1 and second.jobs("refused") == ["corrupt.rubber"])  # fmt: skip
    claim(f"results of {good + 1} jobs", len(results(out)), len(results(out)) == good)
    third = session(bundle)
    claim("a final run attempts only the damaged jobs", sorted(third.begun),
          third.begun == ["corrupt.rubber"])  # fmt: skip
    faults = broken(out)
    claim(f"check of {good} results", faults or "no errors", not faults)
    return claim.all


SMALL, LARGE = "8m", "2g"  # of the disk: first it holds about twenty results
FULL = 3  # jobs that fail because the disk is full before space is freed
PORT = 28786


def local(folder: Path, seeds: int) -> list[Claim]:
    """Processes of this machine, results on a small disk."""
    claim = Claims("processes")
    out = folder / "out"
    jobs = manifest(folder, seeds, 2)
    good = 9 * seeds
    arguments = [jobs, "--output", out]
    with tmpfs(out, SMALL) as enlarge:
        first = run(arguments, lambda r, e: _full_disk_kill_and_term(r, e, out, enlarge))
        disk = [e for e in first.ended("failed", "refused") if "space" in json.dumps(e)]
        claim("jobs on the full disk ended and reported it", len(disk), len(disk) >= FULL)
        crashed = [e for e in first.events if e["event"] == "retry" and "SIGKILL" in e["why"]]
        again = {e["job"] for e in crashed} & {e["job"] for e in first.ended("done")}
        claim("a bake that was killed was baked again", sorted(again), len(again) == 1)
        claim("SIGTERM: exit status", first.process.returncode, first.process.returncode == 143)
        claim("SIGTERM: seconds until no bake was left", figure(none_left(out)), not bakes_in(out))

        second = run(
            arguments, lambda r, e: _kill_the_batch(r, e, (len(first.ended("done")) + good) // 2)
        )
        gone = none_left(out)
        claim("kill -9 of the batch: exit status", second.process.returncode,
              second.process.returncode == -signal.SIGKILL)  # fmt: skip
        claim("kill -9 of the batch: seconds until its bakes were gone", figure(gone),
              gone is not None)  # fmt: skip
        kept = {e["job"] for e in first.ended("done")}
        wrong = kept & set(second.begun)
        claim("the second run baked no finished job again", sorted(wrong), not wrong)

        third = run(arguments)
        claim("only the damaged asset failed", third.counts,
              third.counts.get("refused") == 2 and set(third.counts) <= {"done", "kept", "refused"}
              and third.process.returncode == 1)  # fmt: skip
        done = kept | {e["job"] for e in second.ended("done")}
        wrong = done & set(third.begun)
        claim("the third run baked no finished job again", sorted(wrong), not wrong)
        claim(f"results of {good + 2} jobs", len(results(out)), len(results(out)) == good)

        fourth = run(arguments)
        claim("a final run attempts only the damaged jobs", sorted(fourth.begun),
              sorted(fourth.begun) == [f"corrupt.rubber.seed{i}" for i in range(2)])  # fmt: skip
        faults = broken(out)
        claim(f"check of {good} results", faults or "no errors", not faults)
    return claim.all


def _full_disk_kill_and_term(found: Run, event: Event, out: Path, enlarge) -> None:
    """Free disk space once it was full, then kill a bake, then end the batch."""
    if event["event"] not in ("started", "finished"):
        return
    full = [e for e in found.ended("failed", "refused") if "space" in json.dumps(e)]
    if len(full) >= FULL and "room" not in found.done:
        found.done["room"] = len(found.ended("done"))
        enlarge(LARGE)
    since = len(found.ended("done")) - found.done.get("room", len(found.ended("done")))
    if since >= 5 and "killed" not in found.done and event["event"] == "started":
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
    arguments = [
        manifest(folder, seeds, 1),
        "--output",
        out,
        "--scheduler",
        f"tcp://127.0.0.1:{PORT}",
    ]
    good = 9 * seeds
    with cluster(folder, PORT) as workers:

        def disturb(found: Run, event: Event) -> None:
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

        first = run(arguments, disturb)
        ended = workers[0].poll()
        claim("a worker was killed", ended, ended == -signal.SIGKILL)
        claim("SIGTERM: exit status", first.process.returncode, first.process.returncode == 143)
        left = none_left(out)
        claim("SIGTERM: seconds until no bake was left", figure(left), left is not None)
        second = run(arguments)
        twice = [job for job, n in first.begun.items() if n > 1]
        claim("a job of the dead worker was started again", twice, bool(twice))
        kept = {e["job"] for e in first.ended("done")}
        wrong = kept & set(second.begun)
        claim("the second run baked no finished job again", sorted(wrong), not wrong)
        claim("only the damaged asset failed", second.counts,
              second.counts.get("refused") == 1
              and set(second.counts) <= {"done", "kept", "refused"})  # fmt: skip
        claim(f"results of {good + 1} jobs", len(results(out)), len(results(out)) == good)
        third = run(arguments)
        claim("a final run attempts only the damaged jobs", sorted(third.begun),
              sorted(third.begun) == ["corrupt.rubber"])  # fmt: skip
    faults = broken(out)
    claim(f"check of {good} results", faults or "no errors", not faults)
    return claim.all


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all and print what came of them."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--seeds", type=int, default=22, help="9 jobs each on this machine")
    parser.add_argument("--few", type=int, default=2, help="9 jobs each for Dask and OpenJD")
    parser.add_argument("--only", default="local,dask,openjd")
    args = parser.parse_args(arguments)
    few = args.few
    engines = {"local": (local, args.seeds), "dask": (dask, few), "openjd": (openjd, few)}
    claims: list[Claim] = []
    seconds: dict[str, float] = {}
    for name in args.only.split(","):
        engine, seeds = engines[name]
        print(name, file=sys.stderr)
        began = time.monotonic()
        with tempfile.TemporaryDirectory(prefix="gf-usd-night-") as folder:
            claims += engine(Path(folder), seeds)
        seconds[name] = round(time.monotonic() - began, 1)
    if args.json:
        rows = [asdict(claim) for claim in claims]
        print(json.dumps({"claims": rows, "seconds": seconds, "jobs": 9 * args.seeds + 2}))
    sys.exit(0 if all(claim.holds for claim in claims) else 1)


if __name__ == "__main__":
    main()
