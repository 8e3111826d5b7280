"""UsdPhysics of a baked prim: mass, density, initial velocities, material.

Physics materials as bound: what they say of a prim.

GeomSubsets that have a physics material of their own inside one mesh.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pxr import Sdf, Usd, UsdGeom, UsdShade

from gf_usd.core.arrays import Floats, Ints, triple
from gf_usd.core.asset import StageFacts
from gf_usd.core.errors import InputError
from gf_usd.core.materials.material import Material
from gf_usd.core.stage import (
    WATER,
    BodyPhysics,
    PhysicsMaterialSpec,
    SubsetMaterial,
    Triple,
)
from gf_usd.core.units import StageUnits
from gf_usd.readers.notes import Notes
from gf_usd.readers.usd.mesh import Reading
from gf_usd.readers.usd_physics.attributes import (
    BODIES,
    COLLISION,
    RIGID_BODY,
    apis,
    authored,
    body_of,
    is_collider,
    number,
    require_constant,
    role,
    switch,
    vector,
)
from gf_usd.readers.usd_physics.materials import read_material_spec
from gf_usd.readers.usd_physics.motion import (
    Readings,
    is_carried_on,
    matrix,
    velocity_at_rest,
)

MASS = "PhysicsMassAPI"
MASSES = ("physics:mass", "omniphysics:mass")
DENSITY, CENTER = "physics:density", "physics:centerOfMass"
VELOCITY, SPIN = "physics:velocity", "physics:angularVelocity"


def read_body(
    prim: Usd.Prim,
    readings: Readings,
    materials: PhysicsMaterials | None,
    time: Usd.TimeCode,
    *,
    rest: float | None,
    step: float,
    notes: Notes,
) -> BodyPhysics:
    """What is said of one baked mesh or implicit shape.

    time : of the rest pose, and rest the same as a number (None: before any sample); step : time
    codes of one frame; materials : None: what is bound is not read.

    Raises InputError for values that make no sense.
    """
    facts, here = readings.facts, readings.at(time)
    owner = body_of(prim, time)
    mass, mass_of = _mass(prim, owner, here, facts.units, notes)
    density = _density(prim, owner, here, facts.units)
    what = role(prim, time)
    velocity, spin = _rigid_velocity(owner, what, here)
    spec = materials.bound(prim) if materials else PhysicsMaterialSpec()
    return BodyPhysics(
        path=str(prim.GetPath()),
        role=what,
        owner=str(owner.GetPath()) if owner else "",
        collides=COLLISION not in apis(prim)
        or switch(prim, "physics:collisionEnabled", time, otherwise=True),
        mass=mass,
        mass_of=mass_of,
        density=density,
        velocity=velocity,
        angular_velocity=spin,
        center=_center(owner or prim, here),
        moving=velocity_at_rest(prim, readings, rest, step, notes),
        carried=is_carried_on(prim, time),
        spec=spec,
        material=materials.whole(spec, density) if materials else None,
        subsets=read_subsets(prim, facts, time, materials, density, notes) if materials else (),
    )


def _chain(prim: Usd.Prim, owner: Usd.Prim | None, time: Usd.TimeCode) -> list[Usd.Prim]:
    """From the body prim down to the prim, those whose statement of mass takes effect."""
    found, above = [], prim
    while above and not above.IsPseudoRoot():
        found.append(above)
        if owner is None or above == owner:
            break
        above = above.GetParent()
    return [one for one in reversed(found) if _mass_counts(one, time)]


def _mass_counts(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether a prim may state a mass: not as a body or collider that is switched off."""
    mine = apis(prim)
    bodies = mine & BODIES.keys()
    if not (MASS in mine or bodies):
        return False
    on = any(switch(prim, BODIES[api][0], time, otherwise=True) for api in bodies)
    return on or is_collider(prim, time) or not (bodies or COLLISION in mine)


def _mass(
    prim: Usd.Prim, owner: Usd.Prim | None, here: Reading, units: StageUnits, notes: Notes
) -> tuple[float | None, str]:
    """[kg] and the prim that says so; a prim above goes before those below it."""
    for one in _chain(prim, owner, here.time):
        for name in MASSES:
            value = number(here.path, one, name, here.time)
            require_constant(here.path, one.GetAttribute(name))
            if value:
                return value * units.mass, str(one.GetPath())
    above = prim.GetParent() if owner is None else None
    while above and not above.IsPseudoRoot():
        if MASS in apis(above) and number(here.path, above, MASSES[0], here.time):
            notes.add("states a mass but is not a body: ignored", str(above.GetPath()))
        above = above.GetParent()
    return None, ""


def _density(
    prim: Usd.Prim, owner: Usd.Prim | None, here: Reading, units: StageUnits
) -> float | None:
    """[kg/m^3]; the prim nearest to the mesh goes first."""
    for one in reversed(_chain(prim, owner, here.time)):
        value = number(here.path, one, DENSITY, here.time)
        require_constant(here.path, one.GetAttribute(DENSITY))
        if value:
            return value * units.density
    return None


def _rigid_velocity(
    owner: Usd.Prim | None, what: str, here: Reading
) -> tuple[Triple | None, Triple | None]:
    """[m/s] and [rad/s] in the world; None where zero.

    They are authored in the body's own frame; Newton's importer turns them by its rotation,
    without its scale, and so are they here.  In a mirrored frame the spin turns the other way.
    """
    if owner is None or what == "kinematic" or RIGID_BODY not in apis(owner):
        return None, None
    u, _, vt = np.linalg.svd(matrix(owner, here)[:3, :3])
    turn = u @ vt
    linear = vector(here.path, owner, VELOCITY, here.time)
    spin = vector(here.path, owner, SPIN, here.time)
    return (
        None if linear is None else _moving(linear @ turn * here.meters_per_unit),
        None if spin is None else _moving(np.deg2rad(spin) @ turn * np.linalg.det(turn)),
    )


def _center(prim: Usd.Prim, here: Reading) -> Triple | None:
    """(3,) [m] of mass, world; None where it is not authored."""
    if MASS not in apis(prim):
        return None
    local = vector(here.path, prim, CENTER, here.time, unstated=-np.inf)
    if local is None:
        return None
    rows = matrix(prim, here)
    world = (local @ rows[:3, :3] + rows[3, :3]) * here.meters_per_unit
    return triple(world)


def _moving(values: Floats) -> Triple | None:
    """Three numbers; None where all are 0, by which nothing is said."""
    return triple(values) if np.any(values) else None


PURPOSE = "physics"
CONTACT_VALUES = ("staticFriction", "dynamicFriction", "restitution")  # what counts of an obstacle
# Materials that have moduli: of the AOUSD proposal by its earlier and later name, and Omniverse's.
DEFORMABLE = {
    "PhysicsDeformableMaterialAPI",
    "PhysicsVolumeDeformableMaterialAPI",
    "OmniPhysicsDeformableMaterialAPI",
}


class PhysicsMaterials:
    """The physics materials of a stage at one time, each read once."""

    def __init__(self, facts: StageFacts, time: Usd.TimeCode, notes: Notes) -> None:
        self._facts = facts
        self._time = time
        self._notes = notes
        self._words: dict[Sdf.Path, PhysicsMaterialSpec] = {}
        self._deformable: set[str] = set()  # paths of those that could state moduli

    def bound(self, prim: Usd.Prim) -> PhysicsMaterialSpec:
        """What the material says that is bound to a prim (or above it, or by a collection) for
        physics, else for all purposes.

        Raises InputError for values out of range.
        """
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(PURPOSE)
        if not material:
            return PhysicsMaterialSpec()
        path = material.GetPath()
        if path not in self._words:
            self._words[path] = self._read(material.GetPrim())
        return self._words[path]

    def whole(self, spec: PhysicsMaterialSpec, density: float | None = None) -> Material | None:
        """The material that the words make; None where they say nothing of elasticity.

        density : [kg/m^3] that goes before the material's, so that it needs none of its own.
        """
        if not spec.elastic and spec.path in self._deformable:
            self._notes.add(
                "no Young's modulus is stated, which the AOUSD proposal leaves to the "
                "simulator: the moduli of the bake's material are used, or those of rubber "
                "where none is named",
                spec.path,
            )
        if spec.elastic and spec.density is None and density is None:
            self._notes.add(f"no density is stated: {WATER:g} kg/m^3 is assumed", spec.path)
        return spec.whole()

    def note_keys(self, spec: PhysicsMaterialSpec, stage: Usd.Stage) -> None:
        """Note what of an obstacle's material has time samples: it is not followed."""
        prim = stage.GetPrimAtPath(spec.path) if spec.path else None
        for attribute in prim.GetAuthoredAttributes() if prim else ():
            if attribute.GetBaseName() in CONTACT_VALUES and attribute.GetNumTimeSamples() > 1:
                self._notes.add(
                    f"{attribute.GetName()} has time samples: obstacles keep the value of the rest"
                    " pose",
                    spec.path,
                )

    def _read(self, prim: Usd.Prim) -> PhysicsMaterialSpec:
        def value(name: str) -> Any:
            return authored(prim, name, self._time)

        where = str(prim.GetPath())
        if apis(prim) & DEFORMABLE:
            self._deformable.add(where)
        return read_material_spec(
            value,
            where,
            self._facts.units,
            where=f"{self._facts.path}: <{where}>",
            assume=lambda text: self._notes.add(text, where),
        )


def read_subsets(
    mesh: Usd.Prim,
    facts: StageFacts,
    time: Usd.TimeCode,
    materials: PhysicsMaterials,
    density: float | None,
    notes: Notes,
) -> tuple[SubsetMaterial, ...]:
    """The subsets of faces, family materialBind, whose physics material differs from the mesh's.

    density : [kg/m^3] of the mesh's PhysicsMassAPI.  A face in two of them belongs to the first.

    Raises InputError for indices that are no faces of the mesh.
    """
    if not mesh.IsA(UsdGeom.Mesh):
        for subset in UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets():
            if materials.bound(subset.GetPrim()) != materials.bound(mesh):
                text = "is not a subset of the faces of a mesh: its physics material is ignored"
                notes.add(text, str(subset.GetPath()))
        return ()
    whole = materials.bound(mesh)
    n_faces = len(UsdGeom.Mesh(mesh).GetFaceVertexCountsAttr().Get(time) or [])
    taken = np.zeros(n_faces, dtype=bool)
    found = []
    for subset in UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets():
        prim = subset.GetPrim()
        spec = materials.bound(prim)
        if spec.path == whole.path or spec == PhysicsMaterialSpec(path=spec.path):
            continue  # the mesh's own, or a look without a word of physics
        if subset.GetElementTypeAttr().Get() != UsdGeom.Tokens.face:
            notes.add(
                "is not a subset of faces: its physics material is ignored", str(prim.GetPath())
            )
            continue
        faces = _faces(subset, facts, time, n_faces)
        if taken[faces].any():
            notes.add("shares faces with an earlier subset, which keeps them", str(prim.GetPath()))
            faces = faces[~taken[faces]]
        taken[faces] = True
        if len(faces):
            material = materials.whole(spec, density)
            found.append(
                SubsetMaterial(path=str(prim.GetPath()), faces=faces, spec=spec, material=material)
            )
    return tuple(found)


def _faces(subset: UsdGeom.Subset, facts: StageFacts, time: Usd.TimeCode, n_faces: int) -> Ints:
    """(n,) faces in order, each once."""
    indices = np.asarray(subset.GetIndicesAttr().Get(time) or [], dtype=np.int64)
    outside = (indices < 0) | (indices >= n_faces)
    if outside.any():
        raise InputError(
            f"{facts.path}: <{subset.GetPrim().GetPath()}>: {int(outside.sum())} of its"
            f" {len(indices)} indices do not refer to any of the {n_faces} faces of the mesh; "
            f"the first is {indices[outside][0]}",
            "repair the subset in the program that made it",
        )
    return np.unique(indices)
