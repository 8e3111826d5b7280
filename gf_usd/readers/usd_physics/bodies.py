"""UsdPhysics properties of a baked prim: mass, density, initial velocities, bound materials.

GeomSubsets of a mesh may be bound to other physics materials (`read_subsets`).
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
from gf_usd.readers.usd.stage import upwards
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
    matrix,
    moves_after,
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
    """The physics properties of one baked mesh or implicit shape.

    materials : None: bound materials are not read.
    time, rest : time code of the rest pose, as Usd.TimeCode and as number; None: before any sample.
    step : time codes per frame.

    Raises InputError for invalid values.
    """
    facts, here = readings.facts, readings.at(time)
    owner = body_of(prim, time)
    mass, mass_of, mass_attribute = _mass(prim, owner, here, facts.units, notes)
    density, density_of = _density(prim, owner, here, facts.units)
    what = role(prim, time)
    velocity, spin = _rigid_velocity(owner, what, here)
    spec = materials.bound(prim) if materials else PhysicsMaterialSpec()
    return BodyPhysics(
        path=str(prim.GetPath()),
        role=what,
        owner=str(owner.GetPath()) if owner else "",
        collider=is_collider(prim, time),
        collides=COLLISION not in apis(prim)
        or switch(prim, "physics:collisionEnabled", time, otherwise=True),
        mass=mass,
        mass_of=mass_of,
        mass_attribute=mass_attribute,
        density=density,
        density_of=density_of,
        velocity=velocity,
        angular_velocity=spin,
        center=_center(owner or prim, here),
        moving=velocity_at_rest(prim, readings, rest, step, notes),
        carried=moves_after(prim, time),
        spec=spec,
        material=materials.whole(spec, density) if materials else None,
        subsets=read_subsets(prim, facts, time, materials, density, notes) if materials else (),
    )


def _chain(prim: Usd.Prim, owner: Usd.Prim | None, time: Usd.TimeCode) -> list[Usd.Prim]:
    """The prims from the body down to `prim` whose PhysicsMassAPI takes effect."""
    found = []
    for one in upwards(prim):
        found.append(one)
        if owner is None or one == owner:
            break
    return [one for one in reversed(found) if _mass_counts(one, time)]


def _mass_counts(prim: Usd.Prim, time: Usd.TimeCode) -> bool:
    """Whether the mass of a prim counts: not that of a disabled body or collider."""
    mine = apis(prim)
    bodies = mine & BODIES.keys()
    if not (MASS in mine or bodies):
        return False
    on = any(switch(prim, BODIES[api][0], time, otherwise=True) for api in bodies)
    return on or is_collider(prim, time) or not (bodies or COLLISION in mine)


def _mass(
    prim: Usd.Prim, owner: Usd.Prim | None, here: Reading, units: StageUnits, notes: Notes
) -> tuple[float | None, str, str]:
    """Mass [kg], the path of its prim and the attribute that states it; an ancestor takes
    precedence over its descendants.
    """
    for one in _chain(prim, owner, here.time):
        for name in MASSES:
            value = number(here.path, one, name, here.time)
            require_constant(here.path, one.GetAttribute(name))
            if value:
                return value * units.mass, str(one.GetPath()), name
    for above in upwards(prim.GetParent()) if owner is None else ():
        if MASS in apis(above) and number(here.path, above, MASSES[0], here.time):
            notes.add("states a mass but is not a body: ignored", str(above.GetPath()))
    return None, "", ""


def _density(
    prim: Usd.Prim, owner: Usd.Prim | None, here: Reading, units: StageUnits
) -> tuple[float | None, str]:
    """Density [kg/m^3] of the prim nearest to the mesh, and the path of that prim."""
    for one in reversed(_chain(prim, owner, here.time)):
        value = number(here.path, one, DENSITY, here.time)
        require_constant(here.path, one.GetAttribute(DENSITY))
        if value:
            return value * units.density, str(one.GetPath())
    return None, ""


def _rigid_velocity(
    owner: Usd.Prim | None, what: str, here: Reading
) -> tuple[Triple | None, Triple | None]:
    """Velocity [m/s] and angular velocity [rad/s] in world space; None where zero.

    They are authored in the body's local space and are rotated, but not scaled, to world space, as
    in Newton's importer.  A reflection reverses the angular velocity.
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
    """(3,) [m] center of mass, world; None where it is not authored."""
    if MASS not in apis(prim):
        return None
    local = vector(here.path, prim, CENTER, here.time, unstated=-np.inf)
    if local is None:
        return None
    rows = matrix(prim, here)
    world = (local @ rows[:3, :3] + rows[3, :3]) * here.meters_per_unit
    return triple(world)


def _moving(values: Floats) -> Triple | None:
    """The values as a triple; None where all are 0, the schema's fallback."""
    return triple(values) if np.any(values) else None


PURPOSE = "physics"
CONTACT_VALUES = ("staticFriction", "dynamicFriction", "restitution")  # values of an obstacle
# Material APIs with elastic moduli: the AOUSD proposal's earlier and later names, and Omniverse's.
DEFORMABLE = {
    "PhysicsDeformableMaterialAPI",
    "PhysicsVolumeDeformableMaterialAPI",
    "OmniPhysicsDeformableMaterialAPI",
}


class PhysicsMaterials:
    """The physics materials of a stage at one time, cached."""

    def __init__(self, facts: StageFacts, time: Usd.TimeCode, notes: Notes) -> None:
        self._facts = facts
        self._time = time
        self._notes = notes
        self._specs: dict[Sdf.Path, PhysicsMaterialSpec] = {}
        self._deformable: set[str] = set()  # paths of materials with APIs in DEFORMABLE

    def bound(self, prim: Usd.Prim) -> PhysicsMaterialSpec:
        """The material bound to a prim, with inherited and collection bindings, for the purpose
        "physics", else for all purposes.

        Raises InputError for values out of range.
        """
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial(PURPOSE)
        if not material:
            return PhysicsMaterialSpec()
        path = material.GetPath()
        if path not in self._specs:
            self._specs[path] = self._read(material.GetPrim())
        return self._specs[path]

    def whole(self, spec: PhysicsMaterialSpec, density: float | None = None) -> Material | None:
        """The complete material of a spec; None where it has no elastic moduli.

        density : [kg/m^3] which takes precedence over that of the material.
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
        """Add a note on time samples of an obstacle's material, which are ignored."""
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
    """The face subsets (family materialBind) whose physics material differs from the mesh's.

    density : [kg/m^3] of the mesh's PhysicsMassAPI.  A face in two subsets belongs to the first.

    Raises InputError for indices that are not faces of the mesh.
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
            continue  # the mesh's own, or a render material without physics
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
    """(n,) the faces of a subset, ascending and unique."""
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
