"""`gf_usd.read`: a bake as NumPy arrays, read frame by frame when they are accessed."""

from __future__ import annotations

import operator
import os
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from gf_usd.api.call import asset_path, keywords
from gf_usd.core.errors import UsageError, counted
from gf_usd.core.units import code_text
from gf_usd.prepare.options.table import nearest

if TYPE_CHECKING:
    from gf_usd.readers.usd_bake.result import BakedArrays

Array = NDArray[np.float64]
V = TypeVar("V")


class NoSuchName(UsageError, KeyError):
    """A table has nothing of this name; it is also a KeyError."""


class Table(dict[str, V]):
    """Values by name.  A name that is not there raises NoSuchName, which lists those that are."""

    def __init__(self, what: str, values: Mapping[str, V]) -> None:
        super().__init__(values)
        self._what = what

    def __missing__(self, name: object) -> V:
        known = ", ".join(self) or "none"
        raise NoSuchName(
            f"{self._what}: there is no {name!r}", f"{nearest(str(name), self)}there are {known}"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._what, dict(self))


class BakeFrame:
    """One frame of a bake, in SI and in the world frame of the stage; each array is read once."""

    def __init__(self, arrays: BakedArrays, index: int) -> None:
        self._arrays = arrays
        self.index: int = index  # 0 for the first
        self.time_code: float = arrays.time_codes[index]  # of the stage

    def __repr__(self) -> str:
        return f"BakeFrame(index={self.index}, time_code={code_text(self.time_code)})"

    @property
    def time(self) -> float:
        """[s] of playback since the first frame."""
        arrays = self._arrays
        return (self.time_code - arrays.time_codes[0]) / arrays.time_codes_per_second

    @cached_property
    def positions(self) -> Array:
        """(N, 3) [m] of the particles."""
        return self._arrays.positions(self.time_code)

    @cached_property
    def velocities(self) -> Array:
        """(N, 3) [m/s of playback] of the particles."""
        return self._arrays.velocities(self.time_code)

    @cached_property
    def covariances(self) -> Array | None:
        """(N, 3, 3) [m^2] of the Gaussians; None if the bake wrote no Gaussians."""
        return self._arrays.covariances(self.time_code)

    @cached_property
    def F(self) -> Array | None:
        """(N, 3, 3) deformation gradients; None unless baked with deformation_gradients=True."""
        return self._arrays.gradients(self.time_code)

    @cached_property
    def stress(self) -> Array | None:
        """(N,) [Pa] von Mises; None unless baked with stress=True."""
        return self._arrays.stress(self.time_code)

    @cached_property
    def internal(self) -> Mapping[str, Array]:
        """(N,) of each internal variable, such as plastic_strain; empty unless internal=True."""
        return Table("internal variables", self._arrays.internal(self.time_code))

    @cached_property
    def meshes(self) -> Mapping[str, Array]:
        """(V, 3) [m] points of each mesh that the bake moves, by prim path."""
        arrays, code = self._arrays, self.time_code
        return Table("meshes", {path: arrays.mesh_points(path, code) for path in arrays.mesh_paths})


class Bake(Sequence[BakeFrame]):
    """An opened bake: a sequence of its frames, with the data that all frames share.

    Only the stage is read at first; arrays are read when they are accessed.  A frame keeps the
    arrays that it has read; the bake keeps none.
    """

    def __init__(self, arrays: BakedArrays) -> None:
        self._arrays = arrays
        self.path: Path = arrays.path  # of the file
        self.variant: str = arrays.variant  # that is read
        self.variants: tuple[str, ...] = arrays.variants  # of the file
        self.time_codes: Array = np.array(arrays.time_codes)  # (T,) of the frames
        self.fps: float = arrays.time_codes_per_second  # time codes per second of playback
        self.up: Array = arrays.up  # (3,) unit
        self.meters_per_unit: float = arrays.units.meters_per_unit  # of the file; arrays: meters

    def __len__(self) -> int:
        return len(self.time_codes)

    @overload
    def __getitem__(self, index: int) -> BakeFrame: ...

    @overload
    def __getitem__(self, index: slice) -> list[BakeFrame]: ...

    def __getitem__(self, index: int | slice) -> BakeFrame | list[BakeFrame]:
        if isinstance(index, slice):
            return [self[one] for one in range(*index.indices(len(self)))]
        if not hasattr(index, "__index__"):
            raise UsageError(
                f"{self.path.name} has frames by number, from 0 to {len(self) - 1},"
                f" and no {index!r}",
                f"a frame has {_listed(BakeFrame)}, such as bake[0].positions, and the bake itself"
                f" {_listed(Bake)}",
            )
        index = operator.index(index)
        at = index + len(self) if index < 0 else index
        if not 0 <= at < len(self):
            raise IndexError(
                f"{self.path.name} has {counted(len(self), 'frame')} but no frame {index}"
            )
        return BakeFrame(self._arrays, at)

    def __iter__(self) -> Iterator[BakeFrame]:
        return (self[index] for index in range(len(self)))

    def __repr__(self) -> str:
        return f"Bake({str(self.path)!r}, variant={self.variant!r}, frames={len(self)})"

    @cached_property
    def rest(self) -> Mapping[str, Array]:
        """Data of the particles that does not change.

        positions (N, 3) [m], where the body is unstressed, before it is lifted; volumes
        (N,) [m^3], masses (N,) [kg], materials (N,), the index of each one's material; and, if the
        body is heterogeneous, youngs_modulus [Pa], poissons_ratio, densities [kg/m^3].
        """
        return Table("rest", self._arrays.rest())

    @property
    def particles(self) -> int:
        """N, the number of particles."""
        return len(self.rest["positions"])

    @property
    def settings(self) -> Mapping[str, Any]:
        """The settings of the bake, as stored in the file."""
        found = self._arrays.about.get("settings")
        return found if isinstance(found, dict) else {}

    @cached_property
    def health(self) -> Mapping[str, NDArray[Any]]:
        """What the solver measured, (T,) or (T, 3) each, in SI; the names of `Health`'s fields.

        kinetic, elastic, potential, contact [J], center [m], momentum [kg m/s], min_J, max_stretch,
        inverted, penetration [m], substeps and others.
        """
        from gf_usd.layers.tracks.health import FLOW, FRAME, si_factors

        si = si_factors(self._arrays.units)
        found = {}
        for name, samples in self._arrays.health().items():
            if name in FRAME | FLOW:
                _, field, unit = (FRAME | FLOW)[name]
                values = np.array(samples)
                found[field] = values * si[unit] if unit else values
        return Table("health", found)

    @cached_property
    def report(self) -> Mapping[str, Any]:
        """The report next to the file (docs/guide/report.md); empty if there is none."""
        from gf_usd.view.report.record import load_report

        return load_report(self.path)[0]

    def faces(self, path: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(P,) numbers of corners and (C,) indices into the points of a mesh, by its prim path.

        Raises UsageError for a path that is none of its meshes.
        """
        return self._arrays.mesh_faces(path)


def _listed(kind: type) -> str:
    """The names of the arrays and tables of a class."""
    found = [n for n, v in vars(kind).items() if isinstance(v, cached_property | property)]
    return ", ".join(found)


def read(path: str | os.PathLike[str], *, variant: str | None = None) -> Bake:
    """Open a bake to read its particles, meshes and health as NumPy arrays.

    >>> bake = gf_usd.read(result.root)
    >>> len(bake), bake.health["kinetic"].shape
    (4, (4,))
    >>> bake[-1].positions.shape == bake.rest["positions"].shape
    True

    Parameters
    ----------
    path : root layer of a bake, or a flattened one.
    variant : one of its materials; None: the one selected in the file.

    Raises
    ------
    InputError : no such file, not USD, damaged, or no bake.
    UsageError : the file has no such variant.
    """
    from gf_usd.readers.usd_bake.result import BakedArrays

    with keywords("variant"):
        return Bake(BakedArrays(asset_path(path), variant))
