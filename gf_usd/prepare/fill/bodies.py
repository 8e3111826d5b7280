"""The step of `fill` that samples bodies with particles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cache, partial
from typing import TYPE_CHECKING

from gf_usd.core.arrays import Ints
from gf_usd.core.errors import UsageError, naming
from gf_usd.prepare.bodies.flesh.characters import characters_of
from gf_usd.prepare.bodies.sampling import SampledBodies, count_notes, sample_bodies, spacing_of
from gf_usd.prepare.fill.inputs import PARTICLES, SAMPLES, THICKNESS, Inputs, resolution_of
from gf_usd.prepare.settings import DEFAULT_PARTICLES

if TYPE_CHECKING:
    from gf_usd.geometry.solid import Solid
    from gf_usd.geometry.thin.thickness import Thickness


@dataclass(frozen=True, kw_only=True)
class FilledBodies(SampledBodies):
    """`SampledBodies` with the notes on them."""

    count_notes: tuple[str, ...]
    resolution_notes: tuple[str, ...]
    character_notes: tuple[str, ...]
    characters: bool  # whether each body is a character of --flesh


def fill_bodies(inputs: Inputs) -> FilledBodies:
    """The bodies of an asset with their particles, at the requested resolution.

    Raises UsageError for options that only a single body supports.
    """
    request, meshes, paper = inputs.request, inputs.meshes, inputs.paper
    asset, solid = inputs.asset, inputs.solid
    owners, notes = {}, ()
    if inputs.characters is not None:
        owners, notes = characters_of(asset, inputs.characters)
    characters = bool(owners)
    combine = (
        request.combine or paper or request.solver == "ul" or (request.flesh and not characters)
    )
    owners = owners or {path: body.owner for path, body in inputs.spec.bodies.items()}

    owned = [owners.get(s.path, "") for s in solid.surfaces]
    kinds = inputs.flow.first if inputs.mixed else None

    @cache  # the spacing is often the one for which thickness is measured
    def find(spacing: float) -> Ints:
        from gf_usd.geometry.connected.bodies import find_bodies

        return find_bodies(solid, spacing, owners=owned, combine=combine, kinds=kinds)

    def thin() -> tuple[float, Thickness | None]:
        from gf_usd.geometry.thin.thickness import thickness

        inputs.progress(THICKNESS)
        apart = not combine and _some_touch(solid, owned, kinds)
        bodies = find(spacing_of(solid.volume, DEFAULT_PARTICLES)) if apart else None
        return solid.volume, thickness(solid, bodies)

    requested = resolution_of(
        request, inputs.spec, inputs.unit, meshes.volumes, None if meshes.thickened else thin
    )
    count = 0 if paper or (requested.spacing and not meshes.spacing) else requested.particles
    filling = replace(requested, spacing=meshes.spacing or requested.spacing)
    with naming(asset.facts.path):
        filled = sample_bodies(
            asset, solid, filling, inputs.flow,
            seed=request.seed or 0,
            paper=paper,
            mixed=inputs.mixed,
            combine=combine,
            owners=owners,
            find=find,
            characters=characters,
            can_combine=inputs.file is not None,
            placing=partial(inputs.progress, PARTICLES),
            covering=partial(inputs.progress, SAMPLES),
        )  # fmt: skip
    _require_one_body(
        filled.bodies.count, skin=request.skin, wls=bool(request.wls),
        procrustes=bool(request.procrustes),
    )  # fmt: skip
    return FilledBodies(
        **{field.name: getattr(filled, field.name) for field in fields(filled)},
        count_notes=count_notes(count, filled.particles, sheets=bool(meshes.spacing)),
        resolution_notes=(requested.note,) if requested.note else (),
        character_notes=notes,
        characters=characters,
    )


def _some_touch(solid: Solid, owners: Sequence[str], kinds: Ints | None) -> bool:
    """Whether bodies may touch: of different owners (S,) or components, or of different kinds (S,).

    Otherwise rays into a body intersect no other one.
    """
    components = {s.component for s in solid.surfaces} - {""}
    return kinds is not None or len(set(owners) - {""}) > 1 or len(components) > 1


def _require_one_body(count: int, *, skin: str | None, wls: bool, procrustes: bool) -> None:
    """Raise UsageError for options that support a single body only."""
    given_options = {
        f"--skin {skin}": skin not in (None, "embed"),
        "--wls": wls,
        "--procrustes": procrustes,
    }
    for option, given in given_options.items():
        if given and count > 1:
            raise UsageError(
                f"{option} supports one body, but there are {count}", "add --combine, or omit it"
            )
