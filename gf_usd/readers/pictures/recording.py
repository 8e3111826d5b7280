"""The animation of a bake, or of any stage, as arrays: one variant, frame by frame.

Variants are selected in the session layer only.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.matrices import gaussian_axes
from gf_usd.core.scene import GaussianSet, MotionFrame, Recording, RenderMesh
from gf_usd.readers.notes import Notes
from gf_usd.readers.pictures.extent import (
    comes_and_goes,
    is_visible,
    sample_times,
    sometimes_visible,
)
from gf_usd.readers.pictures.prims import (
    placed_prims,
    read_splats,
    stands_for_meshes,
    to_render_mesh,
)
from gf_usd.readers.pictures.values import MEASURES, written
from gf_usd.readers.usd.implicit import IMPLICIT, tessellate
from gf_usd.readers.usd.mesh import Reading, has_surface, read_surface
from gf_usd.readers.usd.shading import ShadingReader
from gf_usd.readers.usd.skeleton import Skins
from gf_usd.readers.usd.stage import (
    FOR_BAKES,
    SPLAT_TYPE,
    Placement,
    SkippedPrim,
    is_bake_particles,
    open_stage,
    reading,
    stage_facts,
)

ONE_SET = "only these Gaussians are shown"  # a note: a recording has one set
SCOPE = "GaussianFlesh"  # in the name of the prim that holds what a bake adds
PURPOSES = (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)


class BakedMotion:
    """A stage opened to read one variant of its motion.

    Parameters
    ----------
    path : the root layer of a bake, or any USD file with moving meshes or Gaussians.
    variant : to show; None: the one that is selected in the file.

    Raises
    ------
    InputError : no such file, not USD, damaged, or nothing in this file moves.
    UsageError : the file has no such variant.
    """

    def __init__(self, path: Path, variant: str | None = None) -> None:
        if not path.is_file():
            what = "is a folder" if path.is_dir() else "does not exist"
            raise InputError(f"{path} {what}.", "give the root layer that gf-usd bake wrote")
        self._path = path
        self._notes = Notes()
        with reading(path):
            self._stage = open_stage(path)
            self._facts = stage_facts(
                self._stage, path, self._notes, meters_per_unit=None, up_axis=None
            )
            self.variants = variants_of(self._stage)
            self.variant = select_variant(self._stage, path, variant)
            self._find()

    @property
    def about(self) -> Mapping[str, Any]:
        """What the bake says of itself in the root layer; empty for other files."""
        data = self._stage.GetRootLayer().customLayerData.get(VARIANTS)
        return data if isinstance(data, dict) else {}

    def recording(self) -> Recording:
        """The variant without its frames; the arrays that do not change."""
        default = self._stage.GetDefaultPrim()
        up, ground = self._facts.up, self._ground()
        return Recording(
            path=self._path,
            name=default.GetName() if default else self._path.stem,
            variant=self.variant,
            up=(float(up[0]), float(up[1]), float(up[2])),
            ground=ground,
            unit=self._facts.units.length,
            time_codes=tuple(self._times),
            time_codes_per_second=float(self._stage.GetTimeCodesPerSecond()),
            meshes=tuple(self._shapes),
            baked=tuple(str(prim.GetPath()) in self._bodies for prim in self._meshes),
            flows=tuple(str(prim.GetPath()) for prim in self._flows),
            vanishing=tuple(str(prim.GetPath()) for prim in self._vanishing),
            converted=tuple(str(p.GetPath()) for p in self._vanishing if self._is_converted(p)),
            gaussians=self._gaussians,
            about=self.about,
            notes=self._notes.lines(without=FOR_BAKES),
        )

    def frames(
        self, time_codes: Sequence[float] | None = None, *, whole: bool = False
    ) -> Iterator[MotionFrame]:
        """The moving arrays at these time codes, default all; one frame is held at a time.

        whole : a mesh has its shape where it is hidden too; else it is a point there, of no area.

        Raises InputError where an array has another length, or a number that is not finite.
        """
        for code in self._times if time_codes is None else time_codes:
            try:
                with reading(self._path):
                    frame = self._frame(code, whole=whole)
            except SkippedPrim as reason:
                raise InputError(
                    f"{self._path}: at time code {code:g} a prim cannot be shown: {reason}.",
                    "run gf-usd check for details, then bake the asset again",
                ) from reason
            yield frame

    def _frame(self, code: float, *, whole: bool) -> MotionFrame:
        time = Usd.TimeCode(code)
        xforms = UsdGeom.XformCache(time)
        skins = Skins(time, xforms, Notes())
        meshes, hidden = [], []
        for number, (prim, shape) in enumerate(zip(self._meshes, self._shapes)):
            points = world_points(prim, time, xforms, skins) * self._facts.units.length
            if points.shape != shape.points.shape or not np.isfinite(points).all():
                raise InputError(
                    f"{self._path}: {prim.GetPath()} has {len(points)} points at time code "
                    f"{code:g} but {len(shape.points)} at the first one, or some are not finite.",
                    "run gf-usd check for details, then bake the asset again",
                )
            if prim in self._vanishing and not is_visible(prim, time):
                hidden.append(number)
                if not whole:
                    points = np.broadcast_to(points.mean(0), points.shape)
            meshes.append(points)
        flows = self._changing(self._context(time, xforms, skins, Notes()))
        if self._gaussians is None:
            return MotionFrame(
                time_code=code, meshes=tuple(meshes), hidden=tuple(hidden), flows=flows
            )
        positions, axes = self._splats(time, xforms)
        return MotionFrame(
            time_code=code,
            meshes=tuple(meshes),
            hidden=tuple(hidden),
            flows=flows,
            positions=positions,
            axes=axes,
            measured=self._measured(time, len(positions)),
        )

    def _changing(self, context: Reading) -> tuple[RenderMesh, ...]:
        """The meshes whose faces change, as they are at one time."""
        found = []
        for prim in self._flows:
            if comes_and_goes(prim) and not is_visible(prim, context.time):
                continue
            try:
                surface = read_surface(prim, context)
            except SkippedPrim:  # nothing is there at this time, or not yet
                continue
            found.append(to_render_mesh(surface, self._stage, context.time))
        return tuple(found)

    def _context(
        self, time: Usd.TimeCode, xforms: UsdGeom.XformCache, skins: Skins, notes: Notes
    ) -> Reading:
        return Reading(
            path=self._path,
            time=time,
            meters_per_unit=self._facts.units.length,
            xforms=xforms,
            skins=skins,
            shadings=ShadingReader(time, notes),
            notes=notes,
        )

    def _splats(self, time: Usd.TimeCode, xforms: UsdGeom.XformCache) -> tuple[Floats, Floats]:
        prim = self._cloud
        place = Placement.of(xforms.GetLocalToWorldTransform(prim))
        count = len(self._gaussians or ())
        values = {}
        for name, width in (("positions", 3), ("orientations", 4), ("scales", 3)):
            array = _either(prim, name, time)
            if array is None or len(array) != count or not np.isfinite(array).all():
                raise InputError(
                    f"{self._path}: {prim.GetPath()} has {0 if array is None else len(array)}"
                    f" {name} at {time} for {count} Gaussians, or some are not finite.",
                    "run gf-usd check for details, then bake the asset again",
                )
            values[name] = array.reshape(-1, width)
        # numpy sees a quaternion as (x, y, z, w)
        local = gaussian_axes(values["orientations"][:, [3, 0, 1, 2]], values["scales"])
        unit = self._facts.units.length
        return place.points(values["positions"]) * unit, place.matrix[:3, :3].T * unit @ local

    def _measured(self, time: Usd.TimeCode, count: int) -> dict[str, Floats]:
        found: dict[str, Floats] = {}
        for name, measure in MEASURES.items():
            stored = [attribute.Get(time) for attribute in written(self._cloud, measure)]
            whole = [values for values in stored if values is not None and len(values) == count]
            if whole:
                scale = self._facts.units.pressure if measure.unit else 1.0
                found[name] = np.asarray(whole, dtype=np.float64).max(0) * scale
        return found

    def _find(self) -> None:
        """Meshes, Gaussians and their times."""
        prims = list(placed_prims(self._stage, self._notes))
        clouds = [p for p in prims if str(p.GetTypeName()) == SPLAT_TYPE]
        clouds.sort(key=lambda p: not is_bake_particles(p))
        if len(clouds) > 1:
            self._notes.add(ONE_SET, str(clouds[0].GetPath()))
        self._cloud = clouds[0] if clouds else Usd.Prim()
        candidates = [p for p in prims if has_surface(p)]
        ours = clouds[:1] if clouds and is_bake_particles(clouds[0]) else []
        self._times = sample_times(ours or [*candidates, *clouds])
        if len(self._times) < 2:
            raise InputError(
                f"{self._path}: nothing in this file moves.",
                "bake the asset with gf-usd bake and give the root layer that it writes",
            )
        self._stand_ins = [prim for prim in prims if stands_for_meshes(prim)]
        for prim in prims:
            if prim.IsA(UsdGeom.Points) and not is_bake_particles(prim) and _moves(prim):
                self._notes.add("its points move and are left out", str(prim.GetPath()))
        self._read_rest(candidates)

    def _read_rest(self, candidates: Sequence[Usd.Prim]) -> None:
        time = Usd.TimeCode(self._times[0])
        xforms = UsdGeom.XformCache(time)
        context = self._context(time, xforms, Skins(time, xforms, self._notes), self._notes)
        self._flows: list[Usd.Prim] = []
        self._meshes: list[Usd.Prim] = []
        self._shapes: list[RenderMesh] = []
        for prim in candidates:
            image = UsdGeom.Imageable(prim)
            if not sometimes_visible(prim, time) or image.ComputePurpose() not in PURPOSES:
                continue
            if _faces_change(prim):
                self._flows.append(prim)
                continue
            try:
                surface = read_surface(prim, context)
            except SkippedPrim as reason:
                self._notes.add(f"not shown: {reason}", str(prim.GetPath()))
                continue
            self._meshes.append(prim)
            self._shapes.append(to_render_mesh(surface, self._stage, time))
        self._stand_ins += [prim for prim in self._flows if SCOPE in prim.GetParent().GetName()]
        self._vanishing = [prim for prim in self._meshes if comes_and_goes(prim)]
        self._gaussians = self._read_gaussians(context) if self._cloud else None
        self._bodies = self._body_paths()

    def _read_gaussians(self, context: Reading) -> GaussianSet | None:
        prim, units = self._cloud, self._facts.units
        try:
            place = Placement.of(context.xforms.GetLocalToWorldTransform(prim))
            first = read_splats(prim, context.time, place, units.length, self._notes)
        except SkippedPrim as reason:
            self._notes.add(f"not shown: {reason}", str(prim.GetPath()))
            return None
        count = len(first.positions)
        rest = prim.GetAttribute("gaussianFlesh:restScales").Get()
        scales = np.linalg.norm(first.axes, axis=1)
        if rest is not None and len(rest) == count:
            scales = np.asarray(rest, dtype=np.float64) * units.length
        masses = prim.GetAttribute("gaussianFlesh:masses").Get()
        kept = masses is not None and len(masses) == count
        return GaussianSet(
            name=first.name,
            colors=first.colors,
            opacities=first.opacities,
            rest_scales=scales,
            masses=np.asarray(masses, dtype=np.float64) * units.mass if kept else None,
        )

    def _is_converted(self, mesh: Usd.Prim) -> bool:
        """Whether a bake hides a mesh from some frame on because something stands for it then.

        The layer that hides it, a cache or a flattened bake, also holds what appears instead.  One
        that only the source hides is just hidden.
        """
        hiding = UsdGeom.Imageable(mesh).GetVisibilityAttr()
        layers = [spec.layer for spec in hiding.GetPropertyStack()]
        appears = [prim for prim in self._stand_ins if comes_and_goes(prim)]
        return any(layer.GetPrimAtPath(prim.GetPath()) for layer in layers for prim in appears)

    def _body_paths(self) -> set[str]:
        """Meshes that the bake moves: those its Gaussians name, else every one."""
        targets = None
        if self._cloud and (rel := self._cloud.GetRelationship("gaussianFlesh:sourceMeshes")):
            targets = {str(path) for path in rel.GetForwardedTargets()}
        return targets or {str(prim.GetPath()) for prim in self._meshes}

    def _ground(self) -> float | None:
        """Height [m] of the bake's floor; None where none is said."""
        told = self.about.get("looks")
        bake = told.get(self.variant) if isinstance(told, dict) else None
        settings = bake.get("settings") if isinstance(bake, dict) else None
        if not isinstance(settings, dict):
            return None
        if settings.get("floor_normal") is not None:
            self._notes.add("its floor is tilted and is not drawn")
            return None
        floor = settings.get("floor")
        return float(floor) if isinstance(floor, int | float) else None


def _faces_change(prim: Usd.Prim) -> bool:
    mesh = UsdGeom.Mesh(prim) if prim.IsA(UsdGeom.Mesh) else None
    return mesh is not None and mesh.GetFaceVertexIndicesAttr().ValueMightBeTimeVarying()


def _moves(prim: Usd.Prim) -> bool:
    return UsdGeom.Points(prim).GetPointsAttr().GetNumTimeSamples() > 1


def world_points(
    prim: Usd.Prim, time: Usd.TimeCode, xforms: UsdGeom.XformCache, skins: Skins
) -> Floats:
    """(V, 3) points of a mesh or shape, world, stage units."""
    posed = skins.placement(prim) if prim.IsA(UsdGeom.Mesh) else None
    place = posed or Placement.of(xforms.GetLocalToWorldTransform(prim))
    if str(prim.GetTypeName()) in IMPLICIT:
        return place.points(np.asarray(tessellate(prim, time)[0], dtype=np.float64))
    values = UsdGeom.Mesh(prim).GetPointsAttr().Get(time)
    return place.points(np.asarray(values or [], dtype=np.float64).reshape(-1, 3))


def _either(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> Floats | None:
    """An attribute, or its half-precision twin, as doubles."""
    for attribute in (prim.GetAttribute(name), prim.GetAttribute(f"{name}h")):
        values = attribute.Get(time) if attribute else None
        if values is not None and len(values):
            return np.asarray(values, dtype=np.float64)
    return None


VARIANTS, NONE = "gaussianFlesh", "none"  # the variant set of a bake, and the source in it
DISPLAYS = {"mesh", "gaussians", "points"}


def variants_of(stage: Usd.Stage) -> tuple[str, ...]:
    """Names of the bakes in a file, in the order of the variants."""
    names: list[str] = []
    for prim in _switches(stage):
        names += prim.GetVariantSet(VARIANTS).GetVariantNames()
    return tuple(name for name in dict.fromkeys(names) if name != NONE) or _flattened(stage)


def select_variant(stage: Usd.Stage, path: Path, variant: str | None) -> str:
    """Select a variant on every root prim that has it, and its display of meshes; its name.

    variant : None: what is selected in the file, or the first where that is the source.  The name
    is "" where the file holds no bake.

    Raises UsageError where there is no such variant.
    """
    known = variants_of(stage)
    if variant is not None and variant not in known:
        there = (
            f"it holds {', '.join(known)}" if known else "it holds no bake: leave out the variant"
        )
        raise UsageError(f"{path} has no variant {variant!r}.", there)
    prims = _switches(stage)
    if not prims or not known:
        return known[0] if known else ""
    chosen = variant or prims[0].GetVariantSet(VARIANTS).GetVariantSelection()
    if chosen not in known:
        chosen = known[0]
    stage.SetEditTarget(stage.GetSessionLayer())
    for prim in prims:
        prim.GetVariantSet(VARIANTS).SetVariantSelection(chosen)
    for prim in prims:
        sets = prim.GetVariantSets()
        for name in sets.GetNames():
            if "mesh" in displays_in(prim, name):
                sets.SetSelection(name, "mesh")
    return chosen


def displays_in(prim: Usd.Prim, name: str) -> set[str]:
    """The shapes that a variant set switches between; empty where it is no display of ours.

    A bake need not hold all of the shapes.
    """
    names = set(prim.GetVariantSet(name).GetVariantNames())
    return names if name.lower().endswith("display") and names <= DISPLAYS else set()


def _flattened(stage: Usd.Stage) -> tuple[str, ...]:
    """The variant of a bake that is one file, which has no variant set any more."""
    told = stage.GetRootLayer().customLayerData.get(VARIANTS)
    names = told.get("looks") if isinstance(told, dict) else None
    return tuple(names) if isinstance(names, dict) and len(names) == 1 else ()


def _switches(stage: Usd.Stage) -> list[Usd.Prim]:
    """Root prims that carry the variants of a bake."""
    return [
        prim
        for prim in stage.GetPseudoRoot().GetChildren()
        if prim.GetVariantSets().HasVariantSet(VARIANTS)
    ]
