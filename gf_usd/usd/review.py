"""The check that every bake ends with: faults of the result that its source does not have."""

from __future__ import annotations

from pathlib import Path

from pxr import Usd

from gf_usd.usd.check import check_file, check_stage
from gf_usd.usd.rules.base import Finding
from gf_usd.usd.stage import VARIANT_SET


def review(root: Path, source: Path) -> list[dict[str, str]]:
    """Errors in every variant of a root layer, less those that are in its source already.

    A finding is the same where rule and prim agree: numbers in its words may differ.
    """
    known = {_key(f) for f in check_file(source).findings}
    stage = Usd.Stage.Open(str(root), Usd.Stage.LoadAll)
    prims = [p for p in stage.GetPseudoRoot().GetAllChildren()
             if p.GetVariantSets().HasVariantSet(VARIANT_SET)]  # fmt: skip
    # a flattened bake has no variants of looks: it is checked as it is
    sets = [p.GetVariantSet(VARIANT_SET) for p in prims]
    names = sorted({name for s in sets for name in s.GetVariantNames()}) or [""]
    stage.SetEditTarget(stage.GetSessionLayer())
    seen: dict[tuple[str, str], dict[str, str]] = {}
    for name in names:
        for prim in prims:
            prim.GetVariantSet(VARIANT_SET).SetVariantSelection(name)
        for finding in check_stage(stage).findings:
            if finding.severity == "error" and _key(finding) not in known:
                seen.setdefault(_key(finding), _plain(finding))
    return list(seen.values())


def _key(finding: Finding) -> tuple[str, str]:
    return finding.rule, str(finding.prim_path)


def _plain(finding: Finding) -> dict[str, str]:
    return {
        "rule": finding.rule,
        "prim": str(finding.prim_path),
        "message": finding.message,
        "fix": finding.fix,
    }
