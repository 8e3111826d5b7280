"""Findings of USD's own validators.

All installed validators are run, including those of plugins.  They do not check arrays and time
samples, which the rules of gf-usd do.
"""

from __future__ import annotations

from collections.abc import Iterator

from pxr import Tf, Usd, UsdValidation

from gf_usd.layers.check.base import Finding, Severity, unreadable

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
            if error.HasNoError():
                continue
            yield Finding(
                rule=f"usd:{error.GetIdentifier()}",
                severity=SEVERITIES[error.GetType()],
                prim_path=_path(error),
                message=" ".join(error.GetMessage().split()),
                fix=FIXES.get(str(error.GetName()))
                or f"follow the rule: {' '.join(metadata.doc.split())}",
            )


def _path(error: UsdValidation.ValidationError) -> str:
    """The first prim of an error; "/" for layers and the stage."""
    for site in error.GetSites():
        if site.IsPrim():
            return str(site.GetPrim().GetPath())
        if site.IsProperty():
            return str(site.GetProperty().GetPrim().GetPath())
    return "/"
