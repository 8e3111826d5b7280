"""Bake every asset of a folder with few particles and frames, and list the results.

    python -m tools.acceptance.bake_assets FOLDER [--write FILE.md] [--particles N] [--frames N]
    python -m tools.acceptance.bake_assets FOLDER --plain [--material NAME] [--only TEXT]...
                                                  [--patience SECONDS]
                                                  [--rows FILE] [--kept] [--json]

Every file except pictures and texts is baked in a separate process, and the result is checked. A
file must be baked, or refused with a message and a hint. Anything else is a failure, and so are
changed bytes of a file in the folder, inverted particles and repeated frames. With --plain the
numbers of particles and frames are the defaults. Each outcome is appended to the FILE of --rows,
with the day and the commit; assets that are in it already are not baked again. Exit status 1 if
there was a failure.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from tools.acceptance.record import git
from tools.bench.commands import children_cpu

SIDECARS = (".png", ".jpg", ".jpeg", ".exr", ".mtl", ".bin", ".md", ".txt", ".json")
BEGIN, END = "<!-- table -->\n", "<!-- end of table -->\n"
PATIENCE = 600.0  # [s] for one asset of few particles and frames
REFUSED = 3  # the exit status of gf-usd for an input that it refuses


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of one asset."""

    asset: str  # relative to the folder
    ending: str  # baked | refused | failed
    words: str  # bodies and notes, or the reason and the hint
    seconds: float  # of the CPU, that of the check left out
    date: str = ""  # ISO 8601, UTC
    commit: str = ""  # of which it was baked


def assets(folder: Path) -> list[Path]:
    """Every file that could be meant to be baked, in order."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return sorted(path for path in files if path.suffix.lower() not in SIDECARS)


def digests(folder: Path) -> dict[str, str]:
    """sha256 of every file."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def gf_usd(*arguments: str, patience: float) -> tuple[int, str, str]:
    """Exit status, stdout and stderr of the program; a signal or the time limit is status -1."""
    try:
        done = subprocess.run(
            [sys.executable, "-m", "gf_usd", *arguments],
            capture_output=True,
            text=True,
            timeout=patience,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return -1, "", f"error: it took longer than {patience:g} s"
    return done.returncode, done.stdout, done.stderr


def bake(
    path: Path, folder: Path, out: Path, options: Sequence[str], patience: float = PATIENCE
) -> Outcome:
    """Bake one asset into a folder of its own, and check what was written."""
    name = str(path.relative_to(folder))
    target = out / name.replace("/", "_")
    target.mkdir()
    began = children_cpu()
    status, stdout, stderr = gf_usd(
        "bake", str(path), "-o", f"{target}/", "--events", "-", "--quiet", *options,
        patience=patience,
    )  # fmt: skip
    seconds = children_cpu() - began
    events = {event["event"]: event for event in map(json.loads, stdout.splitlines())}
    if status == 0:
        ending, message = _checked(events["finished"], patience)
    elif "error" in events:
        refused = status == REFUSED and events["error"]["hint"] and not any(target.iterdir())
        ending = "refused" if refused else "failed"
        message = _reason(events["error"], path, folder)
    else:
        ending, message = "failed", (stderr.strip() or "no message").splitlines()[-1]
    return Outcome(asset=name, ending=ending, words=message, seconds=seconds)


def _checked(result: dict[str, Any], patience: float) -> tuple[str, str]:
    report = json.loads(Path(str(result["report"])).read_text(encoding="utf-8"))
    status, stdout, _ = gf_usd("check", str(result["root"]), "--json", patience=patience)
    found = [f for f in json.loads(stdout)["findings"] if f["severity"] == "error"]
    ours = report["check"]
    bodies = len(report["bodies"])
    message = f"{bodies} mesh{'es' if bodies > 1 else ''}, {result['particles']} particles"
    if embedded := len(report["embedded"]):
        message += f", {embedded} not filled"
    if found and not ours:
        message += f"; check: {len(found)} error{'s' if len(found) > 1 else ''} of the source's own"
    if ours or (status != 0 and not found):
        return "failed", f"check: {ours or found}"
    worst = [_worst(one["health"]) for one in report["bakes"]]
    if inverted := max(inverted for inverted, _ in worst):
        return "failed", f"{message}; {inverted} particles inside out"
    if redone := sum(redone for _, redone in worst):
        return "failed", f"{message}; {redone} frames redone"
    return "baked", message


def _worst(health: dict[str, Any]) -> tuple[int, int]:
    return int(health["inverted_max"]), int(health["rollbacks"])


def _reason(error: dict[str, str], path: Path, folder: Path) -> str:
    """Message and hint on one line, with the asset by its name."""
    text = f"{error['message'].strip()}. Hint: {error['hint'].strip()}"
    for long in (f"{path.absolute()}", f"{path}", f"{folder.absolute()}/", f"{folder}/"):
        text = text.replace(long, path.name if long.endswith(path.name) else "")
    return " ".join(text.split())


def table(outcomes: Sequence[Outcome]) -> str:
    """The outcomes in Markdown."""
    rows = ["| asset | | CPU s | |", "|---|---|---|---|"]
    for one in outcomes:
        message = one.words.replace("|", "\\|")
        rows.append(f"| `{one.asset}` | {one.ending} | {one.seconds:.0f} | {message} |")
    return "\n".join(rows) + "\n"


def earlier(file: Path | None) -> dict[str, Outcome]:
    """What a file of rows has, by asset; none where it is not there yet."""
    if file is None or not file.exists():
        return {}
    rows = [Outcome(**json.loads(line)) for line in file.read_text("utf-8").splitlines()]
    return {one.asset: one for one in rows}


def write_table(path: Path, outcomes: Sequence[Outcome]) -> None:
    """Put the table between the two comments of a Markdown file that mark its place."""
    head, mark, rest = path.read_text(encoding="utf-8").partition(BEGIN)
    _, end, tail = rest.partition(END)
    if not (mark and end):
        raise SystemExit(f"{path} has no {BEGIN.strip()} and {END.strip()}")
    path.write_text(head + mark + table(outcomes) + end + tail, encoding="utf-8")


def main() -> int:
    """Bake them all; the exit status."""
    parser = argparse.ArgumentParser(description="Bake every asset of a folder.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--write", type=Path, help="replace the table in this Markdown file")
    parser.add_argument("--particles", type=int, default=600)
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--plain", action="store_true", help="neither of the two")
    parser.add_argument("--material", help="a preset instead of what the files say")
    parser.add_argument("--only", action="append", default=[], help="files with this in their path")
    parser.add_argument(
        "--patience", type=float, default=PATIENCE, metavar="SECONDS", help="for one asset"
    )
    parser.add_argument("--rows", type=Path, help="JSON lines of the outcomes, to continue from")
    parser.add_argument("--kept", action="store_true", help="bake nothing")
    parser.add_argument("--json", action="store_true", help="print the outcomes as JSON at the end")
    args = parser.parse_args()
    folder: Path = args.folder
    few = ("--particles", str(args.particles), "--frames", str(args.frames))
    options = () if args.plain else few
    if args.material:
        options = (*options, "--material", args.material)
    before, there = digests(folder), earlier(args.rows)
    outcomes = []
    with tempfile.TemporaryDirectory() as out:
        for path in assets(folder):
            if args.only and not any(text in str(path) for text in args.only):
                continue
            if one := there.get(str(path.relative_to(folder))):
                outcomes.append(one)
                continue
            if args.kept:
                continue
            one = bake(path, folder, Path(out), options, args.patience)
            date = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
            one = replace(one, date=date, commit=git("rev-parse", "HEAD"))
            outcomes.append(one)
            if args.rows:
                with args.rows.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(one)) + "\n")
            print(
                f"{one.ending:8} {one.seconds:5.1f} s  {one.asset}: {one.words}",
                file=sys.stderr if args.json else sys.stdout, flush=True,
            )  # fmt: skip
    changed = [name for name, digest in digests(folder).items() if before.get(name) != digest]
    for name in changed:
        print(f"failed: {name} changed", file=sys.stderr if args.json else sys.stdout)
    if args.write:
        write_table(args.write, outcomes)
    if args.json:
        print(json.dumps({"outcomes": [asdict(one) for one in outcomes], "changed": changed}))
    return int(bool(changed) or any(one.ending == "failed" for one in outcomes))


if __name__ == "__main__":
    sys.exit(main())
