"""Generate the schema library and its reference from schemas/gaussianFlesh/schema.usda.

The tokens of gaussianFlesh:law and the attributes of the laws' parameters come from the rows of
gf_usd.core.materials.laws.LAWS.

    python tools/generate_schema.py            write generatedSchema.usda, plugInfo.json, schema.md
    python tools/generate_schema.py --check    write nothing; exit 1 if any of them differs

usd-core's own generator does the work.  It leaves placeholders for a build system in plugInfo.json;
they are replaced by the paths of a library whose files lie side by side.
"""

from __future__ import annotations

import argparse
import difflib
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pxr
from pxr import Sdf

from gf_usd.core.materials.laws import LAWS, Parameter, law_internals, law_parameters

ROOT = Path(__file__).resolve().parent.parent
LIBRARY = ROOT / "schemas" / "gaussianFlesh"
REFERENCE = ROOT / "docs" / "schema.md"
PLACEHOLDERS = {
    "@PLUG_INFO_ROOT@": ".",
    "@PLUG_INFO_RESOURCE_PATH@": ".",
    "@PLUG_INFO_LIBRARY_PATH@": "",
}
INTRODUCTION = """\
<!-- Written by tools/generate_schema.py from schemas/gaussianFlesh/schema.usda: do not edit. -->

# The schema library `gaussianFlesh`

Six API schemas, applied to prims of standard types, hold data that USD's own schemas do not cover.
A file that uses them opens in every USD program: without the library its attributes stay readable,
only the names of the APIs are unknown. `gf-usd schema-path` prints the folder to add to
`PXR_PLUGINPATH_NAME`, which makes the library known to other programs.

Units are those of the stage: a distance counts `metersPerUnit`, a mass `kilogramsPerUnit`; times
are seconds, never time codes. Attributes that are not authored have the fallback shown here; a dash
means no value.
"""


def run_generator(schema: Path, folder: Path) -> None:
    """Run usdGenSchema on ``schema`` into the empty ``folder``.

    It is run by file path, since as a module it fails; and with no other plugin in sight, so that
    an installed copy of this very library cannot take part.
    """
    generator = Path(pxr.__path__[0]) / "Usd" / "usdGenSchema.py"
    environment = {k: v for k, v in os.environ.items() if k != "PXR_PLUGINPATH_NAME"}
    done = subprocess.run(
        [sys.executable, str(generator), str(schema), str(folder)],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    if done.returncode or not (folder / "generatedSchema.usda").is_file():
        raise SystemExit(f"usdGenSchema failed on {schema}:\n{done.stdout}{done.stderr}")


def filled_plug_info(text: str) -> str:
    """``text`` of plugInfo.json with every build placeholder replaced."""
    for placeholder, value in PLACEHOLDERS.items():
        text = text.replace(placeholder, value)
    if left := re.findall(r"@[A-Z_]+@", text):
        raise SystemExit(f"plugInfo.json: unknown placeholders: {left}")
    return text


# of StageUnits.factor -> as the reference has them
UNITS = {
    "": "none",
    "s": "second",
    "1/s": "1 / second",
    "Pa": "mass / (distance * second^2)",
    "Pa s": "mass / (distance * second)",
}


def with_laws(schema: Path) -> Sdf.Layer:
    """The layer of ``schema`` with the rows of LAWS in it."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(Sdf.Layer.FindOrOpen(str(schema)))
    material = layer.GetPrimAtPath("/GaussianFleshMaterialAPI")
    law = material.attributes["gaussianFlesh:law"]
    law.allowedTokens = list(LAWS)
    law.documentation = law.documentation.rstrip() + " " + ", ".join(LAWS)
    particles = layer.GetPrimAtPath("/GaussianFleshParticlesAPI")
    for one in law_parameters():
        _add(material, one, Sdf.ValueTypeNames.Float).default = one.default
        _add(particles, one, Sdf.ValueTypeNames.FloatArray)
    for variable in law_internals():
        name = f"gaussianFlesh:{variable.attribute}"
        made = Sdf.AttributeSpec(particles, name, Sdf.ValueTypeNames.FloatArray)
        made.displayName = variable.label
        laws = [row.token for row in LAWS.values() if variable in row.internal]
        of = f" Laws: {', '.join(laws)}." if laws else ""
        made.documentation = f"{variable.meaning}{of}\n\nUnits: none\nRange: [0, inf)"
    return layer


def _add(prim: Sdf.PrimSpec, one: Parameter, kind: Sdf.ValueTypeName) -> Sdf.AttributeSpec:
    """The attribute of a law's parameter."""
    laws = ", ".join(row.token for row in LAWS.values() if one in row.parameters)
    name = f"gaussianFlesh:{one.attribute}"
    made = Sdf.AttributeSpec(prim, name, kind, Sdf.VariabilityUniform)
    made.displayName = one.label
    high = "inf)" if one.high == float("inf") else f"{one.high:g}]"
    made.documentation = (
        f"{one.meaning} Laws: {laws}.\n\nUnits: {UNITS[one.unit]}\nRange: [{one.low:g}, {high}"
    )
    return made


def paragraph(text: str) -> str:
    """``text`` on one line, safe inside a Markdown table."""
    return " ".join(text.split()).replace("|", "\\|")


def documented(spec: Sdf.PropertySpec) -> tuple[str, str, str]:
    """(meaning, units, range) of a property; the last two are empty where the doc has none."""
    meaning, _, rest = spec.documentation.partition("Units:")
    units, _, limits = rest.partition("Range:")
    return paragraph(meaning), paragraph(units), paragraph(limits)


def fallback(spec: Sdf.AttributeSpec) -> str:
    """The fallback as it would be written in a layer, or a dash."""
    if spec.default is None:
        return "-"
    if isinstance(spec.default, bool):
        return f"`{str(spec.default).lower()}`"
    if isinstance(spec.default, str):
        return f'`"{spec.default}"`'
    return f"`{spec.default:g}`"


def api_section(prim: Sdf.PrimSpec) -> str:
    """The reference of one API schema."""
    names = prim.customData.get("apiSchemaCanOnlyApplyTo", ())
    types = ", ".join(f"`{name}`" for name in names) or "any prim"
    lines = [f"## {prim.name}", "", paragraph(prim.documentation), "", f"Applies to: {types}."]
    built_in = prim.GetInfo("apiSchemas").prependedItems
    if built_in:
        lines.append("Built in: " + ", ".join(f"`{name}`" for name in built_in) + ".")
    lines += [
        "",
        "| attribute | type | variability | fallback | units | range | meaning |",
        "|---|---|---|---|---|---|---|",
    ]
    relationships = []
    for spec in prim.properties:
        meaning, units, limits = documented(spec)
        if isinstance(spec, Sdf.RelationshipSpec):
            relationships.append(f"| `{spec.name}` | {meaning} |")
            continue
        if not (meaning and units and limits):
            raise SystemExit(f"{spec.path}: the doc string has to give meaning, Units and Range")
        varying = spec.variability == Sdf.VariabilityVarying
        lines.append(
            f"| `{spec.name}` | `{spec.typeName}` | {'varying' if varying else 'uniform'} "
            f"| {fallback(spec)} | {units} | {limits} | {meaning} |"
        )
    if relationships:
        lines += ["", "| relationship | meaning |", "|---|---|", *relationships]
    return "\n".join(lines) + "\n"


def reference(layer: Sdf.Layer) -> str:
    """The whole of docs/schema.md for the layer of `with_laws`."""
    apis = [prim for prim in layer.rootPrims if prim.specifier == Sdf.SpecifierClass]
    return "\n".join([INTRODUCTION, *(api_section(prim) for prim in apis)])


def generate(schema: Path) -> dict[Path, str]:
    """Every generated file with its text, made afresh from ``schema``."""
    layer = with_laws(schema)
    with tempfile.TemporaryDirectory() as temporary:
        folder, source = Path(temporary) / "out", Path(temporary) / "schema.usda"
        folder.mkdir()
        layer.Export(str(source))
        run_generator(source, folder)
        plug_info = filled_plug_info((folder / "plugInfo.json").read_text("utf-8"))
        generated = (folder / "generatedSchema.usda").read_text("utf-8")
    return {
        LIBRARY / "generatedSchema.usda": generated,
        LIBRARY / "plugInfo.json": plug_info,
        REFERENCE: reference(layer),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--check", action="store_true", help="write nothing, exit 1 on a difference"
    )
    options = parser.parse_args()
    different = 0
    for path, text in generate(LIBRARY / "schema.usda").items():
        old = path.read_text("utf-8") if path.is_file() else ""
        name = path.relative_to(ROOT).as_posix()
        if old == text:
            continue
        different += 1
        if options.check:
            old_lines, lines = old.splitlines(keepends=True), text.splitlines(keepends=True)
            sys.stdout.writelines(difflib.unified_diff(old_lines, lines, name, f"{name} (new)"))
        else:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
            print(f"wrote {name}")
    return 1 if options.check and different else 0


if __name__ == "__main__":
    sys.exit(main())
