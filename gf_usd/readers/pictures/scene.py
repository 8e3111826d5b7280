"""A stage for rendering: its visible prims at a time, and its extent over the animation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from gf_usd.core.arrays import Floats
from gf_usd.core.asset import Texture
from gf_usd.core.errors import InputError, UsageError, did_you_mean
from gf_usd.core.scene import (
    Bounds,
    Camera,
    Motion,
    RenderEllipsoids,
    RenderMesh,
    RenderSplats,
    Scene,
)
from gf_usd.core.units import code_text
from gf_usd.readers.notes import Notes
from gf_usd.readers.pictures.camera import find_camera, read_camera
from gf_usd.readers.pictures.extent import (
    HEALTH,
    MotionBoxes,
    is_drawn,
    is_ever_visible,
    motion_bounds,
    motion_boxes,
    sample_times,
)
from gf_usd.readers.pictures.floor import (
    TILTED,
    baked_floor,
    guessed_height,
    lowest_height,
    plane_height,
)
from gf_usd.readers.pictures.framing import frame_motion
from gf_usd.readers.pictures.obstacles import add_obstacle_files
from gf_usd.readers.pictures.prims import (
    as_ellipsoids,
    baked_bodies,
    placed_prims,
    read_points,
    read_splats,
    replaces_meshes,
    to_render_mesh,
)
from gf_usd.readers.pictures.recording import VARIANTS, displays_in, shown_variant
from gf_usd.readers.pictures.values import Values
from gf_usd.readers.usd.mesh import Reading, has_surface, read_surface
from gf_usd.readers.usd.shading import ShadingReader
from gf_usd.readers.usd.skeleton.skins import Skins
from gf_usd.readers.usd.stage import (
    FOR_BAKES,
    SPLAT_TYPE,
    Placement,
    SkippedPrim,
    is_bake_particles,
    open_stage,
    reading,
    require_composed,
    stage_facts,
)

# values of `show`: kinds of prims, and the display variant of a bake that contains them
SHOWS: dict[str, tuple[tuple[str, ...], str]] = {
    "mesh": (("mesh", "splats", "grains"), "mesh"),
    "splats": (("splats", "mesh"), "mesh"),  # captured Gaussians of the asset
    "gaussians": (("gaussians", "splats"), "gaussians"),
    "ellipsoids": (("gaussians", "splats"), "gaussians"),
    "points": (("points",), "points"),
    "both": (("mesh", "splats", "gaussians", "grains"), "mesh"),
}

KINDS = ("mesh", "splats", "gaussians", "points")
# for bakes with visible Gaussians and meshes, such as flowing bodies with obstacles
WITH_MESHES = (SHOWS["both"][0], "gaussians")

PURPOSES = (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)

EMPTY = "pictures of times at which nothing is visible are empty"  # a note
FALLEN = "falls out of the picture, which is fitted to the rest; --camera chooses another view"


class PictureStage:
    """A stage to render: scenes at time codes, cameras and the extent of the motion.

    Parameters
    ----------
    path : a USD file.
    show : "mesh", "splats", "gaussians", "ellipsoids", "points" or "both"; None: the first of mesh,
        splats, gaussians and points that the stage contains.
    camera : prim path of a camera of the stage; None: the caller's camera.
    color : a row of `values.MEASURES` for false colors of baked prims; None: own colors.
    variant : of a bake; None: the one that is selected in the file.

    Raises
    ------
    InputError : the file does not exist, is not USD, contains no visible prim of that kind or no
        such camera, or the bake does not contain the quantity.
    UsageError : an unknown `show` or `color`.
    """

    def __init__(
        self,
        path: Path,
        show: str | None = None,
        *,
        camera: str | None = None,
        color: str | None = None,
        variant: str | None = None,
    ) -> None:
        if show is not None and show not in SHOWS:
            raise UsageError(f"unknown --show {show}", f"choose one of: {', '.join(SHOWS)}")
        if not path.is_file():
            reason = "is a folder" if path.is_dir() else "does not exist"
            raise InputError(f"{path} {reason}", "give the USD file to draw")
        self._path = path
        self._stage_notes = Notes()
        with reading(path):
            self._stage = open_stage(path)
            if variant is not None:
                _select_variant(self._stage, path, variant)
            self._facts = stage_facts(
                self._stage, path, self._stage_notes, meters_per_unit=None, up_axis=None
            )
            kinds_present = self._visible_kinds()
            self.show = show or next((kind for kind in KINDS if kind in kinds_present), "mesh")
            kinds, display = SHOWS[self.show]
            if show is None and {"mesh", "gaussians"} <= kinds_present:
                kinds, display = WITH_MESHES
            self._select_display(display)
            self._prims = self._drawn_prims(kinds)
            self._camera = find_camera(self._stage, path, camera) if camera else None
            pressure = self._facts.units.pressure
            self.values = Values(self._stage, color, path, pressure) if color else None
        if not self._prims and self._kinds_with_prims(kinds):
            raise self._all_invisible_error()
        if not self._prims:
            require_composed(self._stage, path)
            kinds_present = (
                ", ".join(sorted({kind for kind, _ in self._drawable_prims()})) or "nothing to draw"
            )
            raise InputError(
                f"{path}: it contains no visible {' or '.join(SHOWS[self.show][0])}",
                f"it contains {kinds_present}: choose with --show",
            )
        with reading(path):
            # only now: a stage of which nothing else can be drawn is refused
            if add_obstacle_files(self._stage, path, self._facts, self._stage_notes, {}):
                more = kinds if show is not None else (*kinds, "mesh")
                self._prims = self._drawn_prims(more)
        self._motion: Motion | None = None
        self._textures: dict[tuple[object, ...], Texture] = {}  # decoded once for a film

    @property
    def motion(self) -> Motion:
        """The extent over the whole time range; cached.

        The box is the one to fit an image to: see `gf_usd.readers.pictures.framing`.
        The floor is that of the bake: see `gf_usd.readers.pictures.floor`.  Times at which nothing
        is visible are ignored.
        """
        if self._motion is None:
            prims = [prim for _, prim in self._prims]
            moving = [*prims, *([self._camera.GetPrim()] if self._camera else [])]
            with reading(self._path):
                times = self._played(sample_times(moving))
                boxes = motion_boxes(prims, times, self._facts.units.length)
                full_bounds = boxes.bounds
                visible_times = (
                    t for t in times if any(is_drawn(p, Usd.TimeCode(t)) for p in prims)
                )
                start = [*islice(visible_times, 1)]
                first = motion_bounds(prims, start, self._facts.units.length)
            up, bounds, until = self._facts.up, full_bounds, None
            if full_bounds is not None and self._camera is None:
                framing = frame_motion(prims, boxes, full_bounds, up)
                bounds, until = framing.bounds, framing.until
                for path in framing.fallen:
                    self._stage_notes.add(FALLEN, path)
            self._motion = Motion(
                bounds=bounds,
                framed=boxes.outline()
                if bounds is full_bounds or bounds is None
                else bounds.corners,
                up=(float(up[0]), float(up[1]), float(up[2])),
                ground=self._floor_height(boxes, full_bounds, first),
                time_codes=tuple(times),
                shown_until=until,
                frames_per_second=float(self._stage.GetFramesPerSecond()),
                time_codes_per_second=float(self._stage.GetTimeCodesPerSecond()),
            )
        return self._motion

    def _played(self, times: list[float]) -> list[float]:
        """Of a bake, the times in the range of its stage: the asset may be animated for longer."""
        root = self._stage.GetRootLayer()
        if VARIANTS not in root.customLayerData:
            return times
        return [t for t in times if root.startTimeCode <= t <= root.endTimeCode] or times

    def bodies_and_obstacles(self) -> tuple[frozenset[str], frozenset[str]]:
        """Paths of the drawn prims that a bake moves, and of the meshes that may hide them.

        A mesh whose own points move may be a part of a body, such as its clothes, and hides none.
        """
        baked = baked_bodies(self._stage)
        drawn = {str(prim.GetPath()): (kind, prim) for kind, prim in self._prims}
        rigid = {
            path
            for path, (kind, prim) in drawn.items()
            if kind == "mesh" and not prim.GetAttribute("points").ValueMightBeTimeVarying()
        }
        return frozenset(baked & drawn.keys()), frozenset(rigid - baked)

    def _floor_height(
        self, boxes: MotionBoxes, whole: Bounds | None, first: Bounds | None
    ) -> float | None:
        """Height [m] of the floor; None: none is drawn."""
        up = self._facts.up
        metadata = self._stage.GetRootLayer().customLayerData.get(VARIANTS)
        about = metadata if isinstance(metadata, dict) else {}
        baked = baked_floor(about, shown_variant(self._stage))
        if baked is None or (baked.height is None and not baked.tilted):
            unit = self._facts.units.length
            plane = plane_height(self._stage, self._time(None), up, unit, first)
            if plane is not None:
                return plane
        if baked is None:
            return guessed_height(boxes, whole, first, up)
        if baked.tilted:
            self._stage_notes.add(TILTED)
            return None
        return lowest_height(boxes, whole, up) if baked.height is None else baked.height

    def scene(self, time_code: float | None = None) -> Scene:
        """The visible prims at a time code; None: the first of the stage.

        The scene is empty where all prims are invisible at that time, but not always.

        Raises InputError for invalid meshes, and where nothing can be drawn.
        """
        time = self._time(time_code)
        notes = Notes()
        with reading(self._path):
            context = self._context(time, notes)
            drawn = [
                item for kind, prim in self._prims if (item := self._read(kind, prim, context))
            ]
            hidden = any(not is_drawn(prim, time) for _, prim in self._prims)
        if not drawn:
            if hidden and self.motion.bounds is not None:
                notes.add(EMPTY)
            elif reasons := notes.lines():
                raise InputError(
                    f"{self._path}: nothing can be drawn at {time}: {'; '.join(reasons)}",
                    "check the file with usdview, or choose another --frame",
                )
            else:
                raise self._all_invisible_error()
        clouds = [item for item in drawn if isinstance(item, RenderSplats)]
        ellipsoids = [item for item in drawn if isinstance(item, RenderEllipsoids)]
        if self.show == "ellipsoids":
            clouds, ellipsoids = [], [as_ellipsoids(cloud) for cloud in clouds]
        return Scene(
            up=self.motion.up,
            meshes=tuple(item for item in drawn if isinstance(item, RenderMesh)),
            splats=tuple(clouds),
            ellipsoids=tuple(ellipsoids),
            ground=self.motion.ground,
            # notes for bakes do not concern images
            notes=(
                *self._stage_notes.lines(),
                *notes.lines(without=FOR_BAKES),
                *self._value_notes(),
            ),
        )

    def require_time(self, time_code: float | None) -> None:
        """Raise UsageError for a time code outside the motion; never for a stage without motion."""
        times = self.motion.time_codes
        if time_code is not None and times and not times[0] <= time_code <= times[-1]:
            raise UsageError(
                f"--frame {code_text(time_code)} is outside the motion of {self._path}",
                f"its time codes run from {code_text(times[0])} to {code_text(times[-1])}",
            )

    def speeds(self, codes: Sequence[float]) -> Floats | None:
        """A measure of speed (n,) at time codes: the square root of the kinetic energy of bakes.

        None where the stage has no such attribute.
        """
        found = [a for prim in self._stage.Traverse() if (a := prim.GetAttribute(HEALTH))]
        kinetic = [[a.Get(code) or 0.0 for code in codes] for a in found]
        return np.sqrt(np.maximum(np.sum(kinetic, axis=0), 0.0)) if kinetic else None

    def camera(self, time_code: float | None, aspect: float) -> Camera | None:
        """The camera of the stage at a time, for an aspect ratio width / height; None: not chosen.

        Raises InputError for an invalid camera.
        """
        if self._camera is None:
            return None
        with reading(self._path):
            time, unit = self._time(time_code), self._facts.units.length
            return read_camera(self._camera, time, unit, self._path, aspect)

    def _value_notes(self) -> list[str]:
        return self.values.notes if self.values else []

    def _context(self, time: Usd.TimeCode, notes: Notes) -> Reading:
        xforms = UsdGeom.XformCache(time)
        return Reading(
            path=self._path,
            time=time,
            meters_per_unit=self._facts.units.length,
            xforms=xforms,
            skins=Skins(time, xforms, notes),
            shadings=ShadingReader(time, notes, self._textures),
            notes=notes,
        )

    def _read(
        self, kind: str, prim: Usd.Prim, context: Reading
    ) -> RenderMesh | RenderSplats | RenderEllipsoids | None:
        """Read one prim; None where it is invisible, or, with a note, where it is skipped."""
        if not is_drawn(prim, context.time):
            return None
        try:
            if kind == "mesh":
                mesh = to_render_mesh(read_surface(prim, context), self._stage, context.time)
                return replace(mesh, values=self._mesh_values(prim, context.time))
            place = Placement.of(context.xforms.GetLocalToWorldTransform(prim))
            values = self.values.of_particles(prim, context.time) if self.values else None
            read = read_points if kind in ("points", "grains") else read_splats
            unit = context.meters_per_unit
            return read(prim, context.time, place, unit, context.notes, values)
        except SkippedPrim as reason:
            context.notes.add(f"not drawn: {reason}", str(prim.GetPath()))
            return None

    def _mesh_values(self, prim: Usd.Prim, time: Usd.TimeCode) -> np.ndarray | None:
        """Values (V,) of the quantity at the vertices of a mesh; None where it has none."""
        where = str(prim.GetPath())
        cloud = self.values.particles_of(where) if self.values else None
        if self.values is None or cloud is None:
            return None
        first = self._context(cloud.first, Notes())
        if not self.values.is_bound(where):
            place = Placement.of(first.xforms.GetLocalToWorldTransform(cloud.prim))
            positions = np.asarray(cloud.prim.GetAttribute("positions").Get(cloud.first))
            vertices = read_surface(prim, first).points
            self.values.bind_mesh(where, vertices, place.points(positions) * first.meters_per_unit)
        return self.values.of_mesh(cloud, where, time)

    def _time(self, time_code: float | None) -> Usd.TimeCode:
        if time_code is not None:
            return Usd.TimeCode(time_code)
        start = self._facts.start_time_code
        return Usd.TimeCode.EarliestTime() if start is None else Usd.TimeCode(start)

    def _drawable_prims(self) -> list[tuple[str, Usd.Prim]]:
        """All drawable prims with their kinds, including invisible ones."""
        found = []
        for prim in placed_prims(self._stage, self._stage_notes):
            name = str(prim.GetTypeName())
            if has_surface(prim):
                found.append(("mesh", prim))
            elif name == SPLAT_TYPE:
                found.append(("gaussians" if is_bake_particles(prim) else "splats", prim))
            elif replaces_meshes(prim):
                found.append(("grains", prim))
            elif prim.IsA(UsdGeom.Points):
                found.append(("points", prim))
        return found

    def _kinds_with_prims(self, kinds: tuple[str, ...]) -> set[str]:
        """Those kinds for which there are prims of a rendered purpose, visible or not."""
        return {
            kind
            for kind, prim in self._drawable_prims()
            if kind in kinds and UsdGeom.Imageable(prim).ComputePurpose() in PURPOSES
        }

    def _all_invisible_error(self) -> InputError:
        kinds = SHOWS[self.show][0]
        hidden = sorted(self._kinds_with_prims(kinds))
        reason = "every mesh is" if hidden == ["mesh"] else f"all {' and '.join(hidden)} are"
        return InputError(
            f"{self._path}: it contains no visible {' or '.join(kinds)}: {reason} invisible",
            "make it visible, with all prims above it, or choose another kind with --show",
        )

    def _drawn_prims(self, kinds: tuple[str, ...]) -> list[tuple[str, Usd.Prim]]:
        """Prims of these kinds to draw, including particles that a display variant hides."""
        time = self._time(None)
        return [
            (kind, prim)
            for kind, prim in self._drawable_prims()
            if kind in kinds
            and UsdGeom.Imageable(prim).ComputePurpose() in PURPOSES
            and (is_ever_visible(prim, time) or is_bake_particles(prim))
        ]

    def _visible_kinds(self) -> set[str]:
        time = self._time(None)
        return {kind for kind, prim in self._drawable_prims() if is_ever_visible(prim, time)}

    def _select_display(self, display: str) -> None:
        """Select a display variant of bakes in the session layer."""
        self._stage.SetEditTarget(self._stage.GetSessionLayer())
        for prim in self._stage.GetPseudoRoot().GetChildren():
            sets = prim.GetVariantSets()
            for name in sets.GetNames():
                if display in displays_in(prim, name):
                    sets.SetSelection(name, display)


def read_scene(path: Path, time_code: float | None = None, show: str | None = None) -> Scene:
    """The visible prims of a stage at a time code; see `PictureStage`."""
    return PictureStage(path, show).scene(time_code)


def _select_variant(stage: Usd.Stage, path: Path, variant: str) -> None:
    """Select a variant of a bake in the session layer.

    Raises UsageError where no root prim has this variant.
    """
    sets = [prim.GetVariantSet(VARIANTS) for prim in stage.GetPseudoRoot().GetChildren()]
    known = sorted({name for variant_set in sets for name in variant_set.GetVariantNames()})
    if variant not in known:
        listed = (
            f"choose one of {', '.join(known)}"
            if known
            else "it has no variants: leave out --variant"
        )
        guess = did_you_mean(variant, known)
        raise UsageError(f"{path} has no variant {variant!r}", f"{guess}{listed}")
    stage.SetEditTarget(stage.GetSessionLayer())
    for variant_set in sets:
        if variant in variant_set.GetVariantNames():
            variant_set.SetVariantSelection(variant)
