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
    attributes: tuple[str, ...] = ()  # of particles, the largest that is written; (): F is asked
    option: str = ""  # of the bake that writes them


MEASURES = {
    "strain": Measure(label="largest |stretch - 1|"),
    "elastic": Measure(
        label="largest |elastic stretch - 1|",
        attributes=("gaussianFlesh:elasticStrain",),
        option="--internal",
    ),
    "plastic": Measure(
        label="what stays",
        attributes=("gaussianFlesh:plasticStrain", "gaussianFlesh:lostVolume"),
        option="--internal",
    ),
    "stress": Measure(
        label="von Mises", unit="Pa", attributes=("gaussianFlesh:vonMisesStress",),
        option="--stress",
    ),
}  # fmt: skip
MOST = 99.0  # [%] of the particles that the range holds in every frame
SAMPLED_TIMES = 48  # times at which a longer motion is looked at
NEIGHBORS = 8  # particles that a mesh vertex takes its value from


@dataclass(frozen=True, kw_only=True)
class Carrier:
    """One cloud of particles that a bake wrote."""

    prim: Usd.Prim
    first: Usd.TimeCode  # when it lies as at rest, wherever it was lifted to
    rest: Floats  # (N, 3) restPositions, stage units
    meshes: frozenset[str]  # prim paths of what is embedded in it


class Values:
    """A quantity of every bake in a stage, over time.

    Parameters
    ----------
    what : a row of MEASURES.
    path : the file, for messages.
    pressure : [Pa] per stage pressure.

    Raises
    ------
    UsageError : an unknown quantity.
    InputError : there is no bake in the stage, or it does not hold the quantity.
    """

    def __init__(self, stage: Usd.Stage, what: str, path: Path, pressure: float) -> None:
        if what not in MEASURES:
            raise UsageError(
                f"Unknown --color {what}.", f"choose one of: {', '.join((*MEASURES, 'none'))}"
            )
        walk = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
        clouds = [p for p in walk if str(p.GetTypeName()) == SPLAT_TYPE and is_bake_particles(p)]
        self._carriers = [_carrier(prim) for prim in clouds]
        if not self._carriers:
            raise InputError(
                f"{path}: --color {what} needs the particles of a bake, and the file contains "
                f"none.",
                "give a file that gf-usd bake wrote, with a variant of gaussianFlesh other than "
                "none",
            )
        measure = MEASURES[what]
        bare = [c for c in self._carriers if measure.attributes and not written(c.prim, measure)]
        if bare:
            raise InputError(
                f"{path}: <{bare[0].prim.GetPath()}> holds no {what}"
                f" ({', '.join(measure.attributes)}).",
                f"bake with {measure.option}, or use --color strain",
            )
        self.what, self._measure = what, measure
        self.notes: list[str] = []
        self._scale = pressure if measure.unit else 1.0
        self._fits: dict[str, NeighborFit] = {}
        self._skins: dict[str, tuple[NDArray[np.int64], Floats]] = {}
        for carrier in self._carriers:
            if what == "strain" and not carrier.prim.GetAttribute(GRADIENTS).HasValue():
                where = str(carrier.prim.GetPath())
                self._fits[where] = NeighborFit(carrier.rest)
                self.notes.append(
                    f"{where}: strain is fitted to the motion of neighboring particles because "
                    f"the bake holds no deformation gradients (bake with --deformation-gradients)"
                )

    def of_particles(self, prim: Usd.Prim, time: Usd.TimeCode) -> Floats | None:
        """(N,) of the particles of a prim, their twins included; None for those of others."""
        count = len(prim.GetAttribute("gaussianFlesh:restPositions").Get(time) or [])
        for carrier in self._carriers:
            together = carrier.prim.GetParent() == prim.GetParent()
            if together and count == len(carrier.rest):
                return self._read(carrier, time)
        return None

    def carrier_of(self, mesh: str) -> Carrier | None:
        """The particles that a mesh is embedded in; None for a mesh that no bake moved."""
        return next((carrier for carrier in self._carriers if mesh in carrier.meshes), None)

    def knows(self, mesh: str) -> bool:
        """True once the mesh was learned."""
        return mesh in self._skins

    def learn(self, mesh: str, vertices: Floats, particles: Floats) -> None:
        """Remember which particles lie nearest to each vertex of a mesh at rest.

        vertices (V, 3), particles (N, 3) : [m], world, at the carrier's `first` time.
        """
        self._skins[mesh] = _nearest(vertices, particles)

    def of_mesh(self, carrier: Carrier, mesh: str, time: Usd.TimeCode) -> Floats:
        """(V,) of a learned mesh's vertices: a weighted mean of the nearest particles."""
        index, weight = self._skins[mesh]
        return np.einsum("vk,vk->v", weight, self._read(carrier, time)[index])

    def quantity(self, times: Sequence[float]) -> Quantity:
        """The quantity with its range over the times, or up to 48 of them evenly spread.

        From 0 to what 99 % of the particles stay below in every frame, so that one particle gone
        wild does not make all others look alike.
        """
        spread = np.linspace(0, len(times) - 1, min(SAMPLED_TIMES, len(times)))
        codes = [Usd.TimeCode(times[i]) for i in np.unique(np.round(spread).astype(int))]
        seen = [
            np.concatenate([self._read(carrier, code) for carrier in self._carriers])
            for code in codes or [Usd.TimeCode.EarliestTime()]
        ]
        return Quantity(
            title=self.what,
            measure=self._measure.label,
            unit=self._measure.unit,
            high=max(float(np.percentile(values, MOST)) for values in seen),
            largest=max(float(values.max()) for values in seen),
        )

    def _read(self, carrier: Carrier, time: Usd.TimeCode) -> Floats:
        """(N,) in SI; 0 where a number is not finite."""
        where = str(carrier.prim.GetPath())
        if self._measure.attributes:
            stored = [a.Get(time) for a in written(carrier.prim, self._measure)]
            values = np.asarray(stored, dtype=np.float64).max(0)
        elif where in self._fits:
            now = carrier.prim.GetAttribute("positions").Get(time)
            values = largest_stretch(self._fits[where](np.asarray(now, dtype=np.float64)))
        else:
            stored = carrier.prim.GetAttribute(GRADIENTS).Get(time)
            values = largest_stretch(np.asarray(stored, dtype=np.float64).reshape(-1, 3, 3))
        return self._scale * np.nan_to_num(values, nan=0.0, posinf=0.0, neginf=0.0)


def written(particles: Usd.Prim, measure: Measure) -> list[Usd.Attribute]:
    """The attributes that particles hold it in: of several laws each has its own."""
    named = (particles.GetAttribute(name) for name in measure.attributes)
    return [attribute for attribute in named if attribute.HasValue()]


def _carrier(prim: Usd.Prim) -> Carrier:
    times = prim.GetAttribute("positions").GetTimeSamples()
    rest = prim.GetAttribute("gaussianFlesh:restPositions").Get()
    targets = prim.GetRelationship("gaussianFlesh:sourceMeshes").GetTargets()
    return Carrier(
        prim=prim,
        first=Usd.TimeCode(times[0]) if times else Usd.TimeCode.Default(),
        rest=np.asarray(rest, dtype=np.float64).reshape(-1, 3),
        meshes=frozenset(str(target) for target in targets),
    )


def _nearest(vertices: Floats, particles: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Index and weight (V, k) of the particles that each vertex takes its value from.

    Weights are 1 / (d^2 + d_k^2 / 4) with d_k the distance of the farthest, normalized: smooth,
    without a peak at each particle.
    """
    k = min(NEIGHBORS, len(particles))
    distance, index = cKDTree(particles).query(vertices, k=k)
    distance, index = distance.reshape(-1, k), index.reshape(-1, k)
    far = np.maximum(distance[:, -1:], 1e-30)
    weight = 1.0 / (distance**2 + 0.25 * far**2)
    return index.astype(np.int64), weight / weight.sum(axis=1, keepdims=True)


STRAIN_NEIGHBORS = 20  # of a particle in a fit: about two shells of a lattice
FLATTEST = 1e-2  # of the largest spread: along a thinner direction neighbors tell nothing


def largest_stretch(gradients: Floats) -> NDArray[np.float64]:
    """max_i |s_i - 1| (N,) of the principal stretches s of F (N, 3, 3): 0 at rest and turned.

    0.3 is a part that was drawn out by 30 %, or pressed together by 30 %, in some direction.
    NaN where F is not finite.
    """
    out = np.full(len(gradients), np.nan)
    sound = np.isfinite(gradients).all(axis=(1, 2))
    stretches = np.linalg.svd(gradients[sound], compute_uv=False)
    out[sound] = np.abs(stretches - 1.0).max(axis=1)
    return out


class NeighborFit:
    """F of each particle as the best linear map of its neighbors' offsets.

    With offsets dX at rest and dx now, and weights w = 1 - (|dX| / 1.1 |dX_far|)^2, the map
        F = (sum w dx dX') (sum w dX dX')^-1
    minimizes sum w |dx - F dX|^2 [moving least squares].  It is exact for affine motion, and a
    mean over the neighborhood otherwise.  A direction in which the neighbors hardly spread (a
    sheet one particle thick) is taken as not stretched.

    Parameters
    ----------
    rest : (N, 3) rest positions, N >= 2.
    """

    def __init__(self, rest: Floats) -> None:
        k = min(STRAIN_NEIGHBORS + 1, len(rest))
        distance, self._index = cKDTree(rest).query(rest, k=k)
        self._index = self._index.reshape(-1, k)
        offsets = rest[self._index] - rest[:, None]
        far = np.maximum(distance.reshape(-1, k)[:, -1:], 1e-30)
        weight = 1.0 - (distance.reshape(-1, k) / (1.1 * far)) ** 2
        moment = np.einsum("nk,nki,nkj->nij", weight, offsets, offsets)
        size, axes = np.linalg.eigh(moment)
        known = size > FLATTEST**2 * size[:, -1:]
        inverse = np.where(known, 1.0 / np.where(known, size, 1.0), 0.0)
        solve = np.einsum("nia,na,nja->nij", axes, inverse, axes)
        self._weights = np.einsum("nk,nkj,nji->nki", weight, offsets, solve)
        self._unknown = np.einsum("nia,na,nja->nij", axes, (~known).astype(float), axes)

    def __call__(self, positions: Floats) -> NDArray[np.float64]:
        """F (N, 3, 3) at positions (N, 3)."""
        moved = positions[self._index] - positions[:, None]
        return np.einsum("nki,nkj->nij", moved, self._weights) + self._unknown
