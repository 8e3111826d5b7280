"""The options of a bake as given, checked before anything is read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from gf_usd.core.errors import UsageError
from gf_usd.core.frames.settings import MIXED
from gf_usd.prepare.materials.conversion import ConversionRule, parse_conversions
from gf_usd.prepare.materials.regions import Region, parse_regions
from gf_usd.prepare.options.fields import GravityKeys, parse_field
from gf_usd.prepare.options.table import PLANNED, RequestOptions
from gf_usd.prepare.options.texts import Cycles


@dataclass(frozen=True, kw_only=True)
class Request(RequestOptions):
    """The options that determine a plan; None where an option is not set."""

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Request:
        """The request from keyword arguments.  Raises UsageError for an unknown one."""
        known = cls.__dataclass_fields__
        unknown = sorted(set(options) - set(known))
        if unknown:
            raise UsageError(
                f"bake() has no option {unknown[0]!r}",
                f"its options are {', '.join(sorted(known))}",
            )
        lists = {
            name: tuple(options.get(name) or ()) for name, row in PLANNED.items() if row.repeated
        }
        return cls(**{**options, **lists})

    @cached_property
    def parsed(self) -> Mapping[str, Any]:
        """The values of the options that are texts, by name; None where none was given.

        Raises UsageError for a text that cannot be read.
        """
        texts = {name: getattr(self, name) for name, row in PLANNED.items() if row.parse}
        return {name: PLANNED[name].value(text) for name, text in texts.items()}

    @property
    def length_is_open(self) -> bool:
        """Whether no option sets the length or excludes ending at rest."""
        given = (self.frames, self.range, self.handles, self.flesh, self.preset, self.settle_only)
        acts = self.solver not in ("ul", MIXED) and not (self.wls or self.procrustes or self.rigid)
        return acts and not any(given) and not self.no_settling

    @property
    def floats(self) -> bool:
        """Whether flesh follows an animation and has no floor, which it has only where one is
        given.
        """
        return bool(self.flesh) and self.floor is None

    @property
    def until_rest(self) -> bool:
        """Whether the bake ends when everything is at rest."""
        return self.parsed["frames"] is not None and self.parsed["frames"].rest

    @property
    def cycles(self) -> Cycles:
        """Number of cycles of the animation."""
        return self.parsed["loop"] or Cycles(times=1)

    @cached_property
    def regions(self) -> tuple[Region, ...]:
        """Regions with separate presets, labels first.  Raises UsageError as `parse_regions`."""
        return parse_regions(self.listed("material_boxes"), self.listed("material_labels"))

    @cached_property
    def converted(self) -> tuple[ConversionRule, ...]:
        """The conversion rules.  Raises UsageError as `parse_conversions`."""
        return parse_conversions(self.listed("conversions"))

    @property
    def of_solids(self) -> tuple[tuple[str, Any], ...]:
        """Options that are not supported with solid and flowing bodies together, and whether each
        is set.
        """
        return (
            ("--combine", self.combine),
            ("--flesh", self.flesh),
            ("--rigid", self.rigid),
            ("--preset paper", self.preset),
            ("--field", self.fields),
            ("--settle-only", self.settle_only),
            ("--frames rest", self.until_rest),
            ("--certify", self.certify),
            ("--tets", self.tets),
            ("--rolling-resistance", self.rolling_resistance),
            (f"--skin {self.skin}", self.skin not in (None, "embed")),
        )

    def listed(self, name: str) -> tuple[str, ...]:
        """The texts of an option that may be given several times."""
        return getattr(self, name)

    def folder(self, name: str) -> str | None:
        """The value of an option that is a folder."""
        return getattr(self, name)

    def check(self) -> None:
        """Raise UsageError for invalid values, before anything is read."""
        for row in PLANNED.values():
            row.check(getattr(self, row.name))
        if self.solver == "ul":
            self._check_updated_lagrangian()
        self._check_flesh()
        if self.regions and self.blend_width:
            raise UsageError(
                f"--blend-width {self.blend_width:g} and {self.regions[0].option} were both given",
                "leave one out: materials blend between faces only",
            )
        if self.procrustes and self.pins:
            raise UsageError(
                f"--procrustes {self.procrustes:g} moves the body towards its rest shape about its"
                " mean, which conflicts with --pin",
                "leave one of the two out",
            )
        if self.rigid and (self.preset or self.wls or self.procrustes):
            raise UsageError(
                "--rigid cannot be combined with --preset paper, --wls or --procrustes",
                "leave them out: they change the shape of all particles alike",
            )
        if self.particles and self.spacing:
            raise UsageError(
                f"--particles {self.particles} and --spacing {self.spacing:g} were both given",
                "give one: the number of particles follows from the spacing",
            )
        if self.flatten and self.clip_frames:
            raise UsageError(
                f"--clip-frames {self.clip_frames} and --flatten were both given",
                "give one: a flattened bake is one file",
            )
        once_a_frame = (self.preset, self.wls, self.procrustes)
        if (self.samples_per_frame or 1) > 1 and any(once_a_frame):
            raise UsageError(
                f"--samples-per-frame {self.samples_per_frame} cannot be combined with --preset"
                " paper, --wls or --procrustes",
                "leave them out: they act once per frame, but would then act at every sample",
            )
        if self.surface and "mesh" not in (self.parsed["only"] or ("mesh",)):
            raise UsageError(
                f"--surface is shown instead of meshes, which --only {self.only} leaves out",
                "add mesh to --only, or leave one of the two out",
            )
        self._check_conversion()
        self._check_precision()
        self._check_settling()
        self._check_certify()
        self._check_sweep()
        if self.self_contact and self.preset:
            raise UsageError(
                f"--preset {self.preset} does not support --self-contact",
                "leave one of the two out: with this preset, particles collide with the floor only",
            )
        fields = [parse_field(text) for text in self.fields]
        if self.rigid and (fields or isinstance(self.parsed["gravity"], GravityKeys)):
            raise UsageError(
                "--rigid cannot be combined with --field, or with keys of gravity",
                "leave one of the two out: rigid regions support constant gravity only",
            )
        _ = self.parsed  # raises for a text that cannot be read

    def _check_conversion(self) -> None:
        """Raise UsageError for options that cannot be combined with --conversion."""
        if not self.converted:
            return
        for option, given in (
            ("--solver tl", self.solver == "tl"),
            *self.of_solids,
            ("--mass-scaling", self.mass_scaling),
            ("--wls", self.wls),
            ("--procrustes", self.procrustes),
            ("--gravity FILE", isinstance(self.parsed["gravity"], GravityKeys)),
        ):
            if given:
                raise UsageError(
                    f"--conversion cannot be combined with {option}", "leave one of the two out"
                )

    def _check_precision(self) -> None:
        """Raise UsageError for two precisions at once, and for adaptive samples without one."""
        if self.half and self.precision is not None:
            raise UsageError(
                f"--half and --precision {self.precision} were both given",
                "give one: --precision uses half precision where it is precise enough",
            )
        if self.adaptive_samples and self.precision is None:
            raise UsageError(
                "--adaptive-samples omits samples that are within --precision, which is not given",
                "add an error, such as --precision 0.5%",
            )

    def _check_settling(self) -> None:
        """Raise UsageError for options on frames with a bake that writes a single pose."""
        for option, given in (
            ("--range", self.range),
            ("--handles", self.handles),
            ("--samples-per-frame", (self.samples_per_frame or 1) > 1),
            ("--clip-frames", self.clip_frames),
            ("--adaptive-samples", self.adaptive_samples),
            ("--flesh", self.flesh),
        ):
            if self.settle_only and given:
                raise UsageError(
                    f"--settle-only cannot be combined with {option}: it writes only the pose at"
                    " rest",
                    f"leave {option} out",
                )
        for option, given in (
            ("--range", self.range),
            ("--handles", self.handles),
            ("--flesh", self.flesh),
        ):
            if self.until_rest and given:
                raise UsageError(
                    f"--frames {self.frames} cannot be combined with {option}, which sets the"
                    " length of the simulation",
                    "leave one of the two out",
                )

    def _check_certify(self) -> None:
        """Raise UsageError for options for which --certify has no figures."""
        shapes = self.parsed["only"]
        for option, given, why in (
            ("--preset paper", self.preset, "it places particles at random"),
            (f"--skin {self.skin}", self.skin not in (None, "embed"), "it does not use the grid"),
            (
                f"--samples-per-frame {self.samples_per_frame}",
                (self.samples_per_frame or 1) > 1,
                "it measures at frames",
            ),
            (f"--only {self.only}", shapes and "mesh" not in shapes, "it measures the mesh"),
        ):
            if self.certify and given:
                raise UsageError(
                    f"--certify cannot be combined with {option}: {why}", "leave one of the two out"
                )

    def _check_sweep(self) -> None:
        """Raise UsageError for options that conflict with --material-sweep."""
        sweep = self.parsed["material_sweep"]
        for option, given, name in (
            ("--friction", self.friction, "friction"),
            ("--restitution", self.restitution, "restitution"),
            ("--damping-time", self.damping_time, "damping"),
            ("--preset paper", self.preset, None),
            ("--flatten", self.flatten or None, None),
        ):
            if sweep and given is not None and name in (None, sweep.name):
                raise UsageError(
                    f"--material-sweep {self.material_sweep} cannot be combined with {option}",
                    f"leave {option} out",
                )

    def _check_flesh(self) -> None:
        """Raise UsageError for options that cannot be combined with --flesh, or require it."""
        if not self.flesh:
            for option, value in (
                ("--bone-radius", self.bone_radius),
                ("--goal-frequency", self.goal_frequency),
                ("--goal-damping", self.goal_damping),
                ("--squish", self.squish),
                ("--stretch", self.stretch),
                ("--preroll", self.preroll),
                ("--loop", self.loop),
            ):
                if value is not None:
                    shown = value if isinstance(value, str) else f"{value:g}"
                    raise UsageError(f"{option} {shown} is for --flesh", "add --flesh")
            return
        for option, given in (
            ("--range", self.range),
            ("--handles", self.handles),
            ("--frames", self.frames),
        ):
            if self.loop and given:
                raise UsageError(
                    f"--loop {self.loop} writes one cycle, which {option} contradicts",
                    "leave one of the two out",
                )
        for option, given in (
            ("--pin", self.pins),
            ("--procrustes", self.procrustes),
            ("--preset paper", self.preset),
            ("--drop", self.drop),
            ("--velocity", self.velocity),
            ("--spin", self.spin),
        ):
            if given:
                raise UsageError(
                    f"--flesh cannot be combined with {option}: the bones set the position of the"
                    " body",
                    f"leave {option} out",
                )

    def _check_updated_lagrangian(self) -> None:
        """Raise UsageError for options that this solver does not support."""
        finite = self.filter_rate is not None and math.isfinite(self.filter_rate)
        for option, given in (
            ("--pin", self.pins),
            ("--rigid", self.rigid),
            ("--flesh", self.flesh),
            ("--field", self.fields),
            ("--gravity FILE", isinstance(self.parsed["gravity"], GravityKeys)),
            ("--filter-rate", finite),
            ("--self-contact", self.self_contact),
            ("--wls", self.wls),
            ("--procrustes", self.procrustes),
            ("--rolling-resistance", self.rolling_resistance),
        ):
            if given:
                raise UsageError(
                    f"--solver ul does not support {option}",
                    f"leave {option} out, or use --solver tl",
                )
