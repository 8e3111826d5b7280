"""The batch of the acceptance as a job bundle, run by the real ``openjd``."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from batch_runs import (
    ROOT,
    Claim,
    Claims,
    broken,
    figure,
    kill_a_bake,
    manifest,
    none_left,
    results,
)

CHUNK = 4  # jobs in a task
NOTICE = 30.0  # [s] that the template grants between the request to end and the end
ENDED = re.compile(r"\d+ of \d+ done; (\S+): (done|kept|refused|failed|crashed|stopped)")
BEGUN = re.compile(r"\d+ of \d+ done; (\S+): running")


@dataclass
class Session:
    """One run of a bundle, with all that its tasks said."""

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
    """The openjd beside this Python, or on the path.  Raises SystemExit where there is none."""
    beside = Path(sys.executable).with_name("openjd")
    found = str(beside) if beside.is_file() else shutil.which("openjd")
    if found is None:
        raise SystemExit("openjd is not installed: pip install openjd-cli")
    return found


def session(bundle: Path, hear: Callable[[Session], None] = lambda session: None) -> Session:
    """Run a whole bundle here; `hear` is called after every line and may do harm."""
    command = [program(), "run", bundle / "template.json", "-p", f"file://{bundle}/parameters.json"]
    process = subprocess.Popen(
        list(map(str, command)), stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        cwd=ROOT,
    )  # fmt: skip
    assert process.stdout is not None
    found, asked = Session(process), 0.0
    for line in process.stdout:
        found.lines.append(line.rstrip())
        hear(found)
        if "Interruption signal" in line:
            asked = time.monotonic()
    process.wait()
    if asked:
        found.seconds_to_end = time.monotonic() - asked
    return found


def openjd(folder: Path, seeds: int) -> list[Claim]:
    """Check, run, SIGTERM, kill, run again."""
    claim = Claims("OpenJD")
    out, bundle, good = folder / "out", folder / "bundle", 9 * seeds
    words = [manifest(folder, seeds, 1), "--out", out, "--openjd", bundle, "--chunk", CHUNK]
    subprocess.run(
        [sys.executable, "-m", "gf_usd", "batch", *map(str, words)], check=True, cwd=ROOT
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
        if len(now.jobs("done")) >= 2 and "killed" not in done:
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
