"""Run the long acceptance sections, and record the results.

    python tools/acceptance.py [--only SECTION]... [--assets FOLDER] [--page]

Every section of SECTIONS runs and leaves docs/acceptance/DATE-SECTION.json; docs/acceptance.md is
made again from the newest of each.  The sections limbs and assets need the folder of their assets,
and are omitted without it. With --recorded FILE the rows of that record are kept for limbs, and
with --rows FILE those of that file for assets: only missing rows are baked, with --kept none. With
--quick the section verify runs the quick form of its cases. Records contain no paths of the
machine.  Exit status 1 if a section failed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from tools.acceptance.record import PAGE, ROOT, Outcome, newest, page, record, save, write

LIMBS, ASSETS, JITTER, PLASTIC = "limbs", "assets", "jitter", "plastic"
OF_ASSETS = (LIMBS, ASSETS)  # sections that need a folder of assets
FLOWS = ("uniaxial", "expansion", "slump", "membrane", "taylor", "taylor-f64", "rim")  # of `verify`


@dataclass(frozen=True, kw_only=True)
class Section:
    """A long run: the command a person would type, and how to read what it prints."""

    title: str
    command: tuple[str, ...]
    read: Callable[[subprocess.CompletedProcess[str]], Outcome]


def of_cases(names: Sequence[str]) -> tuple[str, ...]:
    """The arguments of `gf-usd verify` that choose cases."""
    return tuple(word for name in names for word in ("--case", name))


def figure(value: float | None) -> str:
    """A number of the table; a figure that is no number is named as such."""
    return "none" if value is None else f"{value:.5g}"


def printed(done: subprocess.CompletedProcess[str], tool: str) -> Any:
    """The JSON on the last line that a tool of this folder printed.

    Raises SystemExit where it printed nothing: it did not run.
    """
    if not done.stdout:
        raise SystemExit(
            f"tools/acceptance/{tool}.py printed nothing, exit status {done.returncode}"
        )
    return json.loads(done.stdout.splitlines()[-1])


def read_verify(done: subprocess.CompletedProcess[str]) -> Outcome:
    """The figures of `gf-usd verify --json`.

    Raises SystemExit where it printed none: it did not run.
    """
    if not done.stdout:
        raise SystemExit(f"gf-usd verify printed nothing, exit status {done.returncode}")
    cases = json.loads(done.stdout)["cases"]
    failed = [case["name"] for case in cases if not case["pass"]]
    names = {case["case"] for case in cases}
    summary = f"{len(cases) - len(failed)} of {len(cases)} figures in {len(names)} cases"
    if failed:
        summary += f"; failed: {', '.join(failed)}"
    rows = [
        (
            case["name"] + (f" [{case['unit']}]" if case["unit"] else ""),
            figure(case["value"]),
            f"{'at least ' if case['kind'] == 'at least' else ''}{figure(case['target'])}",
            figure(case["error"]),
            f"{figure(case['bound'])} {case['kind'] if case['kind'] == 'relative' else ''}".strip(),
            "pass" if case["pass"] else "**FAIL**",
        )
        for case in cases
    ]
    head = ("figure", "ours", "target", "error", "bound", "verdict")
    return Outcome(
        passed=done.returncode == 0 and not failed,
        summary=summary,
        table=(head, *rows),
        data={"cases": cases},
    )


def read_endurance(done: subprocess.CompletedProcess[str]) -> Outcome:
    """What `python -m tools.acceptance.endurance --json` found."""
    if not done.stdout:
        raise SystemExit(
            f"tools.acceptance.endurance printed nothing, exit status {done.returncode}"
        )
    runs = json.loads(done.stdout.splitlines()[-1])["runs"]
    bad = [r["name"] for r in runs if not r["sound"]]
    head = ("run", "frames", "repeated", "inverted", "farthest [r]", "motion at the end", "verdict")
    rows = [
        (
            r["name"],
            f"{r['frames']} of {r['requested']}",
            str(r["rollbacks"]),
            f"{r['inverted']} particle-frames",
            f"{r['farthest']:.2f}",
            f"{r['kinetic_end']:.2g} m g r",
            "pass" if r["sound"] else f"**FAIL** {r['fault']}",
        )
        for r in runs
    ]
    return Outcome(
        passed=not bad,
        summary=f"{len(runs) - len(bad)} of {len(runs)} runs sound"
        + (f"; not {', '.join(bad)}" if bad else ""),
        table=(head, *rows),
        data={"runs": runs},
    )


def read_batch(done: subprocess.CompletedProcess[str]) -> Outcome:
    """What `python -m tools.acceptance.batch --json` found."""
    tree = printed(done, "batch")
    claims = tree["claims"]
    bad = [c["claim"] for c in claims if not c["holds"]]
    times = ", ".join(f"{name} {seconds:.0f} s" for name, seconds in tree["seconds"].items())
    rows = [
        (c["engine"], c["claim"], c["found"], "pass" if c["holds"] else "**FAIL**") for c in claims
    ]
    return Outcome(
        passed=not bad,
        summary=f"{len(claims) - len(bad)} of {len(claims)} claims held ({times})"
        + (f"; not: {', '.join(bad)}" if bad else ""),
        table=(("engine", "claim", "found", "verdict"), *rows),
        data=tree,
    )


def read_kills(done: subprocess.CompletedProcess[str]) -> Outcome:
    """What `python -m tools.acceptance.kills --json` found."""
    tree = printed(done, "kills")
    kills, rows = tree["kills"], []
    for phase, phase_text in (
        ("start", "before the first clip"),
        ("clips", "after a clip, before the last one"),
        ("results", "after the last clip, while the results are renamed"),
    ):
        of = [k for k in kills if k["target"]["phase"] == phase]
        clips = [k["clips"] for k in of]
        faults = [k["fault"] for k in of if k["fault"]]
        rows.append(
            (
                phase_text,
                str(len(of)),
                f"{min(clips, default=0)} to {max(clips, default=0)}",
                str(sum(any("checkpoint" in name for name in k["final"]) for k in of)),
                str(sum(any("checkpoint" not in name for name in k["final"]) for k in of)),
                str(sum(k["ended"] for k in of)),
                f"**FAIL** {'; '.join(faults)}" if faults else "pass",
            )
        )
    sound = sum(not k["fault"] for k in kills)
    met = sum(not k["ended"] and k["clips"] > 0 for k in kills)
    head = (
        "moment", "kills", "clips there", "checkpoint there", "results there",
        "bake already over", "verdict",
    )  # fmt: skip
    return Outcome(
        passed=done.returncode == 0 and sound == len(kills),
        summary=f"{len(kills)} kills, {met} of them in a bake that had clips and was not over;"
        f" after {sound} of {len(kills)} every file under a final name was whole and checked, and"
        " --resume ended with the bits of a bake that nobody killed",
        table=(head, *rows),
        data=tree,
    )


def read_jitter(done: subprocess.CompletedProcess[str]) -> Outcome:
    """What `python -m tools.acceptance.jitter --json` found."""
    tree = printed(done, "jitter")
    rows = []
    for scene in dict.fromkeys(ran["scene"] for ran in tree["runs"]):
        runs = [ran for ran in tree["runs"] if ran["scene"] == scene]
        faults = [f"{ran['number']}: {ran['fault']}" for ran in runs if ran["fault"]]
        seen = [ran["figures"] for ran in runs if ran["figures"]]
        rows.append(
            (
                scene,
                str(len(runs)),
                figure(min((f["min_J"] for f in seen), default=None)),
                figure(max((f["deepest_penetration_spacings"] for f in seen), default=None)),
                figure(max((f["deepest_overlap_spacings"] for f in seen), default=None)),
                figure(max((f["energy_gain_max_share"] for f in seen), default=None)),
                str(sum(bool(ran["warnings"]) for ran in runs)),
                f"**FAIL** {'; '.join(faults)}" if faults else "pass",
            )
        )
    bad = [ran for ran in tree["runs"] if ran["fault"]]
    head = (
        "scene", "runs", "smallest J", "deepest in the floor [spacings]",
        "deepest overlap [spacings]", "largest gain of energy in a frame", "with a warning",
        "verdict",
    )  # fmt: skip
    return Outcome(
        passed=done.returncode == 0 and not bad,
        summary=f"{len(tree['runs']) - len(bad)} of {len(tree['runs'])} jittered bakes were"
        " without a finding of check, and without a warning that the original scene does not have",
        table=(head, *rows),
        data=tree,
    )


def read_limbs(done: subprocess.CompletedProcess[str]) -> Outcome:
    """What `python -m tools.acceptance.limbs --json` found."""
    runs = printed(done, "limbs")["runs"]
    rows = []
    for ran in runs:
        seen = ran["figures"] or {}
        inside = "none" if ran["inside"] is None else f"{100.0 * ran['inside']:.2f} %"
        at_rest = ran.get("at_rest")
        rows.append(
            (
                ran["asset"], ran["look"], str(ran["particles"]), inside,
                "none" if at_rest is None else f"{100.0 * at_rest:.2f} %",
                figure(seen.get("min_J")), str(seen.get("inverted_max", "none")),
                str(seen.get("rollbacks", "none")),
                figure(seen.get("deepest_overlap_spacings")),
                " ".join((ran.get("date", "")[:10], f"`{ran.get('commit', '')[:12]}`")),
                f"**FAIL** {ran['fault']}" if ran["fault"] else "pass",
            )
        )  # fmt: skip
    bad = [f"{ran['asset']} {ran['look']}" for ran in runs if ran["fault"]]
    head = (
        "asset", "look", "particles", "inside at the end", "inside at rest", "smallest J",
        "inverted", "repeated", "deepest overlap [spacings]", "baked", "verdict",
    )  # fmt: skip
    return Outcome(
        passed=done.returncode == 0 and not bad,
        summary=f"{len(runs) - len(bad)} of {len(runs)} bakes of assets with limbs warned of"
        " nothing, and at most 1 % of their surface is inside a body at the end and not at rest"
        + (f"; not: {', '.join(bad)}" if bad else ""),
        table=(head, *rows),
        data={"runs": runs},
    )


def read_assets(done: subprocess.CompletedProcess[str]) -> Outcome:
    """What `python -m tools.acceptance.bake_assets --json` found."""
    tree = printed(done, "bake_assets")
    ended = [one["ending"] for one in tree["outcomes"]]
    faults = [one["asset"] for one in tree["outcomes"] if one["ending"] == "failed"]
    faults += [f"{name} changed" for name in tree["changed"]]
    rows = [
        (
            f"`{one['asset']}`", f"{one['seconds']:.0f}", one["words"].replace("|", "\\|"),
            f"{one['date'][:10]} `{one['commit'][:12]}`",
            "**FAIL**" if one["ending"] == "failed" else one["ending"],
        )
        for one in tree["outcomes"]
    ]  # fmt: skip
    return Outcome(
        passed=done.returncode == 0 and not faults,
        summary=f"{ended.count('baked')} baked without particles inside out and without frames"
        f" redone, {ended.count('refused')} refused in words, {ended.count('failed')} failed"
        + (f": {', '.join(faults)}" if faults else ""),
        table=(("asset", "CPU s", "", "baked", "verdict"), *rows),
        data=tree,
    )


def read_tests(done: subprocess.CompletedProcess[str]) -> Outcome:
    """The summary of `pytest -rA`."""
    verdicts = ("PASSED", "FAILED", "ERROR")
    lines = [line.split(" ", 1) for line in done.stdout.splitlines()]
    rows = [
        (f"`{line[1].partition(' - ')[0]}`", "pass" if line[0] == "PASSED" else "**FAIL**")
        for line in lines
        if line[0] in verdicts and len(line) == 2 and "::" in line[1]
    ]
    bad = [name for name, verdict in rows if verdict != "pass"]
    return Outcome(
        passed=done.returncode == 0 and not bad and bool(rows),
        summary=f"{len(rows) - len(bad)} of {len(rows)} tests passed"
        + (f"; not {', '.join(bad)}" if bad else ""),
        table=(("test", "verdict"), *sorted(rows)),
        data={"tests": dict(rows)},
    )


SECTIONS: dict[str, Section] = {
    "tests": Section(
        title="The longest tests",
        command=("python", "-m", "pytest", "-m", "acceptance", "-rA"),
        read=read_tests,
    ),
    "batch": Section(
        title="A batch with injected failures",
        command=("python", "-m", "tools.acceptance.batch", "--json"),
        read=read_batch,
    ),
    JITTER: Section(
        title="Randomized samples",
        command=("python", "-m", "tools.acceptance.jitter", "--json"),
        read=read_jitter,
    ),
    "kills": Section(
        title="kill -9 of a bake",
        command=("python", "-m", "tools.acceptance.kills", "--json"),
        read=read_kills,
    ),
    "verify": Section(
        title="Accuracy",
        command=("gf-usd", "verify", "--full", "--json"),
        read=read_verify,
    ),
    PLASTIC: Section(  # which the section before has, too: by name only
        title="Accuracy of plastic flow",
        command=("gf-usd", "verify", "--full", "--json", *of_cases(FLOWS)),
        read=read_verify,
    ),
    "endurance": Section(
        title="Endurance",
        command=("python", "-m", "tools.acceptance.endurance", "--json"),
        read=read_endurance,
    ),
    ASSETS: Section(
        title="Assets at defaults, of rubber",
        command=(
            "python",
            "-m",
            "tools.acceptance.bake_assets",
            "--plain",
            "--material",
            "rubber",
            "--json",
        ),
        read=read_assets,
    ),
    LIMBS: Section(
        title="Assets with limbs",
        command=("python", "-m", "tools.acceptance.limbs", "--json"),
        read=read_limbs,
    ),
}


def run(
    name: str, section: Section, more: Sequence[str] = (), shown: Sequence[str] | None = None
) -> bool:
    """Run one section and save it; whether it passed.

    more : further arguments of the command; shown : the same as they are recorded.
    """
    program, *arguments = *section.command, *more
    module = [] if program == "python" else ["-m", program.replace("-", "_")]
    interpreter = [sys.executable, *module]
    command = (*section.command, *(more if shown is None else shown))
    print(f"{name}: {' '.join(command)}", file=sys.stderr)
    began = time.perf_counter()
    done = subprocess.run(
        [*interpreter, *arguments], cwd=ROOT, stdout=subprocess.PIPE, text=True, check=False
    )
    seconds = time.perf_counter() - began
    outcome = section.read(done)
    path = save(record(name, section.title, command, seconds, outcome))
    verdict = "passed" if outcome.passed else "FAILED"
    print(f"{name}: {verdict}, {outcome.summary}; {path.relative_to(ROOT)}", file=sys.stderr)
    return outcome.passed


def arguments_of(name: str, options: argparse.Namespace) -> tuple[list[str], list[str]]:
    """Further arguments of a section's command, and the same without paths."""
    if name not in (*OF_ASSETS, JITTER):
        return [], []
    more, shown = ([str(options.assets)], ["ASSETS"]) if name in OF_ASSETS else ([], [])
    rest = {"--keep": options.keep, "--recorded": options.recorded}
    for word, value in (rest if name == LIMBS else {"--rows": options.rows}).items():
        if value:
            more += [word, str(value)]
            shown += [word, "FOLDER" if word == "--keep" else Path(value).name]
    kept = ["--kept"] if options.kept else []
    return more + kept, shown + kept


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--only", action="append", choices=sorted(SECTIONS), help="repeatable")
    parser.add_argument("--assets", metavar="FOLDER", help=f"of {' and '.join(OF_ASSETS)}")
    parser.add_argument("--keep", metavar="FOLDER", help=f"where {LIMBS} continues, if it ended")
    parser.add_argument("--recorded", metavar="FILE", help=f"record whose rows of {LIMBS} are kept")
    parser.add_argument(
        "--rows", metavar="FILE", help=f"where {ASSETS} or {JITTER} continues, if it ended"
    )
    parser.add_argument("--kept", action="store_true", help="bake nothing for these three")
    parser.add_argument("--quick", action="store_true", help="verify in its quick form")
    parser.add_argument("--page", action="store_true", help="make the page again and run nothing")
    options = parser.parse_args(arguments)
    everything = [name for name in SECTIONS if name != PLASTIC]
    chosen = [] if options.page else options.only or everything
    if options.rows and (ASSETS in chosen) == (JITTER in chosen):
        parser.error(f"--rows requires --only {ASSETS} or --only {JITTER}")
    if options.assets is None:
        for name in OF_ASSETS:
            if name in (options.only or ()):
                parser.error(f"the section {name} needs --assets")
        chosen = [name for name in chosen if name not in OF_ASSETS]
    sections = dict(SECTIONS)
    if options.quick:
        sections["verify"] = replace(SECTIONS["verify"], command=("gf-usd", "verify", "--json"))
    passed = [run(name, sections[name], *arguments_of(name, options)) for name in chosen]
    write(PAGE, page(newest()))
    sys.exit(0 if all(passed) else 1)


if __name__ == "__main__":
    main()
