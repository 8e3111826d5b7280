"""The implementations of the laws in `gf_usd.core.materials.laws`, and the laws of a body.

The module that a row of that table names defines, for an elastic deformation gradient F and the
values q = (mu, lam, then the parameters of the row):

    psi(F, q, converged)    energy density [J/m^3 of rest volume], Taichi
    pk1(F, q, converged)    its gradient P = d psi / d F [Pa], Taichi
    flow(F, q, a, dt, converged)  only for a law with plastic flow, Taichi: the admissible F and
                            internal variables a to which a trial state returns in dt [s] >= 0, and
                            the work [J/m^3] of the final stress, P : (trial F - F)
    stored(s, J, q)         psi of signed stretches s (N, 3) and their product J (N,), NumPy
    moduli(s, J, q)         d^2 psi / dF^2 along the planes that keep J, and d^2 psi / dJ^2 [Pa]
    hardness(q, a)          only where internal variables stiffen the law, Taichi: the factor on mu
                            and lam; flow gets the initial mu and lam
    hardnesses(q, a)        the same for a (N, internals), NumPy

In Taichi F and P are lists of nine lane vectors (`simd3x3`), q and a lists of lane vectors; in
NumPy q has rows (N,). psi and pk1 are defined for every F, including inverted ones. `flow` returns
F exactly in lanes without flow. The tests iterate over the registry, so that gradient, objectivity
and rest state of a new row are tested as soon as it is listed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.materials.laws import ELASTIC_STRAIN, LAWS, LawSpec, check_law
from gf_usd.core.materials.material import Material
from gf_usd.physics import taichi_arrays

MODULI = 2  # first values of every law: mu, lam
GRADIENT = 9  # first values of a history: F_p^-1 (TL) or F_e (UL)


@dataclass(frozen=True, kw_only=True, eq=False)
class Law:
    """A constitutive law: its row, and the functions of its module."""

    spec: LawSpec
    psi: Callable
    pk1: Callable
    flow: Callable | None
    stored: Callable
    moduli: Callable
    hardness: Callable | None = None
    hardnesses: Callable | None = None

    @property
    def hardens(self) -> bool:
        """Whether its moduli depend on its internal variables."""
        return self.hardness is not None


@cache
def load(spec: LawSpec) -> Law:
    """The law of a row. Raises ValueError where row and module disagree on plastic flow."""
    module = import_module(spec.code, __package__)
    flow = getattr(module, "flow", None)
    if spec.flows != (flow is not None):
        raise ValueError(f"the row of {spec.token} says flows={spec.flows}, {spec.code} otherwise")
    return Law(
        spec=spec, psi=module.psi, pk1=module.pk1, flow=flow, stored=module.stored,
        moduli=module.moduli, hardness=getattr(module, "hardness", None),
        hardnesses=getattr(module, "hardnesses", None),
    )  # fmt: skip


@dataclass(frozen=True)
class LawSet:
    """The laws of a body, numbered by position; kernels are compiled for a law set."""

    laws: tuple[Law, ...]

    @property
    def first(self) -> Law:
        return self.laws[0]

    @property
    def several(self) -> int:
        """1 for a body with several laws, otherwise 0."""
        return int(len(self.laws) > 1)

    @property
    def values(self) -> int:
        """Number of values q per particle: the moduli, and the parameters of the law with
        the most.
        """
        return MODULI + max(len(law.spec.parameters) for law in self.laws)

    @property
    def constants(self) -> int:
        """Number of constants per particle: q, and the number of the law where there are
        several.
        """
        return self.values + self.several

    @property
    def which(self) -> int:
        """Index of the law's number among the constants; arbitrary for a single law."""
        return self.constants - 1

    @property
    def flows(self) -> bool:
        """Whether a law has plastic flow, so that particles have a history."""
        return any(law.spec.flows for law in self.laws)

    @property
    def hardens(self) -> bool:
        """Whether the moduli of a law depend on the history (Updated Lagrangian only)."""
        return any(law.hardens for law in self.laws)

    @property
    def internals(self) -> int:
        """Number of internal variables per particle: those of the law with the most."""
        return max(len(law.spec.internal) for law in self.laws)

    @property
    def history(self) -> int:
        """Size of a particle's history: a gradient, internal variables, and dissipated
        energy [J].
        """
        return GRADIENT + self.internals + 1 if self.flows else 0


def convergence(real: type) -> float:
    """Change of a rotation at which its iteration ends, for a precision of the kernels."""
    return 1e-7 if real is np.float32 else 1e-15


@cache
def law_set(specs: tuple[LawSpec, ...]) -> LawSet:
    """The cached `LawSet` of the rows, so that kernels are compiled once for it."""
    return LawSet(tuple(load(spec) for spec in specs))


@dataclass(frozen=True, kw_only=True)
class ParticleLaws:
    """The law of each particle, with its values."""

    set: LawSet
    of: Ints  # (N,) into set.laws
    q: Floats  # (set.values, N) mu, lam [Pa], then the parameters of the particle's own law
    rest: Floats  # (set.internals, N) internal variables at rest

    @property
    def unbounded(self) -> Ints:
        """(N,) whether the law of each particle allows unbounded flow."""
        return np.array([law.spec.unbounded for law in self.set.laws])[self.of]

    @property
    def constants(self) -> Floats:
        """(N, set.constants) in the kernels' layout."""
        number = [self.of] if self.set.several else []
        return np.column_stack([*self.q, *number])

    @property
    def history(self) -> Floats:
        """(N, set.history) initial histories, in the kernels' layout."""
        n = len(self.of)
        if not self.set.flows:
            return np.zeros((n, 0))
        return np.column_stack([np.tile(np.eye(3).ravel(), (n, 1)), *self.rest, np.zeros(n)])

    def hardened(self, history: Floats) -> ParticleLaws:
        """The laws with mu and lam after hardening; history : (N, set.history)."""
        if not self.set.hardens:
            return self
        q = self.q.copy()
        for number, law in enumerate(self.set.laws):
            if law.hardnesses is not None:
                mine = self.of == number
                q[:MODULI, mine] *= law.hardnesses(q[:, mine], history[mine, GRADIENT:-1])
        return replace(self, q=q)

    def written(self, history: Floats, stretch: Floats) -> dict[str, Floats]:
        """`internal`, and the largest |stretch - 1| of stretches (N, 3) of F_e; {} without plastic
        flow.
        """
        if not self.set.flows:
            return {}
        return {**self.internal(history), ELASTIC_STRAIN.name: np.abs(stretch - 1.0).max(1)}

    def internal(self, history: Floats) -> dict[str, Floats]:
        """(N,) of each internal variable by name, NaN for particles whose law does not have it.

        history : (N, set.history).
        """
        out: dict[str, Floats] = {}
        for number, law in enumerate(self.set.laws):
            mine = self.of == number
            for k, variable in enumerate(law.spec.internal, GRADIENT):
                column = out.setdefault(variable.name, np.full(len(self.of), np.nan))
                column[mine] = history[mine, k]
        return out

    def stored(self, s: Floats, J: Floats) -> Floats:
        """(N,) psi [J/m^3] of elastic stretches s (N, 3), signed, and their products J (N,)."""
        return self._each(lambda law, mine: law.stored(s[mine], J[mine], self.q[:, mine]))

    def moduli(self, s: Floats, J: Floats) -> tuple[Floats, Floats]:
        """(N,) shear and bulk stiffness [Pa] at elastic stretches s (N, 3) and J (N,)."""
        if not self.set.several:
            shear, bulk = self.set.first.moduli(s, J, self.q)
            return shear, bulk
        shear, bulk = self._each(
            lambda law, mine: np.stack(law.moduli(s[mine], J[mine], self.q[:, mine]))
        )
        return shear, bulk

    def _each(self, value_of: Callable[[Law, Ints], Floats]) -> Floats:
        if not self.set.several:
            return value_of(self.set.first, np.s_[:])
        parts = [np.flatnonzero(self.of == k) for k in range(len(self.set.laws))]
        values = [value_of(law, mine) for law, mine in zip(self.set.laws, parts)]
        out = np.empty((*values[0].shape[:-1], len(self.of)))
        for mine, value in zip(parts, values):
            out[..., mine] = value
        return out


def take_dissipated(laws: LawSet, array: Any) -> float:
    """[J] dissipated by plastic flow since the last call, from a device array of histories."""
    seen = taichi_arrays.values(array)
    rows = seen.reshape(-1, laws.history, *array.element_shape)
    total = float(rows[:, -1].sum(dtype=float))
    rows[:, -1] = 0.0
    taichi_arrays.put(array, seen)
    return total


def particle_laws(
    materials: Sequence[Material], material: Ints, per: dict[str, Floats]
) -> ParticleLaws:
    """The laws of particles.

    material : (N,) index into materials; per : (N,) of each value by name, from
    `per_particle.spread`.

    Raises UsageError for an unknown law.
    """
    tokens = [check_law(one.law) for one in materials]
    present = [token for token in LAWS if token in tokens]
    laws = law_set(tuple(LAWS[token] for token in present))
    of = np.array([present.index(token) for token in tokens])[np.asarray(material)]
    q = np.zeros((laws.values, len(of)))
    rest = np.zeros((laws.internals, len(of)))
    q[:MODULI] = per["mu"], per["lam"]
    for k, law in enumerate(laws.laws):
        mine = of == k
        for row, parameter in enumerate(law.spec.parameters, MODULI):
            q[row, mine] = per[parameter.name][mine]
        for row, variable in enumerate(law.spec.internal):
            rest[row, mine] = variable.rest
    return ParticleLaws(set=laws, of=of, q=q, rest=rest)
