"""The options of a bake: one row each.

The command line, `gf_usd.bake`, batch manifests, the recorded command and the tables of
docs/guide/options.md are generated from the rows.  Annotations are read when the classes are made,
so they are not strings.
Nothing here loads NumPy, because ``gf-usd --help`` imports this module.
"""

import os
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Any, Literal

from gf_usd.core.errors import UsageError, did_you_mean, meant
from gf_usd.prepare.options import texts, values
from gf_usd.prepare.options.option import BAKE, BATCH, Option, command_arguments, rows, table
from gf_usd.prepare.options.sweep import parse_sweep
from gf_usd.prepare.options.values import Corners, Vector

if TYPE_CHECKING:
    from gf_usd.core.materials.material import Material
    from gf_usd.system.sandbox import Limits

# What Python may give where the command line has a text.
Path = str | os.PathLike[str]
Boxes = Mapping[str, Corners | Sequence[Corners]] | str | Sequence[str]
Labels = Mapping[str, Mapping[int, str]] | str | Sequence[str]
Floor = float | Vector | tuple[float, Vector] | Literal[False] | str

# headings of docs/guide/options.md
ASSET = "Asset and files"
PARTICLES = "Particles"
TIME = "Time"
SCENE = "Scene"
MATERIAL = "Material"
METHOD = "Method"
WRITE = "Output"

# [h] `bake` refuses to take longer unasked.  Bakes of presets take minutes at 400k particles; what
# takes hours is mostly a modulus in the wrong unit.
MAX_HOURS = 1.0


# fmt: off
@table
class AssetOptions:
    """The asset, its material, and the output file."""

    material: Annotated["Path | Material | Sequence[Path | Material] | None", Option(
        ASSET, "A preset (see gf-usd materials) or a USD file with a material; separate several"
        " by commas to get variants. auto chooses presets by names and labels; auto:NAME uses"
        " the advisor NAME.",
        shown="the stage's, else rubber", short="-m",
        write=values.material,
    )] = None
    output: Annotated[Path | None, Option(
        ASSET, "Path of the root layer or package (.usdz), or a folder (an existing one, or a"
        " path that ends in /).",
        shown="NAME.MATERIAL.usda in this folder", short="-o", commands=BAKE, write=values.path,
    )] = None
    prims: Annotated[str | Sequence[str], Option(
        ASSET, "Bake this prim and its descendants; repeatable.",
        shown="the default prim",
        write=values.prims,
    )] = ()
    meters_per_unit: Annotated[float | None, Option(
        ASSET, "Length of one unit of the file [m]: 0.01 for centimeters.",
        shown="the file's; if it has none, 1, or 0.01 or 0.001 if only that gives a plausible"
        " size",
    )] = None
    up_axis: Annotated[str | None, Option(
        ASSET, "Up axis of the file: Y or Z; -Y or -Z for splat files that appear upside down.",
        shown="the file's; Y for obj, ply, off and splat files, Z for stl",
    )] = None
    repair: Annotated[bool, Option(
        ASSET, "Before filling, close small holes, make the winding consistent, drop faces that"
        " bound no volume and thicken sheets; the mesh itself does not change.",
        commands=BATCH,
    )] = False
    law: Annotated[str | None, Option(
        MATERIAL, "Compute stresses with this constitutive law, such as corotated or neoHookean.",
        shown="the material's",
    )] = None


@table
class RequestOptions:
    """Options that determine a plan; None where an option is not set."""

    particles: Annotated[int | None, Option(
        PARTICLES, "Fill the bodies with about this many particles.",
        shown="8000; to 32000 for thin parts", above_zero=True,
    )] = None
    spacing: Annotated[float | None, Option(
        PARTICLES, "Place particles about this far apart [stage units].",
        above_zero=True,
    )] = None
    max_edge_length: Annotated[float | str | None, Option(
        PARTICLES, "Divide faces of meshes, and refine cages of subdivision surfaces, whose edges"
        " are longer than this [stage units], in a layer over the asset, so that coarse meshes show"
        " how their bodies bend; auto: two spacings of --particles.",
        shown="meshes keep their faces", parse=texts.parse_edge_length, write=values.edge,
    )] = None
    seed: Annotated[int | None, Option(
        PARTICLES, "Random seed of the positions of particles that flow, of all with --preset"
        " paper, and of noise fields.",
        shown="the stage's, else 0", low=0, high=2**31 - 1,
    )] = None
    frames: Annotated[int | str | None, Option(
        TIME, "Number of frames to simulate, at --fps. rest: until everything is at rest;"
        " rest:480: the same, but at most 480 frames.",
        shown="rest, at most 136 T; 13.6 T with pins or fields, or without a floor or"
        " obstacle, and as long as those move. T = sqrt(r / g), r the radius of the body",
        noun="number of frames",
        parse=texts.parse_frames, write=values.frames,
    )] = None
    fps: Annotated[float | None, Option(
        TIME, "Frames per second of playback.",
        shown="the asset's, else 24", above_zero=True,
    )] = None
    start: Annotated[float | None, Option(
        TIME, "Time code of the first frame.",
        shown="the asset's start, else 1", noun="time code",
    )] = None
    time_scale: Annotated[float | str | None, Option(
        TIME, "Simulated seconds per second of playback; auto makes a body of any size appear to"
        " move like one of 1 m.",
        shown="1", parse=texts.parse_time_scale, write=values.rate,
    )] = None
    settle_only: Annotated[bool, Option(
        TIME, "Simulate until everything is at rest, for at most --frames, and write only that"
        " pose, without time samples.",
    )] = False
    drop: Annotated[float | str | None, Option(
        SCENE, "Height from which the body falls [stage units], or in radii of the body: 3r.",
        shown="3r; not moved if the stage has physics, with --pin, or without a floor",
        parse=texts.parse_drop, write=values.length,
    )] = None
    gravity: Annotated[float | Vector | str | None, Option(
        SCENE, "Gravity [m/s^2]: a number (downward), a vector x,y,z, or a .csv or .txt file"
        " with a time code and the gravity on each line.",
        shown="the stage's, else 9.81", parse=texts.parse_gravity, write=values.gravity,
    )] = None
    fields: Annotated[str | Sequence[str], Option(
        SCENE, "Add an acceleration field [m/s^2]; repeatable: wind:X,Y,Z, radial:A:at=X,Y,Z (A"
        " below 0 attracts) or noise:A:length=L:rate=R. With at=X,Y,Z and radius=R the field"
        " falls off around that point [stage units].",
        shown="none", write=values.fields,
    )] = ()
    floor: Annotated[Floor | None, Option(
        SCENE, "Height of the floor [stage units], its normal x,y,z, or both: 0.5:0.2,1,0; none"
        " for no floor.",
        shown="0", parse=texts.parse_floor, write=values.floor,
    )] = None
    velocity: Annotated[Vector | str | None, Option(
        SCENE, "Initial velocity x,y,z of all bodies [stage units per second].",
        shown="the stage's", parse=texts.parse_velocity, write=values.vector,
    )] = None
    spin: Annotated[Vector | str | None, Option(
        SCENE, "Initial angular velocity x,y,z of each body about its center [degrees per second].",
        shown="the stage's", parse=texts.parse_spin, write=values.vector,
    )] = None
    colliders: Annotated[Path | Sequence[Path], Option(
        SCENE, "File whose meshes are static obstacles; repeatable. Like obstacles of the stage,"
        " they replace the floor.",
        shown="none", write=values.paths,
    )] = ()
    drag: Annotated[float | None, Option(
        SCENE, "Drag coefficient that slows all motion down, like air [1/s].",
        shown="0", low=0.0, high=1e6,
    )] = None
    rolling_resistance: Annotated[float | None, Option(
        SCENE, "Coefficient of rolling resistance on the floor and obstacles: the moment that"
        " opposes rolling, divided by weight and radius.",
        shown="0.05; 0 with --preset paper", low=0.0, high=1.0,
    )] = None
    no_settling: Annotated[bool, Option(
        SCENE, "Turn off the damping of bounces below half a radius and of motion too small to"
        " see.",
    )] = False
    device: Annotated[Literal["cpu", "cuda"], Option(
        METHOD, "Compute on the CPU, or on a GPU with CUDA.", choices=("cpu", "cuda"),
    )] = "cpu"
    threads: Annotated[int | None, Option(
        METHOD, "Number of CPU threads.", shown="all", low=1, high=1024, decides=False,
    )] = None
    pins: Annotated[str | Corners | Sequence[str | Corners], Option(
        SCENE, "Region to pin, or to move with the asset's animation; repeatable. A"
        " GeomSubset, a mesh or a prim above meshes, box:x0,y0,z0,x1,y1,z1 [stage units],"
        " paint:PRIMVAR for faces with a painted weight of at least 0.5, or joint:NAME for faces"
        " with a joint weight of at least 0.5.",
        shown="nothing", write=values.pins,
    )] = ()
    rigid: Annotated[str | Corners | Sequence[str | Corners], Option(
        SCENE, "Region that moves as a rigid body; repeatable. Regions are written as for --pin;"
        " a GeomSubset selects the part of the body nearest to its faces.",
        shown="nothing", write=values.pins,
    )] = ()
    flesh: Annotated[bool, Option(
        SCENE, "Make a character soft around its skeleton (UsdSkel or a glTF skin; else the"
        " medial axis of animated points; captured Gaussians follow the nearest bones of the only"
        " skeleton): the bind pose is the rest shape, a core around each"
        " bone moves with its joint, and the remaining flesh moves freely.",
    )] = False
    bone_radius: Annotated[float | None, Option(
        SCENE, "For --flesh: radius of the rigid cores around the bones, as a fraction of the"
        " distance from bone to skin.",
        shown="0.5", low=0.05, high=1.0,
    )] = None
    goal_frequency: Annotated[float | None, Option(
        SCENE, "For --flesh: frequency [Hz] of the springs that pull the flesh to the skinned"
        " pose.",
        shown="4 if a goal is painted, else no springs", above_zero=True,
    )] = None
    goal_damping: Annotated[float | None, Option(
        SCENE, "Damping ratio of the springs of --goal-frequency; 1 is critical"
        " damping.", shown="0.5", low=0.0, high=100.0,
    )] = None
    squish: Annotated[float | None, Option(
        SCENE, "For --flesh: smallest distance from flesh to bone, relative to the distance at"
        " rest.",
        shown="no limit", low=0.05, high=0.95,
    )] = None
    stretch: Annotated[float | None, Option(
        SCENE, "For --flesh: largest distance of flesh from its skinned pose, relative to its"
        " distance from the bone at rest.",
        shown="no limit", low=0.05, high=10.0,
    )] = None
    preroll: Annotated[int | None, Option(
        SCENE, "For --flesh: number of frames from the bind pose to the first pose; they are"
        " simulated but not written.",
        shown="enough to keep accelerations below that of gravity, and at least one second", low=1,
    )] = None
    loop: Annotated[bool | int | str | None, Option(
        SCENE, "For --flesh: repeat a cyclic animation this many times and write the last cycle;"
        " without a number, or with auto, repeat until the motion is periodic.",
        shown="1", parse=texts.parse_loop, write=values.repeats, bare=texts.AUTO,
    )] = None
    combine: Annotated[bool, Option(
        SCENE, "Treat all meshes as one body, even if they do not touch.",
    )] = False
    self_contact: Annotated[bool | None, Option(
        SCENE, "Let bodies collide with themselves.",
        shown="yes, except for nearly convex bodies; no with --preset paper and --solver ul",
    )] = None
    damping_time: Annotated[float | None, Option(
        MATERIAL, "Kelvin-Voigt damping time of vibrations [s]; a larger value damps more, and"
        " makes the bake slower.", shown="the material's", low=0.0, high=1e6,
    )] = None
    friction: Annotated[float | None, Option(
        MATERIAL, "Coulomb friction coefficient; 0 is frictionless.",
        shown="the material's", low=0.0, high=100.0,
    )] = None
    restitution: Annotated[float | None, Option(
        MATERIAL, "Coefficient of restitution of one contact sample on its spring, 0 to 1; how far"
        " a body rebounds depends on --damping-time.",
        shown="the material's", low=0.0, high=1.0,
    )] = None
    material_boxes: Annotated[Boxes, Option(
        MATERIAL, "Preset for the particles that are in a box at rest, PRESET:x0,y0,z0,x1,y1,z1"
        " [stage units]; repeatable, later boxes override earlier ones.",
        shown="nothing", write=values.boxes,
    )] = ()
    material_labels: Annotated[Labels, Option(
        MATERIAL, "Preset for captured Gaussians with a label, NAME=VALUE:PRESET; repeatable.",
        shown="nothing", write=values.labels,
    )] = ()
    conversions: Annotated[str | Sequence[str], Option(
        MATERIAL, "Turn solid particles that pass a limit into a flowing preset,"
        " [WHERE=]PRESET@LIMIT: time:CODE, strain:VALUE (largest logarithmic stretch) or"
        " stress:VALUE (von Mises) [Pa]. WHERE is a prim or a box x0,y0,z0,x1,y1,z1 [stage units];"
        " repeatable, later ones override earlier ones.",
        shown="nothing", write=values.conversions,
    )] = ()
    blend_width: Annotated[float | None, Option(
        MATERIAL, "Width of the transition between materials of one body [stage units].",
        shown="0", low=0.0, high=1e6,
    )] = None
    material_sweep: Annotated[tuple[str, float, float, int] | str | None, Option(
        MATERIAL, "NAME=LOW:HIGH:COUNT, such as youngs=1e4:1e6:5: bake a variant of the material"
        " for each value, and write a contact sheet. NAME: youngs [Pa], poisson, density"
        " [kg/m^3], damping [s], friction or restitution.",
        shown="none", parse=parse_sweep, write=values.sweep,
    )] = None
    mass_scaling: Annotated[float | None, Option(
        MATERIAL, "Divide the elastic moduli of plastic materials by this number; time steps"
        " grow with its square root, as they would with more mass and strength.",
        shown="1", low=1.0, high=1e6,
    )] = None
    filter_rate: Annotated[float | None, Option(
        METHOD, "Rate of the APIC filter [1/T], from 0 to inf.", shown="10", low=0.0,
    )] = None
    skin: Annotated[Literal["embed", "idw", "paper"] | None, Option(
        METHOD, "How meshes follow the particles: embed (the solver's grid), idw"
        " (nearest particles),"
        " paper (all particles, GaussianFlesh eq. 6).",
        shown="embed; paper with --preset paper", choices=("embed", "idw", "paper"),
    )] = None
    solver: Annotated[Literal["tl", "ul"] | None, Option(
        METHOD, "tl (Total Lagrangian) or ul (Updated Lagrangian MLS-MPM, for comparison).",
        shown="tl", choices=("tl", "ul"),
    )] = None
    no_shortcuts: Annotated[bool, Option(METHOD, "Also simulate frames in which bodies fly"
    " freely or sleep.")] = False
    preset: Annotated[Literal["paper"] | None, Option(
        METHOD, "paper: settings of the GaussianFlesh paper.", choices=("paper",),
    )] = None
    wls: Annotated[bool | None, Option(
        METHOD, "Recompute F from the particle positions once per frame (paper).",
        shown="no; wls with --preset paper",
    )] = None
    procrustes: Annotated[float | None, Option(
        METHOD, "Shape correction per frame, 0 to 1 (paper).",
        shown="0; 0.02 for rubber with --preset paper", low=0.0, high=1.0,
    )] = None
    clamp: Annotated[tuple[float, float] | Literal[False] | str | None, Option(
        METHOD, "Limits LOW:HIGH of the stretches at which stress is evaluated, or none (paper).",
        shown="none; 0.2:5 with --preset paper", parse=texts.parse_clamp, write=values.stretches,
    )] = None
    stress_cap: Annotated[float | Literal[False] | str | None, Option(
        METHOD, "Largest stress |P| [Pa], or none (paper).",
        shown="none; 65 rho g r with --preset paper", parse=texts.parse_cap, write=values.cap,
    )] = None
    certify: Annotated[bool, Option(
        WRITE, "Estimate an uncertainty interval for each result, by simulating also at half and"
        " at a quarter of the resolution.",
    )] = False
    deformation_gradients: Annotated[bool, Option(WRITE, "Write F of every particle.")] = False
    stress: Annotated[bool, Option(WRITE, "Write the von Mises stress of every particle.")] = False
    internal: Annotated[bool, Option(
        WRITE, "Write the internal variables of every particle, such as the plastic strain.",
    )] = False
    only: Annotated[str | Sequence[str] | None, Option(
        WRITE, "Shapes to write: mesh, gaussians, points, or several separated by commas.",
        shown="all three", parse=texts.parse_only, write=values.comma_separated,
    )] = None
    surface: Annotated[bool, Option(
        WRITE, "Write a surface around the particles of flowing materials (sand, snow, pastes,"
        " liquids) instead of their mesh; its topology changes from frame to frame.",
    )] = False
    tets: Annotated[bool, Option(
        WRITE, "Write a TetMesh of each body, at rest and in motion, for other simulators (AOUSD"
        " volume deformable API).",
    )] = False
    flatten: Annotated[bool, Option(
        WRITE, "Write one file that contains the asset, instead of layers.",
    )] = False
    half: Annotated[bool, Option(
        WRITE, "Store attributes of Gaussians in half precision where that is accurate enough.",
    )] = False
    precision: Annotated[float | str | None, Option(
        WRITE, "Allowed error of the stored motion, as a fraction of the radius of each body or"
        " a length: 0.5%, 0.2mm. Gaussians are stored in half precision if that is accurate"
        " enough.",
        shown="single precision", parse=texts.parse_precision, write=values.precision,
    )] = None
    adaptive_samples: Annotated[bool, Option(
        WRITE, "Omit time samples that linear interpolation reproduces within --precision.",
    )] = False
    no_velocities: Annotated[bool, Option(
        WRITE, "Do not write velocities; motion blur then depends only on the time samples.",
    )] = False
    samples_per_frame: Annotated[int | None, Option(
        WRITE, "Number of simulated states to write per frame, for motion blur.", shown="1", low=1,
    )] = None
    range: Annotated[tuple[float | None, float | None] | str | None, Option(
        WRITE, "Time codes FIRST:LAST to write; either may be omitted.",
        shown="all", parse=texts.parse_range, write=values.span,
    )] = None
    handles: Annotated[int | None, Option(
        WRITE, "Number of extra frames to write before and after the range; before the start"
        " they hold the rest pose.",
        shown="0", low=0,
    )] = None
    clip_frames: Annotated[int | None, Option(
        WRITE, "Split the cache into value clips of this many frames; 0: never.",
        shown="one file up to 2 GB", low=0,
    )] = None
    export_ply: Annotated[Path | None, Option(
        ASSET, "Write a sequence of 3DGS PLY files, one per frame, to this folder.", shown="none",
        commands=BATCH, write=values.path,
    )] = None
    export_spz: Annotated[Path | None, Option(
        ASSET, "Write a sequence of SPZ files, one per frame, to this folder.", shown="none",
        commands=BATCH, write=values.path,
    )] = None


@table
class BakeOptions(RequestOptions, AssetOptions):
    """All options of `gf_usd.bake`."""

    resume: Annotated[bool, Option(
        WRITE, "Continue from the last full clip of this bake if it ended early.", commands=BAKE,
    )] = False
    slice: Annotated[int | None, Option(
        WRITE, "End after this many full clips (status 5), to continue with --resume.",
        shown="never", low=1, commands=BAKE,
    )] = None
    until: Annotated[str | None, Option(
        WRITE, "Bake again at higher resolution until the intervals of --certify are within this"
        " fraction of their values (of all results, or of those named before the colon), or"
        " until --max-hours is used up.",
        shown="never", commands=BAKE,
    )] = None
    overwrite: Annotated[bool, Option(
        ASSET, "Replace existing results.", commands=BAKE,
    )] = False
    strict: Annotated[bool, Option(
        WRITE, "Treat warnings about the result as an error (status 4).", commands=BATCH,
        decides=False,
    )] = False
    max_hours: Annotated[float, Option(
        WRITE, "Refuse a bake with a longer estimated time [h], and end a bake that takes twice"
        " as long.", low=0.0, commands=BATCH, decides=False,
    )] = MAX_HOURS
    limits: Annotated["Limits | Mapping[str, float] | Literal[False] | str | None", Option(
        WRITE, "Limits of the process that reads untrusted files: time [s], memory [B], output"
        " [B], such as time=600,memory=32G; none reads them without a separate process.",
        shown="time=300,memory=16G,output=1G", decides=False, write=values.limits,
    )] = None
    progress: Callable[[int, int], None] | None = None  # called with (frames done, frames in all)


# fmt: on
OPTIONS = rows(BakeOptions)
PROGRESS = "progress"  # of Python alone
PLANNED = {name: row for name, row in OPTIONS.items() if hasattr(RequestOptions, name)}
# Options of `gf-usd fit`: what decides the motion of a body of one material.
FITTED = (
    "material", "law", "prims", "meters_per_unit", "up_axis", "repair", "particles", "spacing",
    "frames", "fps", "start", "time_scale", "drop", "gravity", "fields", "floor", "velocity",
    "spin", "colliders", "drag", "device", "pins", "rigid", "combine", "self_contact",
    "damping_time", "friction", "restitution", "filter_rate", "solver", "no_shortcuts", "limits",
    "rolling_resistance", "no_settling",
)  # fmt: skip


def options_of(command: str) -> tuple[Option, ...]:
    """The options of a command, in the order of the table."""
    if command == "fit":
        return tuple(row for row in OPTIONS.values() if row.name in FITTED)
    return tuple(row for row in OPTIONS.values() if command in row.commands)


def taken(given: Mapping[str, Any], function: str) -> dict[str, Any]:
    """Command-line values of Python values, by option name.

    Raises UsageError for an unknown name, and for an invalid value.
    """
    out: dict[str, Any] = {}
    for name, value in given.items():
        if name == PROGRESS:
            out[name] = values.progress_callback(name, value)
        elif name in OPTIONS:
            out[name] = OPTIONS[name].take(value)
            if name not in PLANNED:  # `Request.check` judges the others
                OPTIONS[name].check(out[name])
        else:
            known = [*OPTIONS, PROGRESS]
            hint = f"{nearest(name, known)}its options are {', '.join(sorted(known))}"
            raise UsageError(f"{function}() has no option {name!r}", hint)
    return out


def nearest(name: str, known: Collection[str]) -> str:
    """``did you mean NAME? `` for an unknown name; "" where no known name is similar.

    An option of several values has a flag in the singular: ``pin`` means ``pins``, not ``spin``.
    """
    bare = name.lstrip("-").replace("-", "_").lower()
    flags = {row.flag[2:].replace("-", "_"): row.name for row in OPTIONS.values()}
    if flags.get(bare) in known:
        return meant([flags[bare]])
    return did_you_mean(bare, known)


def arguments(given: Mapping[str, Any]) -> list[str]:
    """The arguments after ``gf-usd bake ASSET`` for these values of options."""
    return command_arguments(OPTIONS, given)
