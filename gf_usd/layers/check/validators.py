"""Findings of USD's own validators.

All installed validators are run, including those of plugins.  They do not check arrays and time
samples, which the rules of gf-usd do.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from pxr import Tf, Usd, UsdGeom, UsdValidation

from gf_usd.layers.check.base import Finding, Severity, unreadable
from gf_usd.layers.usd_warnings import has_tiles

SEVERITIES: dict[UsdValidation.ValidationErrorType, Severity] = {
    UsdValidation.ValidationErrorType.Error: "error",
    UsdValidation.ValidationErrorType.Warn: "warning",
    UsdValidation.ValidationErrorType.Info: "warning",
}
FIXES = {
    "MissingDefaultPrim": "author defaultPrim in the root layer: the name of the root prim to "
    "be referenced",
    "MissingMetersPerUnitMetadata": "author metersPerUnit in the root layer",
    "MissingUpAxisMetadata": 'author upAxis = "Y" or "Z" in the root layer',
    "MissingMaterialBindingAPI": "apply MaterialBindingAPI to the prim that binds the material",
    "CompositionError": "correct the path of the layer or prim that cannot be composed",
    "UnresolvableDependency": "correct the path of the file, or put the file at that path",
}
UNOPENED = re.compile(r"Could not open asset @(.+?)@ for ")
LOST = re.compile(r"Found unresolvable external dependency '(.+)'\.")
# beginnings of documentation that says what a validator does, and states no rule
ABOUT_ITSELF = ("Validates all ", "Validator ", "Warns ")


def run_validators(stage: Usd.Stage) -> Iterator[Finding]:
    """Findings named ``usd:VALIDATOR.ERROR``, with the validator's message."""
    registry = UsdValidation.ValidationRegistry()
    # the registry has no fixed order
    for validator in sorted(registry.GetOrLoadAllValidators(), key=lambda v: v.GetMetadata().name):
        metadata = validator.GetMetadata()
        # one at a time, so that a failure of one validator does not prevent the others
        try:
            errors = UsdValidation.ValidationContext([validator]).Validate(stage)
        except Tf.ErrorException as error:
            yield unreadable(f"usd:{metadata.name}", error)
            continue
        for error in errors:
            if error.HasNoError() or _is_tiled(error):
                continue
            yield Finding(
                rule=f"usd:{error.GetIdentifier()}",
                severity=SEVERITIES[error.GetType()],
                prim_path=_path(error),
                message=" ".join(error.GetMessage().split()),
                subject=_subject(error),
                fix=_fix(stage, error, " ".join(metadata.doc.split())),
            )


def _is_tiled(error: UsdValidation.ValidationError) -> bool:
    """Whether an error is of a UDIM texture in a package, whose tiles USD does not look for."""
    lost = LOST.fullmatch(error.GetMessage())
    return bool(lost) and has_tiles(lost[1])


def _subject(error: UsdValidation.ValidationError) -> str:
    """The path of the file that cannot be found, or the property; "" for the prim or the stage."""
    message = error.GetMessage()
    if lost := LOST.fullmatch(message) or UNOPENED.match(message):
        return lost[1]
    names = (site.GetProperty().GetName() for site in error.GetSites() if site.IsProperty())
    return next(names, "")


def _fix(stage: Usd.Stage, error: UsdValidation.ValidationError, doc: str) -> str:
    """What to do about an error; doc : of its validator."""
    name, path = str(error.GetName()), _path(error)
    if name in FIXES:
        return FIXES[name]
    if name == "InvalidNestedGprims" and (above := _gprim_above(stage.GetPrimAtPath(path))):
        to = above.GetParent().GetPath().AppendChild(stage.GetPrimAtPath(path).GetName())
        return (
            f"move <{path}> out of <{above.GetPath()}>, for example to <{to}>: a prim that is drawn"
            " has no others below it; an Xform above both can hold their transform"
        )
    if doc.startswith(ABOUT_ITSELF):
        return f"correct {'the stage' if path == '/' else f'<{path}>'} as the message says"
    return f"follow the rule: {doc}"


def _gprim_above(prim: Usd.Prim) -> Usd.Prim | None:
    """The highest Gprim above a prim."""
    found, above = None, prim.GetParent()
    while above and not above.IsPseudoRoot():
        found = above if above.IsA(UsdGeom.Gprim) else found
        above = above.GetParent()
    return found


def _path(error: UsdValidation.ValidationError) -> str:
    """The first prim of an error; "/" for layers and the stage."""
    for site in error.GetSites():
        if site.IsPrim():
            return str(site.GetPrim().GetPath())
        if site.IsProperty():
            return str(site.GetProperty().GetPrim().GetPath())
    return "/"
