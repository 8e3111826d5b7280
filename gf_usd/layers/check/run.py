"""``gf-usd check``: checks a USD file for everything that can be known to be wrong.

The stage is checked as composed: with every payload loaded and the selected variants.  Also the
check at the end of every bake, for faults that the source does not have.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from pxr import Ar, Sdf, Tf, Usd

from gf_usd.core import CACHE_SUFFIX, PACKAGE_SUFFIX
from gf_usd.core.errors import InputError
from gf_usd.core.frames.choices import SOURCE_VARIANT
from gf_usd.layers.check.base import RULES, Finding, Rule, Skip, reason, unreadable
from gf_usd.layers.check.read import prims
from gf_usd.layers.check.structure import TIME_CODES
from gf_usd.layers.check.validators import run_validators
from gf_usd.layers.clips import folder_of
from gf_usd.layers.stage import VARIANT_SET
from gf_usd.layers.usd_warnings import gathered
from gf_usd.system import usd_schema  # noqa: F401  (the rules read the schema's definitions from USD)
from gf_usd.system.atomic_files import require_utf8

UNSAFE = "not run: the time codes of a layer do not advance, so reading its samples would never end"
VALIDATORS = "usd"
UNRESOLVED = ".UnresolvableDependency"  # a rule of USD
Key = tuple[str, str, str, str]


@dataclass(frozen=True, kw_only=True)
class CheckResult:
    """The result of a check."""

    path: str  # of the file
    findings: tuple[Finding, ...]  # errors first
    skipped: tuple[Skip, ...]  # checks that were not possible, and why
    inherited: tuple[Finding, ...] = ()  # for a bake: those that its source has too, errors first
    warned: tuple[str, ...] = ()  # USD's own warnings, counted
    layers: int  # number of layers that were read
    prims: int  # number of prims that were checked
    rules: int  # number of gf-usd rules that ran

    @property
    def errors(self) -> int:
        """The number of findings that are errors."""
        return sum(finding.severity == "error" for finding in self.findings)

    @property
    def warnings(self) -> int:
        """The number of findings that are warnings."""
        return len(self.findings) - self.errors

    @property
    def ok(self) -> bool:
        """No errors; warnings are allowed."""
        return self.errors == 0


def check_file(path: str | Path) -> CheckResult:
    """Check a file with USD's validators and with all rules of gf-usd.

    For a bake with variants, the faults of its source are listed separately.

    Raises
    ------
    InputError : the file does not exist, or USD cannot open it.
    """
    file = Path(path)
    if file.is_dir():
        raise InputError(f"{file} is a folder", "give the path of a usd, usda, usdc or usdz file")
    if not file.is_file():
        raise InputError(
            f"{file} does not exist", "give the path of a usd, usda, usdc or usdz file"
        )
    require_utf8(file)
    if not Usd.Stage.IsSupportedFile(str(file)):
        raise InputError(
            f"{file} does not have the suffix of a USD file",
            "give a file that ends in usd, usda, usdc or usdz",
        )
    with gathered() as warned:
        try:
            stage = Usd.Stage.Open(str(file), Usd.Stage.LoadAll)
        except Tf.ErrorException as error:
            raise InputError(
                f"{file} cannot be opened as USD: {reason(error)}",
                "export the file again; its content does not match its suffix",
            ) from error
        result = _without_source_findings(check_stage(stage), stage)
    found = (finding.message for finding in (*result.findings, *result.inherited))
    return replace(result, warned=warned.lines(stated=found))


def _without_source_findings(result: CheckResult, stage: Usd.Stage) -> CheckResult:
    """Move findings that also occur with the source selected to `inherited`.

    The result for a stage that is not a bake, or that shows the source already, is returned
    unchanged.  In a shot over bakes, findings outside the baked prims are the shot's own and are
    not moved.  A source or a value clip that cannot be found is a fault of the bake, although USD
    also finds it with the source selected.
    """
    baked = _looks(stage)
    sets = [prim.GetVariantSet(VARIANT_SET) for prim in baked]
    roots = [prim.GetPath() for prim in baked]
    layer = stage.GetRootLayer()
    if any((spec := layer.GetPrimAtPath(p)) and VARIANT_SET in spec.variantSets for p in roots):
        roots = [Sdf.Path.absoluteRootPath]
    if not result.findings or not any(one.GetVariantSelection() != SOURCE_VARIANT for one in sets):
        return result
    stage.SetEditTarget(stage.GetSessionLayer())
    for one in sets:
        one.SetVariantSelection(SOURCE_VARIANT)
    known = {_key(found) for found in check_stage(stage).findings}
    lost, clips = _of_bake(layer)
    theirs = [
        f for f in result.findings
        if _key(f) in known
        and f.subject not in lost and str(Path(f.subject).parent) not in clips
        and any(Sdf.Path(f.prim_path).HasPrefix(root) for root in roots)
    ]  # fmt: skip
    return replace(
        result,
        findings=tuple(f for f in result.findings if f not in theirs),
        inherited=tuple(theirs),
    )


def _of_bake(layer: Sdf.Layer) -> tuple[set[str], set[str]]:
    """Files whose faults are those of a bake: the layers that its root layer itself refers to and
    that do not exist, and all in the folders of value clips next to its caches.

    Returns the paths of these layers, and of these folders.
    """
    paths = [layer.ComputeAbsolutePath(path) for path in layer.GetCompositionAssetDependencies()]
    lost = {path for path in paths if not Ar.GetResolver().Resolve(path)}
    clips = {str(folder_of(Path(path))) for path in paths if path.endswith(CACHE_SUFFIX)}
    return lost, clips


def _looks(stage: Usd.Stage) -> list[Usd.Prim]:
    """The root prims of a bake that has variants."""
    return [
        prim for prim in stage.GetPseudoRoot().GetAllChildren()
        if prim.GetVariantSets().HasVariantSet(VARIANT_SET)
    ]  # fmt: skip


def check_stage(stage: Usd.Stage) -> CheckResult:
    """Check a stage as it is composed now, for example with another variant selected."""
    findings = [found for found in RULES[TIME_CODES](stage) if isinstance(found, Finding)]
    skipped: list[Skip] = []
    safe = not findings
    ran = 1
    for name, rule in RULES.items():
        if name == TIME_CODES:
            continue
        if rule.reads_samples and not safe:
            skipped.append(Skip(rule=name, prim_path="/", reason=UNSAFE))
            continue
        ran += 1
        for verdict in _judge(rule, stage):
            if isinstance(verdict, Skip):
                skipped.append(verdict)
            else:
                findings.append(verdict)
    if safe:
        findings += run_validators(stage)
    else:
        skipped.append(Skip(rule=VALIDATORS, prim_path="/", reason=UNSAFE))
    findings.sort(key=lambda finding: finding.severity != "error")
    return CheckResult(
        path=stage.GetRootLayer().realPath or stage.GetRootLayer().identifier,
        findings=tuple(findings),
        skipped=tuple(skipped),
        layers=len(stage.GetUsedLayers()),
        prims=sum(1 for _ in prims(stage)),
        rules=ran,
    )


def _judge(rule: Rule, stage: Usd.Stage) -> Iterable[Finding | Skip]:
    """The findings of a rule; if USD fails to read a value, that is the finding."""
    try:
        yield from rule(stage)
    except Tf.ErrorException as error:
        yield unreadable(rule.name, error)


def review(root: Path, source: Path) -> list[dict[str, str]]:
    """Errors in every variant of a root layer, except those that its source has too.

    Findings with the same severity, rule, prim and subject are the same: the numbers in their texts
    may differ.
    """
    # a package has the names alone of files that cannot be found
    named = root.suffix == PACKAGE_SUFFIX
    known = {_key(f, named=named) for f in check_file(source).findings}
    stage = Usd.Stage.Open(str(root), Usd.Stage.LoadAll)
    prims = _looks(stage)
    # a flattened bake has no material variants: it is checked unchanged
    sets = [p.GetVariantSet(VARIANT_SET) for p in prims]
    names = sorted({name for s in sets for name in s.GetVariantNames()}) or [""]
    stage.SetEditTarget(stage.GetSessionLayer())
    seen: dict[Key, dict[str, str]] = {}
    for name in names:
        for prim in prims:
            prim.GetVariantSet(VARIANT_SET).SetVariantSelection(name)
        found = [(_key(f, named=named), f) for f in check_stage(stage).findings]
        lost: set[str] = set()
        if named and any(key in known and f.rule.endswith(UNRESOLVED) for key, f in found):
            lost = _lost_files(stage, Usd.Stage.Open(str(source), Usd.Stage.LoadAll))
        for key, finding in found:
            theirs = key in known and not (finding.rule.endswith(UNRESOLVED) and key[-1] in lost)
            if finding.severity == "error" and not theirs:
                seen.setdefault(key, _plain(finding))
    return list(seen.values())


def _lost_files(package: Usd.Stage, source: Usd.Stage) -> set[str]:
    """The names of files that attributes of a package do not find, while the same attributes of the
    source find theirs.

    As composed: a package has only the selected variants of its source.
    """
    out: set[str] = set()
    for prim in prims(package):
        for attribute in prim.GetAuthoredAttributes():
            if same := source.GetAttributeAtPath(attribute.GetPath()):
                out |= {
                    mine.path
                    for mine, theirs in zip(_asset_paths(attribute), _asset_paths(same))
                    if mine.path and not mine.resolvedPath and theirs.resolvedPath
                }
    return out


def _asset_paths(attribute: Usd.Attribute) -> Iterator[Sdf.AssetPath]:
    """The asset paths of an attribute, over all its samples.

    `_resolved` of `readers/inputs.py` has the same loop: neither package imports the other, and the
    only module below both that may import pxr registers the schema.
    """
    if attribute.GetTypeName().scalarType != Sdf.ValueTypeNames.Asset:
        return
    for time in attribute.GetTimeSamples() or [Usd.TimeCode.Default()]:
        value = attribute.Get(time)
        yield from [value] if isinstance(value, Sdf.AssetPath) else value or ()


def _key(finding: Finding, *, named: bool = False) -> Key:
    """What findings of a bake and of its source have in common.

    With the severity: a mesh without an extent is a warning, a bake's wrong extent an error.

    named : files that cannot be found are the same where their names are.
    """
    subject = finding.subject
    if named and finding.rule.endswith(UNRESOLVED):
        subject = Path(subject.rstrip("]").rpartition("[")[2]).name
    return finding.severity, finding.rule, str(finding.prim_path), subject


def _plain(finding: Finding) -> dict[str, str]:
    return {
        "rule": finding.rule,
        "prim": str(finding.prim_path),
        "message": finding.message,
        "fix": finding.fix,
    }
