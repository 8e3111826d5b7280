"""The options of a bake as a request and material presets, checked before anything is read."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from gf_usd.core.errors import UsageError
from gf_usd.core.materials.laws import check_law
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.presets import Fixed, find_preset
from gf_usd.prepare.advice.advise import parse_auto
from gf_usd.prepare.options.request import Request
from gf_usd.prepare.options.sweep import swept

DEFAULT_MATERIAL = "rubber"  # where neither an option nor the stage gives one


def parse_request(
    material: str | tuple[str | Material, ...] | None, law: str | None, options: dict[str, Any]
) -> tuple[Request, list[Any]]:
    """The request and the presets of a bake, checked before anything is read.

    material : names separated by commas, or names and materials given by value.  No preset: the
        materials of the stage, or rubber.
    """
    request = Request.of(options)
    request.check()
    if law is not None:
        check_law(law)
    from gf_usd.system import usd_schema  # noqa: F401  (registers itself before any stage opens)

    if material is None and request.preset == "paper":
        material = "rubber"
    auto = parse_auto(material_names(material), request.preset)
    if auto is not None and request.material_sweep:
        raise UsageError(
            "--material-sweep cannot be combined with --material auto", "name the material to vary"
        )
    if auto is not None:
        return request, [auto]
    named = material.split(",") if isinstance(material, str) and material else material
    sweep = request.parsed["material_sweep"]
    if sweep is not None:
        named = named or (DEFAULT_MATERIAL,)
    found = [_find(one, request) for one in named or ()]
    if sweep is None:
        return request, found
    if len(found) > 1:
        raise UsageError(
            f"--material-sweep varies one material, and {len(found)} were given", "give one"
        )
    return request, swept(found[0], sweep)


def material_names(material: str | tuple[str | Material, ...] | None) -> str | None:
    """The names of materials, separated by commas, including those given by value."""
    if material is None or isinstance(material, str):
        return material
    return ",".join(one if isinstance(one, str) else one.name for one in material)


def _find(name: str | Material, request: Request) -> Any:
    """A preset; materials of a file or given by value are wrapped as presets."""
    if isinstance(name, Material):
        return Fixed(
            name,
            (
                f"the values of the material {name.name} were given by the"
                " caller: the recorded command names it only",
            ),
        )
    from gf_usd.readers.usd_bake.material_file import is_material_file, read_material

    if is_material_file(name):
        notes: list[str] = []
        given = read_material(Path(name), notes.append)
        return Fixed(given, tuple(notes))
    preset = find_preset(name.strip())
    # The paper has every solid corotated.
    return replace(preset, law="corotated") if request.preset == "paper" else preset
