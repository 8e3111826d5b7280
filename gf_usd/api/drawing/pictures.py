"""Images of a stage at any time code, with the same camera, light and colors."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gf_usd.api.drawing.options import Options
from gf_usd.core.arrays import Floats
from gf_usd.core.errors import counted
from gf_usd.core.scene import Camera, Light, Quantity
from gf_usd.core.units import code_text
from gf_usd.readers.pictures.scene import PictureStage
from gf_usd.view.colormap import color_by_value
from gf_usd.view.contact_sheet import choose_frames, contact_sheet, sheet_columns
from gf_usd.view.film import MAX_FPS, write_gif, write_mp4
from gf_usd.view.legend import Legend, caption
from gf_usd.view.render.camera import fit_camera
from gf_usd.view.render.lights import studio
from gf_usd.view.render.render import render
from gf_usd.view.ticks import round_up
from gf_usd.view.visibility import VIEWS, Occluded, best_view, hidden_frames, mostly_hidden

Pixels = NDArray[np.uint8]

PALETTE_FRAMES = 6  # of a gif that its colors are taken from
LOOKED_AT = 8  # frames at which it is decided whether obstacles hide the bodies


class Drawing:
    """Renders a stage; everything that all frames share is computed once.

    Parameters
    ----------
    size : (width, height) [pixels].
    limits : range of the colors; None: from the motion.
    fitted : camera where the stage has none; None: one that shows the whole motion.
    """

    def __init__(
        self,
        source: PictureStage,
        size: tuple[int, int],
        limits: tuple[float, float] | None = None,
        fitted: Camera | None = None,
    ) -> None:
        self._source, self._size = source, size
        self._quantity = _quantity(source, limits)
        self._legend = Legend(self._quantity, size) if self._quantity else None
        self.notes: dict[str, None] = {}  # assumptions of all frames, without repetition
        self._fitted = fitted or self._fit()
        self._lights = self._studio()

    def __call__(self, time_code: float | None, *, legend: bool = True) -> Pixels:
        """The picture (H, W, 3) sRGB at a time code; None: the first of the stage."""
        scene = self._source.scene(time_code)
        self.notes.update(dict.fromkeys(scene.notes))
        if self._quantity is not None:
            scene = color_by_value(scene, self._quantity.low, self._quantity.high)
        camera = self._source.camera(time_code, self._aspect)
        if camera is None:  # the fitted one, whose picture is that of the motion
            camera, scene = self._fitted, replace(scene, focus=self._source.motion.bounds)
        pixels = render(replace(scene, lights=self._lights), camera, self._size)
        return self._legend.overlay(pixels) if self._legend and legend else pixels

    @property
    def shown_until(self) -> float | None:
        """See `Motion`."""
        return self._source.motion.shown_until

    def speeds(self, codes: Sequence[float]) -> Floats | None:
        """See `PictureStage.speeds`."""
        return self._source.speeds(codes)

    @property
    def _aspect(self) -> float:
        return self._size[0] / self._size[1]

    def _fit(self) -> Camera | None:
        """A camera that has the whole motion next to the legend; None where nothing is visible.

        It is one of `VIEWS`: the first, unless obstacles hide the bodies of a bake from it.
        """
        motion, (width, height) = self._source.motion, self._size
        if motion.bounds is None:
            return None
        taken = min(self._legend.reserved, width // 2) if self._legend else 0
        aspect = (width - taken) / height
        cameras = [
            fit_camera(motion.framed, motion.up, aspect, azimuth=azimuth, elevation=elevation)
            for azimuth, elevation in VIEWS
        ]
        chosen = cameras[self._unhidden(cameras, aspect)]
        # half of what is taken moves the view axis to the middle of the rest
        return replace(chosen, shift=(-taken * np.tan(np.radians(chosen.fov / 2.0)) / height, 0.0))

    def _unhidden(self, cameras: Sequence[Camera], aspect: float) -> int:
        """Index of the camera to use, with a note where obstacles hide the bodies from the first
        one or from that of the stage.
        """
        bodies, obstacles = self._source.bodies_and_obstacles()
        if not bodies or not obstacles:
            return 0
        codes: Sequence[float | None] = self._source.motion.time_codes or (None,)
        codes = [codes[i] for i in choose_frames(len(codes), LOOKED_AT)]
        frames = [Occluded.of_scene(self._source.scene(t), bodies, obstacles) for t in codes]
        own = [self._source.camera(t, self._aspect) for t in codes]
        if any(own):
            shares = [
                frame.seen_share(camera or cameras[0], self._aspect)
                for frame, camera in zip(frames, own)
            ]
            if mostly_hidden(shares):
                self.notes[_hidden_note(shares, "leave out --camera, or choose another one")] = None
            return 0
        chosen, shares = best_view(frames, cameras, aspect)
        if mostly_hidden(shares):
            self.notes[_hidden_note(shares, "choose a view with --camera PRIM")] = None
        elif chosen:
            azimuth, elevation = VIEWS[chosen]
            side = "right" if azimuth > 0.0 else "left"
            self.notes[MOVED.format(abs(azimuth), side, elevation)] = None
        return chosen

    def _studio(self) -> tuple[Light, ...]:
        """Lights that stand still where the stage's camera moves; () leaves them to the camera."""
        camera = self._source.camera(None, self._aspect)
        if camera is None:
            return ()
        view = np.subtract(camera.eye, camera.target)
        return studio(view / np.linalg.norm(view), np.array(self._source.motion.up))


MOVED = (
    "obstacles hide the body from the usual camera: this one is {:g} degrees to the {} of the"
    " front and {:g} degrees above the horizon; hint: --camera PRIM chooses another"
)


def _hidden_note(shares: Sequence[float], hint: str) -> str:
    hidden = hidden_frames(shares)
    return (
        f"the body is hidden by obstacles or outside of the picture in {hidden} of"
        f" {counted(len(shares), 'frame')} that were examined; hint: {hint}"
    )


def _quantity(source: PictureStage, limits: tuple[float, float] | None) -> Quantity | None:
    if source.values is None:
        return None
    found = source.values.quantity(source.motion.time_codes)
    if limits is not None:
        return replace(found, low=limits[0], high=limits[1], chosen=True)
    # a body that never strains still gets a bar
    return replace(found, high=round_up(found.high) or 1.0)


def write_sheet(draw: Drawing, codes: Sequence[float], options: Options) -> Pixels:
    """A page of `options.sheet` frames of the time codes, each labeled.

    They are spread evenly over requested codes, else by the amount of motion between them, until
    all that moves has fallen out of the picture.
    """
    end = draw.shown_until
    if options.span is None and end is not None:
        codes = [code for code in codes if code <= end]
    speeds = draw.speeds(codes) if options.span is None else None
    chosen = [codes[i] for i in choose_frames(len(codes), options.sheet or 1, speeds)]
    tiles = [
        caption(draw(code, legend=i == 0), f"time code {code_text(code)}")
        for i, code in enumerate(chosen)
    ]
    aspect = options.size[0] / options.size[1]
    return contact_sheet(tiles, options.columns or sheet_columns(len(tiles), aspect))


def film_rate(codes: Sequence[float], per_second: float, options: Options) -> float:
    """Frames per second: the given value, else that of real time."""
    step = min((b - a for a, b in pairwise(codes)), default=1.0)
    return options.fps or per_second / step


def thin_for_gif(codes: list[float], fps: float) -> tuple[list[float], float]:
    """Every n-th time code, and the rate, so that a GIF can keep up."""
    every = int(np.ceil(fps / MAX_FPS - 1e-9)) or 1
    return codes[::every], fps / every


def write_film(
    draw: Callable[[float], Pixels],
    codes: Sequence[float],
    fps: float,
    options: Options,
    advance: Callable[[int, int], None],
) -> None:
    """Draw and write the frames one by one; `advance` gets the numbers of done and all frames."""
    gif = options.target.suffix.lower() == ".gif"
    early: dict[int, Pixels] = {}
    if gif:
        early = {i: draw(codes[i]) for i in choose_frames(len(codes), PALETTE_FRAMES)}

    def frames() -> Iterator[Pixels]:
        for i, code in enumerate(codes):
            pixels = early.pop(i) if i in early else draw(code)
            advance(i + 1, len(codes))
            yield pixels

    if gif:
        write_gif(options.target, frames(), fps, list(early.values()))
    else:
        write_mp4(options.target, frames(), fps, options.size)
