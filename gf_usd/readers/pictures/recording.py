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
from gf_usd.core.units import code_text
from gf_usd.readers.notes import Notes
from gf_usd.readers.pictures.extent import (
    frame_times,
    has_animated_visibility,
    is_ever_visible,
    is_visible,
    motion_boxes,
)
from gf_usd.readers.pictures.floor import TILTED, baked_floor
from gf_usd.readers.pictures.framing import Framing, frame_motion
from gf_usd.readers.pictures.obstacles import Read, add_obstacle_files
from gf_usd.readers.pictures.prims import (
    placed_prims,
    read_float_or_half,
    read_splats,
    replaces_meshes,
    to_render_mesh,
)
from gf_usd.readers.pictures.values import MEASURES, authored_attributes
from gf_usd.readers.usd.implicit import IMPLICIT, tessellate
from gf_usd.readers.usd.mesh import Reading, has_surface, read_surface
from gf_usd.readers.usd.shading import ShadingReader
from gf_usd.readers.usd.skeleton.skins import Skins
from gf_usd.readers.usd.stage import (
    FOR_BAKES,
    SPLAT_TYPE,
    Placement,
    SkippedPrim,
    is_bake_particles,
    is_bake_scope,
    open_stage,
    reading,
    require_composed,
    stage_facts,
)

ONE_SET = "only these Gaussians are shown"  # a note: a recording has one set of Gaussians
PURPOSES = (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)


class BakedMotion:
    """The motion of one variant of a stage.

    Parameters
    ----------
    path : the root layer of a bake, or any USD file with animated meshes or Gaussians.
    variant : None: the one that is selected in the file.
    displayed : for pictures and pages: also with the meshes of files that were obstacles of the
        bake, and framed as pictures are.
    obstacles : those of these files that were read before, to which the others are added.

    Raises
    ------
    InputError : the file does not exist, is not valid USD, or has no animation.
    UsageError : the file has no such variant.
    """

    def __init__(
        self,
        path: Path,
        variant: str | None = None,
        *,
        displayed: bool = False,
        obstacles: Read | None = None,
    ) -> None:
        if not path.is_file():
            reason = "is a folder" if path.is_dir() else "does not exist"
            raise InputError(f"{path} {reason}", "give the root layer that gf-usd bake wrote")
        self._path = path
        self._notes = Notes()
        with reading(path):
            self._stage = open_stage(path)
            self._facts = stage_facts(
                self._stage, path, self._notes, meters_per_unit=None, up_axis=None
            )
            self._displayed = displayed
            self._obstacles: frozenset[str] = frozenset()
            if displayed:
                read = {} if obstacles is None else obstacles
                self._obstacles = add_obstacle_files(
                    self._stage, path, self._facts, self._notes, read
                )
            self.variants = variants_of(self._stage)
            self.variant = select_variant(self._stage, path, variant)
            self._find_prims()

    @property
    def about(self) -> Mapping[str, Any]:
        """The metadata of the bake in the root layer; empty for other files."""
        data = self._stage.GetRootLayer().customLayerData.get(VARIANTS)
        return data if isinstance(data, dict) else {}

    def require_composed(self) -> None:
        """Raise InputError where a layer of the file does not exist or is damaged."""
        require_composed(self._stage, self._path)

    def recording(self) -> Recording:
        """The data of the variant that is constant in time."""
        default = self._stage.GetDefaultPrim()
        up, ground = self._facts.up, self._ground()
        framing = self._framing() if self._displayed else None
        return Recording(
            path=self._path,
            name=default.GetName() if default else self._path.stem,
            variant=self.variant,
            up=(float(up[0]), float(up[1]), float(up[2])),
            ground=ground,
            unit=self._facts.units.length,
            time_codes=tuple(self._times),
            time_codes_per_second=float(self._stage.GetTimeCodesPerSecond()),
            meshes=tuple(self._first_meshes),
            baked=tuple(str(prim.GetPath()) in self._bodies for prim in self._meshes),
            flows=tuple(str(prim.GetPath()) for prim in self._flows),
            vanishing=tuple(str(prim.GetPath()) for prim in self._vanishing),
            converted=tuple(str(p.GetPath()) for p in self._vanishing if self._is_converted(p)),
            gaussians=self._gaussians,
            about=self.about,
            notes=self._notes.lines(without=FOR_BAKES),
            framed=framing and framing.bounds,
            shown_until=framing and framing.until,
        )

    def _framing(self) -> Framing | None:
        """See `framing`; None where nothing is visible."""
        clouds = [self._gaussian_prim] if self._gaussians is not None else []
        shown = [*self._meshes, *self._flows, *clouds]
        boxes = motion_boxes(shown, self._times, self._facts.units.length)
        return boxes.bounds and frame_motion(shown, boxes, boxes.bounds, self._facts.up)

    def frames(
        self, time_codes: Sequence[float] | None = None, *, whole: bool = False
    ) -> Iterator[MotionFrame]:
        """The animated arrays at time codes, by default all, one frame at a time.

        whole : True: invisible meshes have their shape; False: they are collapsed to a point.

        Raises InputError where the length of an array changes, or a value is not finite.
        """
        for code in self._times if time_codes is None else time_codes:
            try:
                with reading(self._path):
                    frame = self._frame(code, whole=whole)
            except SkippedPrim as reason:
                raise InputError(
                    f"{self._path}: at time code {code_text(code)} a prim cannot be shown:"
                    f" {reason}",
                    "run gf-usd check for details, then bake the asset again",
                ) from reason
            yield frame

    def _frame(self, code: float, *, whole: bool) -> MotionFrame:
        time = Usd.TimeCode(code)
        xforms = UsdGeom.XformCache(time)
        skins = Skins(time, xforms, Notes())
        meshes, hidden = [], []
        for number, (prim, shape) in enumerate(zip(self._meshes, self._first_meshes)):
            points = world_points(prim, time, xforms, skins) * self._facts.units.length
            if points.shape != shape.points.shape or not np.isfinite(points).all():
                raise InputError(
                    f"{self._path}: <{prim.GetPath()}> has {len(points)} points at time code "
                    f"{code_text(code)} but {len(shape.points)} at the first one, or some are not"
                    f" finite",
                    "run gf-usd check for details, then bake the asset again",
                )
            if prim in self._vanishing and not is_visible(prim, time):
                hidden.append(number)
                if not whole:
                    points = np.broadcast_to(points.mean(0), points.shape)
            meshes.append(points)
        flows = self._varying_topology_meshes(self._context(time, xforms, skins, Notes()))
        if self._gaussians is None:
            return MotionFrame(
                time_code=code, meshes=tuple(meshes), hidden=tuple(hidden), flows=flows
            )
        positions, axes = self._read_gaussian_frame(time, xforms)
        return MotionFrame(
            time_code=code,
            meshes=tuple(meshes),
            hidden=tuple(hidden),
            flows=flows,
            positions=positions,
            axes=axes,
            measured=self._read_measured(time, len(positions)),
        )

    def _varying_topology_meshes(self, context: Reading) -> tuple[RenderMesh, ...]:
        """The meshes of varying topology at one time."""
        found = []
        for prim in self._flows:
            if has_animated_visibility(prim) and not is_visible(prim, context.time):
                continue
            try:
                surface = read_surface(prim, context)
            except SkippedPrim:  # it is empty at this time
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

    def _read_gaussian_frame(
        self, time: Usd.TimeCode, xforms: UsdGeom.XformCache
    ) -> tuple[Floats, Floats]:
        prim = self._gaussian_prim
        place = Placement.of(xforms.GetLocalToWorldTransform(prim))
        count = len(self._gaussians or ())
        values = {}
        for name, width in (("positions", 3), ("orientations", 4), ("scales", 3)):
            array = read_float_or_half(prim, name, time, width)
            if array is None or len(array) != count or not np.isfinite(array).all():
                raise InputError(
                    f"{self._path}: <{prim.GetPath()}> has {0 if array is None else len(array)}"
                    f" {name} at {time} for {count} Gaussians, or some are not finite",
                    "run gf-usd check for details, then bake the asset again",
                )
            values[name] = array
        # numpy has a quaternion as (x, y, z, w)
        local = gaussian_axes(values["orientations"][:, [3, 0, 1, 2]], values["scales"])
        unit = self._facts.units.length
        return place.points(values["positions"]) * unit, place.matrix[:3, :3].T * unit @ local

    def _read_measured(self, time: Usd.TimeCode, count: int) -> dict[str, Floats]:
        found: dict[str, Floats] = {}
        for name, measure in MEASURES.items():
            stored = [
                attribute.Get(time)
                for attribute in authored_attributes(self._gaussian_prim, measure)
            ]
            whole = [values for values in stored if values is not None and len(values) == count]
            if whole:
                scale = self._facts.units.pressure if measure.unit else 1.0
                found[name] = np.asarray(whole, dtype=np.float64).max(0) * scale
        return found

    def _find_prims(self) -> None:
        """Find meshes, Gaussians and their sample times."""
        prims = list(placed_prims(self._stage, self._notes))
        clouds = [p for p in prims if str(p.GetTypeName()) == SPLAT_TYPE]
        clouds.sort(key=lambda p: not is_bake_particles(p))
        if len(clouds) > 1:
            self._notes.add(ONE_SET, str(clouds[0].GetPath()))
        self._gaussian_prim = clouds[0] if clouds else Usd.Prim()
        candidates = [p for p in prims if has_surface(p)]
        self._bakes = [cloud for cloud in clouds if is_bake_particles(cloud)]
        self._times = frame_times(self._bakes or [*candidates, *clouds])
        if len(self._times) < 2:
            require_composed(self._stage, self._path)
            raise InputError(
                f"{self._path}: nothing in this file moves",
                "bake the asset with gf-usd bake and give the root layer that it writes",
            )
        self._replacements = [prim for prim in prims if replaces_meshes(prim)]
        for prim in prims:
            if (
                prim.IsA(UsdGeom.Points)
                and not is_bake_particles(prim)
                and _has_animated_points(prim)
            ):
                self._notes.add("its points move and are left out", str(prim.GetPath()))
        self._read_first_frame(candidates)

    def _read_first_frame(self, candidates: Sequence[Usd.Prim]) -> None:
        time = Usd.TimeCode(self._times[0])
        xforms = UsdGeom.XformCache(time)
        context = self._context(time, xforms, Skins(time, xforms, self._notes), self._notes)
        self._flows: list[Usd.Prim] = []
        self._meshes: list[Usd.Prim] = []
        self._first_meshes: list[RenderMesh] = []
        for prim in candidates:
            image = UsdGeom.Imageable(prim)
            if not is_ever_visible(prim, time) or image.ComputePurpose() not in PURPOSES:
                continue
            if _has_varying_topology(prim):
                self._flows.append(prim)
                continue
            try:
                surface = read_surface(prim, context)
            except SkippedPrim as reason:
                self._notes.add(f"not shown: {reason}", str(prim.GetPath()))
                continue
            self._meshes.append(prim)
            self._first_meshes.append(to_render_mesh(surface, self._stage, time))
        self._replacements += [prim for prim in self._flows if is_bake_scope(prim.GetParent())]
        self._vanishing = [prim for prim in self._meshes if has_animated_visibility(prim)]
        self._gaussians = self._read_gaussians(context) if self._gaussian_prim else None
        self._bodies = self._body_paths()

    def _read_gaussians(self, context: Reading) -> GaussianSet | None:
        prim, units = self._gaussian_prim, self._facts.units
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
        valid = masses is not None and len(masses) == count
        return GaussianSet(
            name=first.name,
            colors=first.colors,
            opacities=first.opacities,
            rest_scales=scales,
            masses=np.asarray(masses, dtype=np.float64) * units.mass if valid else None,
        )

    def _is_converted(self, mesh: Usd.Prim) -> bool:
        """Whether a bake hides a mesh from some frame on and replaces it by another prim.

        The layer that authors its visibility, a cache or a flattened bake, then also contains the
        prim that appears instead; a mesh hidden by its source layer is not replaced.
        """
        visibility = UsdGeom.Imageable(mesh).GetVisibilityAttr()
        layers = [spec.layer for spec in visibility.GetPropertyStack()]
        appearing = [prim for prim in self._replacements if has_animated_visibility(prim)]
        return any(layer.GetPrimAtPath(prim.GetPath()) for layer in layers for prim in appearing)

    def _body_paths(self) -> set[str]:
        """Paths of the baked meshes: the source meshes of Gaussians of all bakes, else all meshes
        of the stage.

        A shot may reference several bakes.
        """
        named = (prim.GetRelationship("gaussianFlesh:sourceMeshes") for prim in self._bakes)
        targets = {str(path) for rel in named if rel for path in rel.GetForwardedTargets()}
        return targets or {str(prim.GetPath()) for prim in self._meshes} - self._obstacles

    def _ground(self) -> float | None:
        """Height [m] of the floor of the bake; None where unknown or tilted."""
        baked = baked_floor(self.about, self.variant)
        if baked is not None and baked.tilted:
            self._notes.add(TILTED)
        return None if baked is None else baked.height


def _has_varying_topology(prim: Usd.Prim) -> bool:
    mesh = UsdGeom.Mesh(prim) if prim.IsA(UsdGeom.Mesh) else None
    return mesh is not None and mesh.GetFaceVertexIndicesAttr().ValueMightBeTimeVarying()


def _has_animated_points(prim: Usd.Prim) -> bool:
    return UsdGeom.Points(prim).GetPointsAttr().GetNumTimeSamples() > 1


def world_points(
    prim: Usd.Prim, time: Usd.TimeCode, xforms: UsdGeom.XformCache, skins: Skins
) -> Floats:
    """World points (V, 3) of a mesh or implicit shape, in stage units."""
    posed = skins.placement(prim) if prim.IsA(UsdGeom.Mesh) else None
    place = posed or Placement.of(xforms.GetLocalToWorldTransform(prim))
    if str(prim.GetTypeName()) in IMPLICIT:
        return place.points(np.asarray(tessellate(prim, time)[0], dtype=np.float64))
    values = UsdGeom.Mesh(prim).GetPointsAttr().Get(time)
    return place.points(np.asarray(values or [], dtype=np.float64).reshape(-1, 3))


VARIANTS, NONE = (
    "gaussianFlesh",
    "none",
)  # the variant set of a bake, and its variant without a bake
DISPLAYS = {"mesh", "gaussians", "points"}


def variants_of(stage: Usd.Stage) -> tuple[str, ...]:
    """Names of the variants with a bake, in order."""
    names: list[str] = []
    for prim in _prims_with_variants(stage):
        names += prim.GetVariantSet(VARIANTS).GetVariantNames()
    return tuple(name for name in dict.fromkeys(names) if name != NONE) or _flattened_variant(stage)


def select_variant(stage: Usd.Stage, path: Path, variant: str | None) -> str:
    """Select a variant and its display of meshes on all root prims; return its name.

    variant : None: the one that is selected in the file, or the first where that is NONE.
    The name is "" for a file without a bake.

    Raises UsageError for an unknown variant.
    """
    names = variants_of(stage)
    if variant is not None and variant not in names:
        hint = (
            f"it holds {', '.join(names)}" if names else "it holds no bake: leave out the variant"
        )
        raise UsageError(f"{path} has no variant {variant!r}", hint)
    prims = _prims_with_variants(stage)
    if not prims or not names:
        return names[0] if names else ""
    chosen = variant or prims[0].GetVariantSet(VARIANTS).GetVariantSelection()
    if chosen not in names:
        chosen = names[0]
    stage.SetEditTarget(stage.GetSessionLayer())
    for prim in prims:
        prim.GetVariantSet(VARIANTS).SetVariantSelection(chosen)
    for prim in prims:
        sets = prim.GetVariantSets()
        for name in sets.GetNames():
            if "mesh" in displays_in(prim, name):
                sets.SetSelection(name, "mesh")
    return chosen


def shown_variant(stage: Usd.Stage) -> str:
    """Name of the variant that is selected, which may be NONE; "" for a file without a bake."""
    prims = _prims_with_variants(stage)
    if prims:
        return prims[0].GetVariantSet(VARIANTS).GetVariantSelection()
    return "".join(_flattened_variant(stage))


def displays_in(prim: Usd.Prim, name: str) -> set[str]:
    """The variants, a subset of DISPLAYS, of a display variant set of a bake.

    Empty for other variant sets.
    """
    names = set(prim.GetVariantSet(name).GetVariantNames())
    return names if name.lower().endswith("display") and names <= DISPLAYS else set()


def _flattened_variant(stage: Usd.Stage) -> tuple[str, ...]:
    """The variant of a flattened bake, which has no variant set."""
    metadata = stage.GetRootLayer().customLayerData.get(VARIANTS)
    names = metadata.get("looks") if isinstance(metadata, dict) else None
    return tuple(names) if isinstance(names, dict) and len(names) == 1 else ()


def _prims_with_variants(stage: Usd.Stage) -> list[Usd.Prim]:
    """Root prims with the variant set of a bake."""
    return [
        prim
        for prim in stage.GetPseudoRoot().GetChildren()
        if prim.GetVariantSets().HasVariantSet(VARIANTS)
    ]
