"""`gf_usd.compare`: compares a bake with another bake or animation, point by point."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gf_usd.api.call import asset_path, keywords
from gf_usd.api.drawing.options import FILMS, Options, joined, read_options
from gf_usd.api.host.guest import run_here_or_separately
from gf_usd.core.errors import UsageError
from gf_usd.core.scene import Camera, Quantity, Scene
from gf_usd.prepare.options import values

if TYPE_CHECKING:
    from gf_usd.readers.pictures.recording import BakedMotion
    from gf_usd.view.compare import Align, Comparison, Pairing

PAGES = (".html", ".htm")
PANES = 3  # A, B, and B colored by its distance to A


def compare(
    path: str | os.PathLike[str],
    other: str | os.PathLike[str],
    output: str | os.PathLike[str] | Sequence[str | os.PathLike[str]] = (),
    *,
    tolerance: str | float | None = None,
    variant: str | None = None,
    other_variant: str | None = None,
    align: Align = "time",
    size: tuple[int, int] | str | None = None,
    fps: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Compare two motions of the same meshes, point by point over time.

    >>> found = gf_usd.compare(result.root, result.root)
    >>> found.same, found.error
    (True, 0.0)

    Parameters
    ----------
    path : root layer of a bake, or any USD file in which meshes move: A.
    other : another file, from this or another program: B.  Meshes are paired by path, else by name.
    output : files to write; existing ones are replaced: a page (.html) with both motions and their
        distances, a film (.mp4, .gif) of A, B, and B colored by distance, or an image (.png) of
        the worst frame.
    tolerance : the largest distance that counts as the same: [m], or a string such as "2mm" or
        "0.5%" (of the radius of a sphere of A's volume); None: 0.
    variant, other_variant : of the bakes; None: those selected in the files.
    align : "time": compare at equal times of the two stages; "start": from the first frame of each.
    size : (width, height) [pixels] of each of the three parts of an image or film, or "480x360".
    fps : frames per second of the film; None: real time.
    progress : called after each frame of a film with (frames done, total frames).

    Returns
    -------
    Comparison : largest and rms distances, volumes and centers of mass over time, the first time
        at which the tolerance is exceeded, and `same`.

    Raises
    ------
    UsageError : an option makes no sense, no such variant, or an output cannot be written.
    InputError : a file cannot be read, nothing in it moves, or the two files have no common mesh
        or time.
    BakeError : a file cannot be written.
    """
    with keywords("tolerance", "variant", "other_variant", "align", "size", "fps") as names:
        if isinstance(tolerance, bool) or not isinstance(tolerance, str | float | int | None):
            raise values.refuse(
                "tolerance", tolerance, "meters, or a string such as '2mm' or '0.5%'"
            )
        single = isinstance(output, str | os.PathLike)
        many = [output] if single else values.items("output", output, "a path, or a list of them")
        arguments: dict[str, Any] = {
            "path": asset_path(path),
            "other": asset_path(other),
            "targets": [Path(values.path("output", one)) for one in many],
            "tolerance": tolerance,
            "variants": (
                values.variant("variant", variant),
                values.variant("other_variant", other_variant),
            ),
            "align": align,
            "size": None if size is None else joined("size", size, "x", (2,)),
            "fps": fps,
        }
        progress = values.progress_callback("progress", progress)
        found, _ = run_here_or_separately(
            "gf_usd.api.drawing.compare:run", arguments, progress, schema=False
        )
        return names.in_notes(found)


def run(
    path: Path,
    other: Path,
    targets: Sequence[Path],
    *,
    tolerance: str | float | None,
    variants: tuple[str | None, str | None] = (None, None),
    align: str = "time",
    size: str | None = None,
    fps: float | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Comparison:
    """Compare, and write the targets; see `compare`."""
    from gf_usd.readers.pictures.recording import BakedMotion
    from gf_usd.view.compare import compare_motions, pair_meshes, parse_tolerance, with_tolerance

    if align != "time" and align != "start":
        raise UsageError(f"--align is {align!r}", "choose one of: time, start")
    if isinstance(tolerance, str):
        parse_tolerance(tolerance, 1.0)  # nonsense is refused before the files are read
    elif tolerance is not None and not (np.isfinite(tolerance) and tolerance >= 0.0):
        raise UsageError(f"--tolerance {tolerance} is not a length of 0 or more", "give meters")
    pictures = _judge(targets, (path, other), size, fps)
    a, b = (BakedMotion(file, variant) for file, variant in zip((path, other), variants))
    found = with_tolerance(compare_motions(a, b, align=align), tolerance)
    found = replace(found, notes=tuple(dict.fromkeys((*found.notes, *_stage_notes(a, b)))))
    for target in targets:
        if target.suffix.lower() in PAGES:
            _write_page(target, (a, b), (path, other), found)
    for options in pictures:
        pairing = pair_meshes(a.recording(), b.recording())
        draw = SideBySide(
            (path, other), (a.variant or None, b.variant or None), found, pairing, options
        )
        _write_pictures(draw, found, options, a.recording().time_codes_per_second, progress)
    return found


def _judge(
    targets: Sequence[Path], inputs: Sequence[Path], size: str | None, fps: float | None
) -> list[Options]:
    """The options of each picture or film.  Raises UsageError for invalid ones."""
    from gf_usd.api.report import require_target
    from gf_usd.view.film import require_folder

    pictures = []
    for target in targets:
        if target.suffix.lower() in PAGES:
            require_target(target, tuple(inputs))
            continue
        if target.suffix.lower() not in (".png", *FILMS):
            raise UsageError(
                f"{target} does not end in .html, .png, .mp4 or .gif",
                "compare writes a page, an image or a film: -o difference.html",
            )
        film = target.suffix.lower() in FILMS
        small = size or ("360x270" if film else "480x360")
        options = read_options(
            target, size=small, frame=None, frames=None, sheet=None, columns=None,
            fps=fps if film else None, color=None, limits=None,
        )  # fmt: skip
        if film and target.suffix.lower() == ".mp4":
            options = replace(
                options, size=(options.size[0], options.size[1] + options.size[1] % 2)
            )
            options = replace(
                options, size=(options.size[0] + options.size[0] % 2, options.size[1])
            )
        require_folder(target)
        pictures.append(options)
    if fps is not None and not any(options.film for options in pictures):
        raise UsageError("--fps does not apply to the other options", "write a film: -o out.mp4")
    return pictures


def _stage_notes(*motions: BakedMotion) -> Iterator[str]:
    for motion in motions:
        yield from motion.recording().notes


class SideBySide:
    """Draws A, B, and B colored by its distance to A, through one camera.

    options : size is that of one part, (width, height) [pixels].
    """

    def __init__(
        self,
        paths: tuple[Path, Path],
        variants: tuple[str | None, str | None],
        found: Comparison,
        pairing: Pairing,
        options: Options,
    ) -> None:
        from gf_usd.readers.pictures.scene import PictureStage
        from gf_usd.view.legend import Legend
        from gf_usd.view.ticks import round_up

        self._size, self._pairing = options.size, pairing
        self._stages = [
            PictureStage(path, "mesh", variant=variant) for path, variant in zip(paths, variants)
        ]
        self._titles = _titles(paths, [variant or "" for variant in variants])
        self._meshes = found.meshes
        self._partner = dict(zip(found.time_codes.tolist(), found.other_time_codes.tolist()))
        top = round_up(found.error) or found.radius * 1e-6
        self._quantity = Quantity(
            title="Distance", measure=f"to {self._titles[0]}", unit="m", high=top,
            largest=found.error, source=("largest of all", "frames,"),
        )  # fmt: skip
        self._legend = Legend(self._quantity, options.size)
        self._camera = self._fit()

    def __call__(self, time_code: float) -> NDArray[np.uint8]:
        """The picture (H, 3 W, 3) sRGB at a time code of A."""
        from gf_usd.view.colormap import color_by_value
        from gf_usd.view.legend import label
        from gf_usd.view.render.render import render

        mine = self._stages[0].scene(time_code)
        other = self._turned(self._stages[1].scene(self._partner[time_code]))
        colored = color_by_value(self._valued(mine, other), 0.0, self._quantity.high)
        parts = [render(scene, self._camera, self._size) for scene in (mine, other, colored)]
        parts = [
            label(parts[0], self._titles[0]),
            label(parts[1], self._titles[1]),
            self._legend.overlay(parts[2]),
        ]
        return np.concatenate(parts, axis=1)

    def _turned(self, scene: Scene) -> Scene:
        """B's scene in the world of A; the floor is drawn where A has it."""
        turn = self._pairing.rotation.T
        meshes = tuple(
            replace(
                mesh,
                points=mesh.points @ turn,
                normals=None if mesh.normals is None else mesh.normals @ turn,
            )
            for mesh in scene.meshes
        )
        motion = self._stages[0].motion
        return replace(scene, meshes=meshes, up=motion.up, ground=motion.ground)

    def _valued(self, mine: Scene, other: Scene) -> Scene:
        """B's scene with the distance to A at each vertex of the meshes that were compared."""
        here = {mesh.name: mesh.points for mesh in mine.meshes}
        partner = {second: first for first, second in self._meshes}
        meshes = tuple(
            replace(mesh, values=np.linalg.norm(mesh.points - here[partner[mesh.name]], axis=1))
            if partner.get(mesh.name) in here
            else mesh
            for mesh in other.meshes
        )
        return replace(other, meshes=meshes)

    def _fit(self) -> Camera:
        from gf_usd.view.render.camera import fit_camera

        framed = [
            stage.motion.framed @ turn.T
            for stage, turn in zip(self._stages, (np.eye(3), self._pairing.rotation))
        ]
        aspect = self._size[0] / self._size[1]
        return fit_camera(np.concatenate(framed), self._stages[0].motion.up, aspect)


def _write_pictures(
    draw: SideBySide,
    found: Comparison,
    options: Options,
    per_second: float,
    progress: Callable[[int, int], None] | None,
) -> None:
    from gf_usd.api.drawing.pictures import film_rate, thin_for_gif, write_film
    from gf_usd.view.render.image import write_png

    codes = found.time_codes.tolist()
    if not options.film:
        write_png(options.target, draw(codes[found.worst_frame]))
        return
    rate = film_rate(codes, per_second, options)
    if options.target.suffix.lower() == ".gif":
        codes, rate = thin_for_gif(codes, rate)
    whole = replace(options, size=(PANES * options.size[0], options.size[1]))
    write_film(draw, codes, rate, whole, progress or (lambda done, total: None))


def _write_page(
    target: Path,
    motions: tuple[BakedMotion, BakedMotion],
    paths: tuple[Path, Path],
    found: Comparison,
) -> None:
    from gf_usd.system.atomic_files import publish_text
    from gf_usd.view.report.record import load_report
    from gf_usd.view.report.report import Limits, build_comparison

    reports = [load_report(path) for path in paths]
    titles = _titles(paths, [motion.variant for motion in motions])
    publish_text(target, build_comparison(motions, reports, titles, found, Limits()))


def _titles(paths: Sequence[Path], variants: Sequence[str]) -> tuple[str, str]:
    """Titles of A and B: file and variant, and which of the two it is where these are the same.

    A file of one variant is usually named after it: duck.rubber.usda.
    """
    a, b = (
        path.stem if path.stem.endswith(f".{variant}") else f"{path.stem} {variant}".strip()
        for path, variant in zip(paths, variants)
    )
    return (a, b) if a != b else (f"A {a}", f"B {b}")
