"""Make docs/verification.md and its plots from the newest acceptance run of `gf-usd verify`.

    python -m tools.acceptance.verify_page [--check]

With --check nothing is written; exit status 1 if anything would change.
"""

from __future__ import annotations

import argparse
import re
import sys
from itertools import groupby
from pathlib import Path
from typing import Any

from tools.acceptance.plot import svg
from tools.acceptance.record import ROOT, newest, write

PAGE = ROOT / "docs" / "verification.md"
IMAGES = ROOT / "docs" / "images"


def number(value: float | None) -> str:
    return "none" if value is None else f"{value:.5g}"


def percent(row: dict[str, Any], key: str) -> str:
    """An error or a bound: relative ones in per cent, others in the figure's own unit."""
    if row[key] is not None and row["kind"] == "relative":
        return f"{100.0 * row[key]:.3g} %"
    return number(row[key])


def slug(title: str) -> str:
    return "verify-" + re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")


def case_lines(rows: list[dict[str, Any]], plots: dict[str, str]) -> list[str]:
    """The part of one case; its plots are added to `plots`, by file name."""
    first = rows[0]
    lines = [
        f"## {first['case']}",
        "",
        first["what"],
        "",
        f"Source: {first['source']}.",
        "",
        "| figure | ours | target | error | bound | |",
        "|---|--:|--:|--:|--:|---|",
    ]
    for row in rows:
        least = "at least " if row["kind"] == "at least" else ""
        lines.append(
            f"| {row['name'].partition('.')[2]} | {number(row['value'])} {row['unit']} |"
            f" {least}{number(row['target'])} | {percent(row, 'error')} | {percent(row, 'bound')} |"
            f" {'pass' if row['pass'] else '**FAIL**'} |"
        )
    lines.append("")
    for why, group in groupby(rows, key=lambda row: row["why"]):
        names = ", ".join(row["name"].partition(".")[2] for row in group)
        lines.append(f"- {names}: {why}.")
    curves = {
        row["curve"]["title"]: row["curve"]
        for row in rows
        if "curve" in row and len(row["curve"]["x"]) > 1
    }
    if curves:
        lines.append("")
    for title, curve in curves.items():
        name = f"{slug(title)}.svg"
        plots[name] = svg(curve)
        lines.append(f"![{title}](images/{name})")
    return [*lines, ""]


def pages(record: dict[str, Any]) -> dict[Path, str]:
    """Every file of the page."""
    rows = record["outcome"]["data"]["cases"]
    plots: dict[str, str] = {}
    state = record["commit"][:12] + (" with changes" if record["changed"] else "")
    forms = (
        "  `gf-usd verify` runs the quick form of the same cases, `gf-usd verify --full` this one."
        if "--full" in record["command"]
        else "  This is the quick form; `gf-usd verify --full` has finer grids and longer runs of"
        " the same cases."
    )
    lines = [
        "# Verification",
        "",
        "All verification cases with reference, figures and the reason of each bound.  Made"
        f" by `tools/acceptance/verify_page.py` from the run of {record['date'][:10]} (commit"
        f" `{state}`, {record['machine']}, {record['seconds']:.0f} s):"
        f" {record['outcome']['summary']}.{forms}",
        "",
    ]
    for _, group in groupby(rows, key=lambda row: row["case"]):
        lines += case_lines(list(group), plots)
    files = {PAGE: "\n".join(lines)}
    return files | {IMAGES / name: drawing for name, drawing in plots.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--check", action="store_true", help="write nothing; fail on a difference")
    check = parser.parse_args().check
    runs = [record for record in newest() if record["section"] == "verify"]
    if not runs:
        raise SystemExit("no run of the section verify in docs/acceptance: tools/acceptance.py")
    stale = [
        path
        for path, text in pages(runs[0]).items()
        if not path.exists() or path.read_text("utf-8") != text
    ]
    for path in stale:
        print(f"{'differs' if check else 'wrote'}: {path.relative_to(ROOT)}", file=sys.stderr)
        if not check:
            write(path, pages(runs[0])[path])
    sys.exit(1 if check and stale else 0)


if __name__ == "__main__":
    main()
