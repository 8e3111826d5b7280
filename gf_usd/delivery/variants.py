"""The variants of a bake with the motion of their bodies, which joints or shapes then describe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from gf_usd.core.arrays import Ints
from gf_usd.core.errors import InputError
from gf_usd.core.materials.laws import LAWS
from gf_usd.core.scene import Recording
from gf_usd.delivery.motion import BodyMotion, bodies_of
from gf_usd.delivery.rig import Rig
from gf_usd.delivery.splats.clouds import (
    ALL,
    NONE,
    ONLY,
    Cloud,
    read_clouds,
    with_splats,
)
from gf_usd.readers.pictures.prims import NOT_DRAWN
from gf_usd.readers.pictures.recording import ONE_SET, BakedMotion
from gf_usd.readers.pictures.splats import SplatMotion

TORN = (  # a note
    "the material flows without limit: meshes tear where particles separate; a bake without --only"
    " also has Gaussians, which --splats only delivers to a .glb"
)


@dataclass(frozen=True, kw_only=True)
class BakedVariant:
    """A baked variant with its rigs."""

    name: str  # of the variant; "" where the file has none
    bodies: tuple[BodyMotion, ...]
    rigs: tuple[Rig, ...]  # one for each body; none before they are fitted
    meshes: tuple[str, ...]  # prim paths, by the numbers that bodies have
    triangles: tuple[Ints, ...]  # (T, 3) into the points of each
    time_codes: tuple[float, ...]
    unit: float  # [m] per stage unit
    left_out: tuple[str, ...] = ()  # of the meshes, those that particles or a surface replace
    clouds: tuple[Cloud, ...] = ()  # Gaussians to deliver
    radii: tuple[float, ...] = ()  # [m] of the body that each belongs to


def read_variants(
    bake: Path, variant: str | None, splats: str, *, whole: bool
) -> tuple[list[BakedVariant], list[Recording], tuple[str, ...]]:
    """The variants with their bodies, not yet fitted.

    whole : one variant with all that is visible; else all of them, with what the bake moves.
    """
    first = BakedMotion(bake, variant)
    sources = [first]
    if variant is None and not whole:
        sources += [BakedMotion(bake, name) for name in first.variants if name != first.variant]
    variants, recordings, notes = [], [], {}
    for source in sources:
        recording = source.recording()
        clouds, cloud_notes = _clouds(bake, source.variant, recording, splats)
        baked = [i for i, mine in enumerate(recording.baked) if mine or whole]
        gone = [i for i in baked if recording.meshes[i].name in recording.converted]
        baked = [i for i in baked if i not in gone]
        if splats == ONLY:
            baked, gone = [], []
        if gone and not baked and not clouds:
            raise InputError(
                f"{bake}: <{recording.meshes[gone[0]].name}> is converted: particles replace it"
                " from some frame on, which joints and blend shapes cannot represent",
                _instead(bake, source.variant),
            )
        if recording.flows and not baked and not clouds:
            raise InputError(
                f"{bake}: the faces of <{recording.flows[0]}> change from frame to frame, which "
                f"joints and blend shapes cannot represent",
                _instead(bake, source.variant),
            )
        flows = _flows_without_end(source)
        if not baked and not clouds and flows:
            raise InputError(
                f"{bake}: its material flows without limit: particles replace its meshes, which "
                f"joints and blend shapes cannot represent",
                _instead(bake, source.variant),
            )
        if not baked and not clouds:
            source.require_composed()
            raise InputError(
                f"{bake}: neither a mesh nor captured Gaussians of the bake are visible",
                "bake again with mesh among --only"
                if splats != NONE
                else "leave --splats none out, or bake again with mesh among --only",
            )
        bodies = bodies_of(recording, list(source.frames(whole=True)), baked) if baked else ()
        for path in recording.flows:
            notes[f"<{path}>: left out because its faces change from frame to frame"] = None
        if flows and bodies:
            notes[TORN] = None
        for i in gone:
            notes[f"<{recording.meshes[i].name}>: left out because particles replace it"] = None
        names = tuple(mesh.name for mesh in recording.meshes)
        joined = with_splats(bodies, names, clouds)
        variants.append(
            BakedVariant(
                name=source.variant if source.variants else "",
                bodies=joined if whole else bodies,
                rigs=(),
                meshes=names,
                triangles=tuple(mesh.triangles for mesh in recording.meshes),
                time_codes=recording.time_codes,
                unit=recording.unit,
                left_out=tuple(names[i] for i in gone),
                clouds=clouds,
                radii=_radii(joined, len(clouds)),
            )
        )
        recordings.append(recording)
        # a USD file also keeps prims that are not of the bake, such as instancers and curves
        every = [note for note in (*recording.notes, *cloud_notes) if not note.endswith(ONE_SET)]
        mine = [note for note in every if whole or f": {NOT_DRAWN}" not in note]
        notes |= dict.fromkeys(mine)
    return variants, recordings, tuple(notes)


def _flows_without_end(source: BakedMotion) -> bool:
    """Whether all materials of a bake flow, according to its metadata."""
    materials = source.about.get("looks", {}).get(source.variant, {}).get("materials", {})
    laws = [LAWS.get(material.get("law")) for material in materials.values()]
    return bool(laws) and all(law is not None and law.unbounded for law in laws)


def _instead(bake: Path, variant: str) -> str:
    """The hint for a bake in which particles replace meshes."""
    if SplatMotion(bake, variant or None, captured=False, particles=True):
        return "use the bake itself, or deliver the particles as Gaussians to a .glb: --splats only"
    return (
        "use the bake itself, or bake again with gaussians among --only and deliver these to a "
        ".glb: --splats only"
    )


def _clouds(
    bake: Path, variant: str, recording: Recording, splats: str
) -> tuple[tuple[Cloud, ...], tuple[str, ...]]:
    """The requested Gaussians, and notes."""
    if splats == NONE:
        return (), ()
    name = variant or None
    motion = SplatMotion(bake, name, particles=splats == ALL)
    if splats == ONLY and not motion:
        motion = SplatMotion(bake, name, captured=False, particles=True)
    return read_clouds(motion, recording.time_codes), motion.notes


def _radii(bodies: Sequence[BodyMotion], count: int) -> tuple[float, ...]:
    """[m] of the smallest body that has a part of each set of Gaussians."""
    found = [float("inf")] * count
    for body in bodies:
        for number, _ in body.splats:
            found[number] = min(found[number], body.radius)
    return tuple(found)
