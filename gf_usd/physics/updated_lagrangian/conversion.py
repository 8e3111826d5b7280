"""Conversion of particles of an elastic body to a flowing material (`core.materials.conversion`).

At the start of a frame, a particle that has exceeded its limit gets the law and the values of
another material. Its mass, position, velocity and affine velocity are unchanged, so that momentum
and angular momentum are conserved exactly. Its new elastic deformation is without shear, and has
the previous pressure where the new material is the stiffer one,

    F_e = J_e^(1/3) I,    J_e = 1 + (J - 1) min(1, K / K')

with K and K' = lam + 2/3 mu of the old and the new material: to first order in J - 1 the volumetric
energy is multiplied by K / K' or unchanged, and never increased. The energy lost,

    V0 (psi(F) - psi'(F_e)),

is reported as dissipation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gf_usd.core.arrays import Floats, Ints
from gf_usd.core.frames.particles import Particles
from gf_usd.core.frames.settings import Settings
from gf_usd.core.materials.conversion import STRAIN, STRESS, TIME, Conversion
from gf_usd.core.materials.material import Material
from gf_usd.core.materials.per_particle import after_conversion, of_materials, with_derived
from gf_usd.physics.contact.floor import FloorContact
from gf_usd.physics.laws.registry import GRADIENT, particle_laws
from gf_usd.physics.total_lagrangian.setup.values import viscosities
from gf_usd.physics.updated_lagrangian.setup import Body
from gf_usd.physics.updated_lagrangian.state import State

LEAST_J = 0.1  # of F_e after conversion, also of particles that are inverted or nearly so


def past_limits(
    conversions: Sequence[Conversion],
    done: NDArray[np.bool_],
    code: float,
    F: Floats,
    stress: Floats | None,
) -> NDArray[np.bool_]:
    """(N,) which particles exceed their limit, without those that are `done` (N,).

    code : time code; F : (N, 3, 3) of the particles; stress : (N,) [Pa] von Mises stress, where a
    limit is one of stress.
    """
    from gf_usd.physics.per_particle import strains

    out = np.zeros(len(done), bool)
    for one in conversions:
        rows, limit = one.particles[~done[one.particles]], one.limit
        if not len(rows):
            continue
        if limit.kind == TIME:
            out[rows] = code >= limit.value
        elif limit.kind == STRESS:
            assert stress is not None
            out[rows] = stress[rows] > limit.value
        else:
            assert limit.kind == STRAIN
            stretch = np.maximum(strains(F[rows])[0], 1e-30)
            out[rows] = np.abs(np.log(stretch)).max(1) > limit.value
    return out


class Convertible(Protocol):
    """A solver whose particles can be converted."""

    particles: Particles
    settings: Settings
    body: Body
    state: State

    def von_mises(self) -> Floats:
        """(N,) [Pa] von Mises stress of the particles."""
        ...

    def follow(self, contact: FloorContact | None) -> None:
        """Use the laws and the contact samples of the body after a conversion."""
        ...


class Conversions:
    """The converted particles, as a part of the state.

    solver : whose body, state and planes are updated; materials : of the bake.
    """

    def __init__(self, solver: Convertible, materials: Sequence[Material]) -> None:
        self._solver, self._materials = solver, materials
        self._particles, self._start = solver.particles, solver.body
        self.done: NDArray[np.bool_] = np.zeros(len(solver.particles), bool)
        self.dissipated = 0.0  # [J] in the last frame

    def save(self) -> dict[str, Any]:
        """See `Saved`."""
        return {"converted": self.done.copy()}

    def load(self, saved: Mapping[str, Any]) -> None:
        """See `Saved`."""
        done = np.asarray(saved["converted"], bool)
        if (done != self.done).any():
            self._set(done)

    def frame(self, index: int) -> None:
        """Convert the particles that exceed their limit, before the substeps to frame `index`."""
        self.dissipated = 0.0
        given = self._particles.conversions
        left = [one for one in given if not self.done[one.particles].all()]
        if not left:
            return
        solver, kinds = self._solver, {one.limit.kind for one in left}
        passed = self.done | past_limits(
            left, self.done, solver.settings.time_code(index - 1),
            solver.state.rows("F", 9).reshape(-1, 3, 3),
            solver.von_mises() if STRESS in kinds else None,
        )  # fmt: skip
        if (new := np.flatnonzero(passed & ~self.done)).size:
            self._convert(passed, new)

    def _convert(self, passed: NDArray[np.bool_], new: Ints) -> None:
        """Convert the particles `new`; afterwards `passed` (N,) are converted."""
        from gf_usd.physics.per_particle import strains

        solver = self._solver
        state, before = solver.state, solver.body.law
        stretch, J = strains(state.elastic)
        bulk = before.q[1] + 2.0 / 3.0 * before.q[0]
        lost = before.stored(stretch, J)[new]
        self._set(passed)
        law = solver.body.law
        ratio = np.minimum(1.0, bulk / np.maximum(law.q[1] + 2.0 / 3.0 * law.q[0], 1e-300))
        J = np.maximum(1.0 + (J - 1.0) * ratio, LEAST_J)
        stretch[new] = np.cbrt(J[new])[:, None]
        history = state.rows("history", law.set.history)
        history[new] = law.history[new]
        history[new, :GRADIENT] = (np.cbrt(J[new])[:, None, None] * np.eye(3)).reshape(-1, GRADIENT)
        state.put("history", history)
        lost = lost - law.stored(stretch, J)[new]
        self.dissipated = float(solver.body.per["V0"][new] @ lost)

    def _set(self, done: NDArray[np.bool_]) -> None:
        """Give the particles `done` (N,) the values of their new material, and the others their
        own.
        """
        solver, start = self._solver, self._start
        after = after_conversion(self._particles)
        per = {**start.per}
        for name, values in of_materials(after, self._materials).items():
            if name != "density":  # mass is conserved
                per[name] = np.where(done, values, per[name])
        per = with_derived(per)
        material = np.where(done, after.material, self._particles.material)
        law = particle_laws(self._materials, material, per)
        contact = start.contact
        if contact is not None and start.embedding is not None:
            of = start.embedding.particle[:, 0]
            contact = replace(
                contact, friction=per["friction"][of], restitution=per["restitution"][of]
            )
            solver.state.put("sample_constants", contact.law.ravel())
        solver.body = replace(start, per=per, law=law, contact=contact)
        solver.state.put("constants", law.constants.ravel())
        solver.state.put("viscosity", viscosities(per, start.h).ravel())
        self.done = done.copy()
        solver.follow(contact)
