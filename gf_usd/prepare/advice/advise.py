"""``--material auto``: the material of each surface, with the reason.

Materials that the stage states have precedence: a preset that it names, or a physics material with
a Young's modulus.  Others are inferred from names and labels, or by an advisor.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gf_usd.core.asset import NO_COLOR, Asset, Surface, Texture
from gf_usd.core.errors import UsageError
from gf_usd.core.materials.dimensionless import DIMENSIONLESS
from gf_usd.core.materials.physical import PHYSICAL
from gf_usd.core.stage import Advice, StageSpec, Subject
from gf_usd.prepare.advice import AUTO, Auto, Question

if TYPE_CHECKING:
    from gf_usd.core.scene import RenderMesh, Scene

PICTURE = (512, 512)  # pixels of what an advisor gets: what vision models take in one tile
Draw = Callable[["Scene", tuple[int, int]], Any]  # scene, size -> pixels (height, width, 3)
ROUGHNESS = 0.5  # of all surfaces in the picture


def parse_auto(material: str | None, preset: str | None) -> Auto | None:
    """``auto`` or ``auto:NAME`` of --material; None for another material.

    Raises UsageError where it is combined with others or with the paper's set-up, and for an
    unknown advisor.
    """
    parts = [part.strip() for part in (material or "").split(",")]
    mine = [part for part in parts if part == AUTO or part.startswith(f"{AUTO}:")]
    if not mine:
        return None
    if len(parts) > 1:
        raise UsageError(
            f"--material {material}: {mine[0]} is in a list, but it chooses the material itself",
            f"bake with --material {mine[0]} alone, and the others in a bake of their own",
        )
    if preset is not None:
        raise UsageError(
            f"--preset {preset} and --material {mine[0]} were both given: the paper has one"
            " material for a body",
            "name the material, or leave the preset out",
        )
    _, colon, advisor = mine[0].partition(":")
    if colon:
        from gf_usd.prepare.advice.advisors import find_advisor

        find_advisor(advisor)
    return Auto(advisor)


def advise(
    asset: Asset,
    file: Path,
    spec: StageSpec,
    auto: Auto,
    *,
    usd: bool,
    rest: float | None,
    draw: Draw,
) -> StageSpec:
    """The stage's specification, with an `Advice` for every surface of the asset.

    file : the asset's USD file, where `usd`; rest : time code of the rest pose; draw : makes the
        picture for an advisor.

    Raises BakeError where an advisor fails or its answer is invalid.
    """
    stated = {s.path: one for s in asset.surfaces if (one := _stated(s.path, spec)) is not None}
    open_ = [s for s in asset.surfaces if s.path not in stated]
    if usd:
        from gf_usd.readers.usd_bake.settings import read_subjects

        subjects = read_subjects(file, asset.facts, [s.path for s in open_], rest=rest)
    else:
        subjects = tuple(Subject(path=s.path, looks=_appearance(s)) for s in open_)
    advised = _ask(asset, subjects, auto, draw) if subjects else ()
    by_path = {**stated, **{one.path: one for one in advised}}
    return replace(spec, advice={s.path: by_path[s.path] for s in asset.surfaces})


def _stated(path: str, spec: StageSpec) -> Advice | None:
    bake, body = spec.bakes.get(path), spec.bodies.get(path)
    if bake is not None and bake.material:
        reason = "the stage names it (gaussianFlesh:material)"
        return Advice(path=path, material=bake.material, confidence=1.0, reason=reason, by="stage")
    if body is not None and body.material is not None:
        reason = f"its physics material <{body.spec.path}> states a Young's modulus"
        name = body.material.name
        return Advice(path=path, material=name, confidence=1.0, reason=reason, by="stage")
    return None


def _ask(asset: Asset, subjects: tuple[Subject, ...], auto: Auto, draw: Draw) -> Sequence[Advice]:
    if not auto.advisor:
        from gf_usd.prepare.advice.names import by_names

        return [by_names(subject, asset.facts.path.stem) for subject in subjects]
    from gf_usd.prepare.advice.advisors import ask_advisor

    question = Question(
        file=asset.facts.path,
        subjects=subjects,
        presets=described(),
        picture=picture(asset, draw),
    )
    return ask_advisor(auto.advisor, question)


def described() -> dict[str, str]:
    """Every preset with its description."""
    scaled = {one.name: one.note for one in DIMENSIONLESS.values()}
    return scaled | {
        p.name: f"E = {p.youngs_modulus:.2g} Pa, {p.density:g} kg/m^3; {p.source}"
        for p in PHYSICAL.values()
    }


def picture(asset: Asset, draw: Draw) -> bytes:
    """A PNG of the asset at rest, drawn as by ``gf-usd preview``, PICTURE pixels large."""
    from PIL import Image

    from gf_usd.core.scene import Scene

    x, y, z = (float(u) for u in asset.facts.up)
    meshes = tuple(_mesh(surface) for surface in asset.surfaces)
    pixels = draw(Scene(up=(x, y, z), meshes=meshes), PICTURE)
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, format="PNG")
    return out.getvalue()


def _mesh(surface: Surface) -> RenderMesh:
    """The triangles of a surface in their diffuse colors or textures."""
    from gf_usd.core.scene import RenderMesh

    count = len(surface.triangles)
    colors = np.tile(NO_COLOR, (count, 3, 1))
    if surface.triangle_colors is not None:
        colors = np.array(surface.triangle_colors, float)
    skin, textures = np.full(count, -1), list[Texture]()
    bound = surface.triangle_materials
    for i, material in enumerate(surface.materials if bound is not None else ()):
        mine = np.asarray(bound) == i
        if material.texture is None:
            colors[mine] = material.color
        elif surface.triangle_uvs is not None:
            skin[mine] = len(textures)
            textures.append(material.texture)
    return RenderMesh(
        name=surface.path, points=surface.points, triangles=surface.triangles, colors=colors,
        uvs=surface.triangle_uvs, textures=tuple(textures), triangle_textures=skin,
        roughness=np.full(count, ROUGHNESS), metallic=np.zeros(count),
    )  # fmt: skip


def _appearance(surface: Surface) -> tuple[str, ...]:
    """Paths of the materials of a mesh file's surface, by number of triangles, largest first."""
    if surface.triangle_materials is None:
        return ()
    counts = [int((surface.triangle_materials == i).sum()) for i in range(len(surface.materials))]
    order = sorted(range(len(counts)), key=lambda i: -counts[i])
    return tuple(surface.materials[i].path for i in order if counts[i])
