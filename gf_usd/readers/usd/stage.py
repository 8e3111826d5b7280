"""Opening of USD stages, their metadata (units, axis, times), and local-to-world placements."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Tf, Usd, UsdGeom, UsdUtils

from gf_usd.core import USD_SUFFIXES
from gf_usd.core.arrays import Floats
from gf_usd.core.asset import ASSUMED, BAKES, FILE, LATEST, OPTION, StageFacts
from gf_usd.core.errors import InputError, plain_parse_error
from gf_usd.core.units import StageUnits
from gf_usd.readers.notes import ANIMATED, POSED, Notes
from gf_usd.system.atomic_files import relative, require_utf8

MAGIC = {b"PXR-USDC": "usdc", b"PK\x03\x04": "usdz", b"#usda": "usda", b"#sdf": "usda"}
NO_TEXT = "it holds bytes that are not UTF-8"
RATES = ("timeCodesPerSecond", "framesPerSecond")
SPLAT_TYPE = "ParticleField3DGaussianSplat"

# Stages that stay open, by the identifier of their root layer; None: none does.
_KEPT: ContextVar[dict[str, Usd.Stage] | None] = ContextVar("_KEPT", default=None)


def is_bake_particles(prim: Usd.Prim) -> bool:
    """True for particles that a bake wrote, whose colors are unlit albedo."""
    return bool(prim.HasAttribute("gaussianFlesh:restPositions"))


def is_bake_scope(prim: Usd.Prim) -> bool:
    """True for the Scope of the prims that a bake adds, by its content: physics materials, which
    name their variant, and prims made of these.

    Its name is not certain: it has a number where the source has a prim of the same name.
    """
    materials = prim.GetChild("Materials")
    if not prim.IsA(UsdGeom.Scope) or not materials or not materials.IsA(UsdGeom.Scope):
        return False
    made = materials.GetChildren()
    ours = bool(made) and all(one.HasAttribute("gaussianFlesh:look") for one in made)
    return ours and len(prim.GetChildren()) > 1  # a fitted material, with such a parent, is alone


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """Context that collects USD diagnostics, and raises USD's errors as InputError."""
    delegate = UsdUtils.CoalescingDiagnosticDelegate()
    try:
        yield
    except (Tf.ErrorException, UnicodeDecodeError) as error:  # the latter: names that are not UTF-8
        fault = _fault(error) if isinstance(error, Tf.ErrorException) else NO_TEXT
        raise InputError(
            f"{path} is damaged: {fault}",
            "export the asset again; a USD viewer should open it before it is baked",
        ) from error
    finally:
        delegate.TakeUncoalescedDiagnostics()


def _fault(error: Tf.ErrorException) -> str:
    """The first line of a USD error, without its location and its names in USD's source.

    Of several errors it is the first with a line of the file, if one has that.
    """
    text = _text(error)
    faults = re.findall(r": '(.*?)'(?:\n|$)", text, re.DOTALL) or [text]
    line = next((fault for fault in faults if re.search(r":\d+:\d+: ", fault)), faults[0])
    return plain_parse_error(_first_line(line))


def _text(error: object) -> str:
    """The text of a USD error, which may quote bytes that are not UTF-8."""
    try:
        return str(error)
    except UnicodeDecodeError:
        return NO_TEXT


def _first_line(text: str) -> str:
    return (text.strip().splitlines() or ["USD gives no reason"])[0].strip()


@contextmanager
def layers_kept() -> Iterator[None]:
    """Context in which the layers of stages that `open_stage` opens stay open.

    USD then parses each file once, and not each time that a stage is opened after the one before it
    was closed. Files must not be written again meanwhile, as their layers would be outdated.
    """
    token = _KEPT.set({} if (outer := _KEPT.get()) is None else outer)
    try:
        yield
    finally:
        _KEPT.reset(token)


def open_stage(path: Path) -> Usd.Stage:
    """The composed stage with all payloads loaded.

    Raises InputError for a file that USD cannot open or that is not USD, and for a rate of time
    codes of zero, with which reading samples would not terminate.
    """
    require_utf8(path)
    with path.open("rb") as file:
        head = file.read(64)
    if not any(head.startswith(magic) for magic in MAGIC):
        if path.suffix.lower() not in USD_SUFFIXES:
            raise InputError(
                f"{path} is not a USD file",
                "give a file of USD: of a mesh file, the root layer that gf-usd bake writes",
            )
        shown = head.split(b"\n")[0][:24].decode("ascii", errors="replace")
        raise InputError(
            f"{path} is not a USD file: it begins with {shown!r}",
            "a text layer begins with '#usda 1.0'; check the type of the file",
        )
    root = Sdf.Layer.FindOrOpen(str(path))
    if root is None:
        raise InputError(
            f"{path} is damaged: USD cannot open it",
            "export the asset again; a USD viewer should open it before it is baked",
        )
    _require_rates(path, root)
    stage = Usd.Stage.Open(root, Usd.Stage.LoadAll)
    for layer in stage.GetUsedLayers():
        _require_rates(path, layer)
    if (kept := _KEPT.get()) is not None:
        kept.setdefault(root.identifier, stage)
    return stage


def require_saved(path: Path, stage: Usd.Stage | None = None) -> None:
    """Raise InputError where a layer of an asset has unsaved edits in this process.

    Written layers reference files, and child processes read files, so that unsaved edits would be
    used in some places only.

    stage : of the asset; None: its layers that are open are checked, without opening a stage.
    """
    require_utf8(path)
    if stage is not None:
        layers = list(stage.GetUsedLayers())
    else:
        root = Sdf.Layer.Find(str(path))
        layers = [] if root is None else [root]
    for layer in layers:  # it grows
        if layer.dirty and not layer.anonymous:
            raise InputError(
                f"{path}: the layer {layer.identifier} has unsaved changes in this program, but"
                " what is baked is the file on disk",
                "save it (layer.Save()) or reload it (layer.Reload()), or export the stage and bake"
                " that file",
            )
        if stage is None:
            names = layer.GetCompositionAssetDependencies()
            found = (Sdf.Layer.FindRelativeToLayer(layer, name) for name in names)
            layers += [one for one in dict.fromkeys(found) if one and one not in layers]


def _require_rates(path: Path, layer: Sdf.Layer) -> None:
    """Raise InputError for a rate that is not a positive number."""
    for key in RATES:
        if layer.pseudoRoot.HasInfo(key):
            rate = layer.pseudoRoot.GetInfo(key)
            known = isinstance(rate, float | int)  # a text layer may author any type
            if not (known and math.isfinite(rate) and rate > 0.0):
                inside = "" if Path(layer.realPath) == path.resolve() else f" in {layer.identifier}"
                shown = f"{rate:g}" if known else f"{_text(rate)!r}, which is not a number"
                raise InputError(
                    f"{path}: {key} = {shown}{inside}; it must be above 0",
                    f"set {key} to the frames per second that the asset was made for, e.g. 24",
                )


def composition_errors(stage: Usd.Stage) -> list[str]:
    """The first line of each error."""
    return [plain_parse_error(_first_line(_text(e))) for e in stage.GetCompositionErrors()]


def require_composed(stage: Usd.Stage, path: Path) -> None:
    """Raise InputError for a stage with a layer that does not exist or is damaged."""
    for error in composition_errors(stage):
        raise InputError(
            f"{path} does not compose: {error}",
            "if it is a bake, move its root layer, its cache and its asset together, and write a"
            " damaged file again; if it is an asset, bake it first with gf-usd bake",
        )


def stage_facts(
    stage: Usd.Stage,
    path: Path,
    notes: Notes,
    *,
    meters_per_unit: float | None,
    up_axis: str | None,
) -> StageFacts:
    """Units, up axis, times and root prims of a stage.

    notes : assumptions are added to it, but are not yet in the result.

    Raises InputError for an invalid unit, axis or time code.
    """
    root = stage.GetRootLayer()
    codes, frames = (
        float(_metadata(stage, key)) if stage.HasAuthoredMetadata(key) else None for key in RATES
    )
    for error in composition_errors(stage):
        notes.add(f"does not compose: {error}")
    default, baked = stage.GetDefaultPrim(), _baked_prim(stage)
    if root.HasDefaultPrim() and not default:
        notes.add(
            f"defaultPrim names '{root.defaultPrim}', which does not exist: all root prims are used"
        )
    unit, unit_from = _meters_per_unit(stage, path, notes, meters_per_unit)
    axis, axis_from = _up_axis(stage, path, notes, up_axis)
    return StageFacts(
        path=path,
        units=StageUnits(
            meters_per_unit=unit,
            kilograms_per_unit=_positive(stage, path, "kilogramsPerUnit") or 1.0,
        ),
        up_axis=axis,
        unit_from=unit_from,
        axis_from=axis_from,
        time_codes_per_second=frames if codes is None else codes,
        frames_per_second=frames,
        start_time_code=_time_code(root.HasStartTimeCode(), root.startTimeCode, path, "start"),
        end_time_code=_time_code(root.HasEndTimeCode(), root.endTimeCode, path, "end"),
        root_prims=tuple(
            str(prim.GetPath())
            for prim in stage.GetPseudoRoot().GetAllChildren()
            if prim.IsDefined() and not prim.IsAbstract()
        ),
        default_prim=str(default.GetPath()) if default else None,
        animated=any(layer.ListAllTimeSamples() for layer in stage.GetUsedLayers()),
        says_physics=any(_is_physics(prim) for prim in _everything(stage)),
        baked_prim=baked,
        baked=baked is not None or bool(_command(root)),
        baked_from=baked_asset(root),
    )


def _baked_prim(stage: Usd.Stage) -> str | None:
    """Path of the root prim with the variant set of a bake; None where there is none."""
    for prim in stage.GetPseudoRoot().GetAllChildren():
        if prim.GetVariantSets().HasVariantSet(BAKES):
            return str(prim.GetPath())
    return None


def baked_asset(layer: Sdf.Layer) -> str:
    """The path of the asset of a bake from the working folder, to be typed in a shell; "": no asset
    is named.

    The command in the root layer has its name.  Where no file of this name is referenced or next to
    the layer, it is the name alone.
    """
    try:
        words = shlex.split(_command(layer))
    except ValueError:  # quotes without an end
        return ""
    if not words[2:]:
        return ""
    name = words[2]
    layers = (layer.ComputeAbsolutePath(one) for one in layer.GetCompositionAssetDependencies())
    places = [*map(Path, layers), Path(layer.realPath).parent / name]
    found = next((one for one in places if one.name == name and one.is_file()), None)
    return shlex.quote(name if found is None else relative(found, Path.cwd()))


def _command(layer: Sdf.Layer) -> str:
    """The command of the bake whose root layer or one file a layer is; "": it is none."""
    data = layer.customLayerData.get(BAKES)
    command = data.get("command") if isinstance(data, dict) else None
    return command if isinstance(command, str) else ""  # other programs may write anything


def _time_code(authored: bool, value: float, path: Path, which: str) -> float | None:
    """The startTimeCode or endTimeCode of the stage; None where it is not authored."""
    if not authored:
        return None
    if not abs(value) <= LATEST:
        raise InputError(
            f"{path}: {which}TimeCode = {value:g}; it must be a number from {-LATEST:g} to"
            f" {LATEST:g}",
            f"author {which}TimeCode in the file, or leave it out",
        )
    return value


def _everything(stage: Usd.Stage) -> Usd.PrimRange:
    return Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())


def _is_physics(prim: Usd.Prim) -> bool:
    names = [prim.GetTypeName(), *prim.GetAppliedSchemas()]
    return any(str(name).startswith("Physics") for name in names)


def _metadata(stage: Usd.Stage, key: str) -> Any:
    """Authored metadata of any type (old exporters write floats instead of doubles)."""
    try:
        return stage.GetMetadata(key)
    except Tf.ErrorException:
        return stage.GetRootLayer().pseudoRoot.GetInfo(key)


def _positive(stage: Usd.Stage, path: Path, key: str) -> float | None:
    """The authored size of a unit; None where it is not authored."""
    if not stage.HasAuthoredMetadata(key):
        return None
    value = _metadata(stage, key)
    if not isinstance(value, float | int) or not (1e-30 < value < 1e30):
        option = " or give --meters-per-unit" if key == "metersPerUnit" else ""
        odd = isinstance(value, float | int) and value > 0.0
        raise InputError(
            f"{path}: {key} = {value!r}; it must be a number "
            + ("from 1e-30 to 1e30" if odd else "above 0"),
            f"author {key} in the file{option}",
        )
    # A unit rounded to single precision (0.00999999977...) is restored to its short decimal.
    single = np.float32(value)
    return float(str(single)) if float(single) == value else float(value)


def _meters_per_unit(
    stage: Usd.Stage, path: Path, notes: Notes, override: float | None
) -> tuple[float, str]:
    """[m] size of the unit of length, and its origin (FILE, OPTION or ASSUMED)."""
    if override is not None:
        if not (math.isfinite(override) and override > 0.0):
            raise InputError(
                f"--meters-per-unit {override:g} is not a valid unit size",
                "give the size of the file's unit in meters, e.g. 0.01 for centimeters",
            )
        notes.add(f"metersPerUnit = {override:g}, as requested")
        return override, OPTION
    authored = _positive(stage, path, "metersPerUnit")
    if authored is None:
        notes.add(
            "metersPerUnit is not authored: 0.01 (centimeters), the default of USD, is assumed"
        )
        return float(UsdGeom.LinearUnits.centimeters), ASSUMED
    return authored, FILE


def _up_axis(stage: Usd.Stage, path: Path, notes: Notes, override: str | None) -> tuple[str, str]:
    """Y or Z, and its origin (FILE, OPTION or ASSUMED)."""
    hint = "give --up-axis Y or --up-axis Z"
    if override is not None:
        axis = override.upper()
        if axis not in ("Y", "Z"):
            raise InputError(f"up axis {override!r}: USD allows only Y and Z", hint)
        notes.add(f"upAxis = {axis}, as requested")
        return axis, OPTION
    if not stage.HasAuthoredMetadata("upAxis"):
        notes.add("upAxis is not authored: Y, the default of USD, is assumed")
        return "Y", ASSUMED
    axis = str(_metadata(stage, "upAxis"))
    if axis not in ("Y", "Z"):
        raise InputError(f"{path}: upAxis = {axis!r}; USD allows only Y and Z", hint)
    return axis, FILE


# Determinant over scale^3 below which a 3 x 3 matrix is singular in double precision.
FLAT = 1e-12

# The note on a mesh whose animation is replaced by the simulation.
CHANGES = "its topology changes over time: that of the first frame is used"
FOR_BAKES = (ANIMATED, POSED, CHANGES)  # notes that do not apply to rendering


class SkippedPrim(Exception):
    """The prim is skipped; the text is the reason."""


@dataclass(frozen=True)
class Placement:
    """x_world = x M (row vectors), M the 4 x 4 local-to-world matrix."""

    matrix: Floats  # (4, 4)

    @property
    def skinned(self) -> bool:
        """True where the points are skinned to a skeleton."""
        return False

    @classmethod
    def of(cls, matrix: Gf.Matrix4d) -> Placement:
        """The placement by a matrix; raises SkippedPrim where it is not finite or singular."""
        rows = np.array(matrix, dtype=np.float64)
        if not np.isfinite(rows).all():
            raise SkippedPrim("its transform is not finite")
        scale = np.linalg.norm(rows[:3, :3], axis=1)
        det = float(np.linalg.det(rows[:3, :3]))
        if abs(det) <= FLAT * float(scale.max()) ** 3:
            raise SkippedPrim(f"its transform flattens it (determinant {det:.3g})")
        return cls(rows)

    @property
    def mirrored(self) -> bool:
        """True where the placement reverses the winding."""
        return bool(np.linalg.det(self.matrix[:3, :3]) < 0.0)

    def points(self, points: Floats) -> Floats:
        """(V, 3) local to world."""
        return points @ self.matrix[:3, :3] + self.matrix[3, :3]

    def normals(self, normals: Floats, carriers: NDArray[np.int64]) -> Floats:
        """(K, 3) local to world by the inverse transpose, not normalized.

        carriers : (K,) the point of each normal, used for skinned placements only.
        """
        del carriers
        return normals @ np.linalg.inv(self.matrix[:3, :3]).T


def upwards(prim: Usd.Prim) -> Iterator[Usd.Prim]:
    """The prim and its ancestors, without the pseudo-root."""
    while prim and not prim.IsPseudoRoot():
        yield prim
        prim = prim.GetParent()
