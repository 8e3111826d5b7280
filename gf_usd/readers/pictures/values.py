"""False colors: strain or stress of particles, and of meshes by interpolation from particles.

Strains are computed from deformation gradients, or from the motion of particles by a moving least
squares fit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd
from scipy.spatial import cKDTree

from gf_usd.core.arrays import Floats
from gf_usd.core.errors import InputError, UsageError
from gf_usd.core.scene import Quantity
from gf_usd.readers.usd.stage import SPLAT_TYPE, is_bake_particles

GRADIENTS = "gaussianFlesh:deformationGradients"


@dataclass(frozen=True, kw_only=True)
class Measure:
    """A quantity for false colors."""

    label: str
    unit: str = ""
    attributes: tuple[str, ...] = ()  # of particles, the largest one counts; (): computed from F
    option: str = ""  # of the bake, to write the attributes


MEASURES = {
    "strain": Measure(label="largest |stretch - 1|"),
    "elastic": Measure(
        label="largest |elastic stretch - 1|",
        attributes=("gaussianFlesh:elasticStrain",),
        option="--internal",
    ),
    "plastic": Measure(
        label="permanent strain",
        attributes=("gaussianFlesh:plasticStrain", "gaussianFlesh:lostVolume"),
        option="--internal",
    ),
    "stress": Measure(
        label="von Mises", unit="Pa", attributes=("gaussianFlesh:vonMisesStress",),
        option="--stress",
    ),
}  # fmt: skip
RANGE_PERCENTILE = 99.0  # [%] of the particles within the color range in every frame
SAMPLED_TIMES = 48  # maximal number of times to determine the range
NEIGHBORS = 8  # particles that the value of a mesh vertex is interpolated from


@dataclass(frozen=True, kw_only=True)
class ParticleCloud:
    """A prim with the particles of a bake."""

    prim: Usd.Prim
    first: Usd.TimeCode  # time of its rest shape, apart from a rigid offset
    rest: Floats  # (N, 3) restPositions, stage units
    meshes: frozenset[str]  # prim paths of meshes embedded in it


class Values:
    """A quantity of all bakes in a stage, over time.

    Parameters
    ----------
    what : a row of MEASURES.
    path : the file, for messages.
    pressure : [Pa] per stage pressure.

    Raises
    ------
    UsageError : an unknown quantity.
    InputError : the stage has no bake, or the bake does not contain the quantity.
    """

    def __init__(self, stage: Usd.Stage, name: str, path: Path, pressure: float) -> None:
        if name not in MEASURES:
            raise UsageError(
                f"unknown --color {name}", f"choose one of: {', '.join((*MEASURES, 'none'))}"
            )
        walk = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
        prims = [p for p in walk if str(p.GetTypeName()) == SPLAT_TYPE and is_bake_particles(p)]
        self._clouds = [_read_cloud(prim) for prim in prims]
        if not self._clouds:
            raise InputError(
                f"{path}: --color {name} needs the particles of a bake, and the file contains none",
                "give a file that gf-usd bake wrote, with a variant of gaussianFlesh other than "
                "none",
            )
        measure = MEASURES[name]
        without = [
            c
            for c in self._clouds
            if measure.attributes and not authored_attributes(c.prim, measure)
        ]
        if without:
            raise InputError(
                f"{path}: <{without[0].prim.GetPath()}> holds no {name}"
                f" ({', '.join(measure.attributes)})",
                f"bake with {measure.option}, or use --color strain",
            )
        self.name, self._measure = name, measure
        self.notes: list[str] = []
        self._scale = pressure if measure.unit else 1.0
        self._fits: dict[str, NeighborFit] = {}
        self._bindings: dict[str, tuple[NDArray[np.int64], Floats]] = {}
        for cloud in self._clouds:
            if name == "strain" and not cloud.prim.GetAttribute(GRADIENTS).HasValue():
                prim_path = str(cloud.prim.GetPath())
                self._fits[prim_path] = NeighborFit(cloud.rest)
                self.notes.append(
                    f"<{prim_path}>: strain is fitted to the motion of neighboring particles "
                    f"because the bake holds no deformation gradients (bake with "
                    f"--deformation-gradients)"
                )

    def of_particles(self, prim: Usd.Prim, time: Usd.TimeCode) -> Floats | None:
        """Values (N,) of the particles of a prim or of its siblings; None for other prims."""
        count = len(prim.GetAttribute("gaussianFlesh:restPositions").Get(time) or [])
        for cloud in self._clouds:
            siblings = cloud.prim.GetParent() == prim.GetParent()
            if siblings and count == len(cloud.rest):
                return self._read(cloud, time)
        return None

    def particles_of(self, mesh: str) -> ParticleCloud | None:
        """The particles that a mesh is embedded in; None for a mesh without a bake."""
        return next((cloud for cloud in self._clouds if mesh in cloud.meshes), None)

    def is_bound(self, mesh: str) -> bool:
        """Whether `bind_mesh` was called for a mesh."""
        return mesh in self._bindings

    def bind_mesh(self, mesh: str, vertices: Floats, particles: Floats) -> None:
        """Store the nearest particles of each vertex of a mesh at rest.

        vertices (V, 3), particles (N, 3) : [m], world, at the time `ParticleCloud.first`.
        """
        self._bindings[mesh] = _neighbor_weights(vertices, particles)

    def of_mesh(self, cloud: ParticleCloud, mesh: str, time: Usd.TimeCode) -> Floats:
        """Values (V,) at the vertices of a bound mesh: weighted means of the nearest particles."""
        index, weight = self._bindings[mesh]
        return np.einsum("vk,vk->v", weight, self._read(cloud, time)[index])

    def quantity(self, times: Sequence[float]) -> Quantity:
        """The quantity with its range over at most SAMPLED_TIMES of the times.

        The range is 0 to the largest RANGE_PERCENTILE over these times, which limits the effect of
        outliers.
        """
        indices = np.linspace(0, len(times) - 1, min(SAMPLED_TIMES, len(times)))
        codes = [Usd.TimeCode(times[i]) for i in np.unique(np.round(indices).astype(int))]
        values_by_time = [
            np.concatenate([self._read(cloud, code) for cloud in self._clouds])
            for code in codes or [Usd.TimeCode.EarliestTime()]
        ]
        return Quantity(
            title=self.name,
            measure=self._measure.label,
            unit=self._measure.unit,
            high=max(float(np.percentile(values, RANGE_PERCENTILE)) for values in values_by_time),
            largest=max(float(values.max()) for values in values_by_time),
        )

    def _read(self, cloud: ParticleCloud, time: Usd.TimeCode) -> Floats:
        """Values (N,) in SI; 0 where they are not finite."""
        path = str(cloud.prim.GetPath())
        if self._measure.attributes:
            stored = [a.Get(time) for a in authored_attributes(cloud.prim, self._measure)]
            values = np.asarray(stored, dtype=np.float64).max(0)
        elif path in self._fits:
            positions = cloud.prim.GetAttribute("positions").Get(time)
            values = largest_stretch(self._fits[path](np.asarray(positions, dtype=np.float64)))
        else:
            stored = cloud.prim.GetAttribute(GRADIENTS).Get(time)
            values = largest_stretch(np.asarray(stored, dtype=np.float64).reshape(-1, 3, 3))
        return self._scale * np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)


def authored_attributes(particles: Usd.Prim, measure: Measure) -> list[Usd.Attribute]:
    """The authored attributes of a quantity; constitutive laws may have different ones."""
    named = (particles.GetAttribute(name) for name in measure.attributes)
    return [attribute for attribute in named if attribute.HasValue()]


def _read_cloud(prim: Usd.Prim) -> ParticleCloud:
    times = prim.GetAttribute("positions").GetTimeSamples()
    rest = prim.GetAttribute("gaussianFlesh:restPositions").Get()
    targets = prim.GetRelationship("gaussianFlesh:sourceMeshes").GetTargets()
    return ParticleCloud(
        prim=prim,
        first=Usd.TimeCode(times[0]) if times else Usd.TimeCode.Default(),
        rest=np.asarray(rest, dtype=np.float64).reshape(-1, 3),
        meshes=frozenset(str(target) for target in targets),
    )


def _neighbor_weights(vertices: Floats, particles: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Indices and weights (V, k) of the nearest particles of each vertex.

    Normalized inverse distance weights 1 / (d^2 + d_k^2 / 4), d_k the distance of the farthest of
    them; the second term avoids peaks at particles.
    """
    k = min(NEIGHBORS, len(particles))
    distance, index = cKDTree(particles).query(vertices, k=k)
    distance, index = distance.reshape(-1, k), index.reshape(-1, k)
    farthest = np.maximum(distance[:, -1:], 1e-30)
    weight = 1.0 / (distance**2 + 0.25 * farthest**2)
    return index.astype(np.int64), weight / weight.sum(axis=1, keepdims=True)


STRAIN_NEIGHBORS = 20  # of a particle in the fit: about two shells of a lattice
MIN_SPREAD = (
    1e-2  # of the largest spread of neighbors: directions of smaller spread are not determined
)


def largest_stretch(gradients: Floats) -> NDArray[np.float64]:
    """max_i |s_i - 1| (N,) of the principal stretches s of F (N, 3, 3); NaN where F is not finite.

    0 for rigid motion; 0.3 for extension or compression by 30 % in some direction.
    """
    out = np.full(len(gradients), np.nan)
    finite = np.isfinite(gradients).all(axis=(1, 2))
    stretches = np.linalg.svd(gradients[finite], compute_uv=False)
    out[finite] = np.abs(stretches - 1.0).max(axis=1)
    return out


class NeighborFit:
    """F of each particle by a moving least squares fit to its neighbors' offsets.

    With offsets dX at rest and dx now, and weights w = 1 - (|dX| / 1.1 |dX_far|)^2, the map
        F = (sum w dx dX') (sum w dX dX')^-1
    minimizes sum w |dx - F dX|^2.  It is exact for affine motion, and a mean over the neighborhood
    otherwise.  The stretch is 1 in directions in which neighbors have no spread (a sheet of one
    layer of particles).

    Parameters
    ----------
    rest : (N, 3) rest positions, N >= 2.
    """

    def __init__(self, rest: Floats) -> None:
        k = min(STRAIN_NEIGHBORS + 1, len(rest))
        distance, self._index = cKDTree(rest).query(rest, k=k)
        self._index = self._index.reshape(-1, k)
        offsets = rest[self._index] - rest[:, None]
        farthest = np.maximum(distance.reshape(-1, k)[:, -1:], 1e-30)
        weight = 1.0 - (distance.reshape(-1, k) / (1.1 * farthest)) ** 2
        moment = np.einsum("nk,nki,nkj->nij", weight, offsets, offsets)
        size, axes = np.linalg.eigh(moment)
        determined = size > MIN_SPREAD**2 * size[:, -1:]
        inverse = np.where(determined, 1.0 / np.where(determined, size, 1.0), 0.0)
        solve = np.einsum("nia,na,nja->nij", axes, inverse, axes)
        self._weights = np.einsum("nk,nkj,nji->nki", weight, offsets, solve)
        self._undetermined = np.einsum("nia,na,nja->nij", axes, (~determined).astype(float), axes)

    def __call__(self, positions: Floats) -> NDArray[np.float64]:
        """F (N, 3, 3) at positions (N, 3)."""
        moved = positions[self._index] - positions[:, None]
        return np.einsum("nki,nkj->nij", moved, self._weights) + self._undetermined
