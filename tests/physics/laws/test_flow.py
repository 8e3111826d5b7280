"""Return mappings of the laws that flow: what holds of any, and the radial return in numbers."""

from __future__ import annotations

import numpy as np
import pytest
from flowing import ROW, registered
from lane_kernels import evaluate, flow, flow_with_loss
from random_turns import gradients, random_turns
from von_mises_law import HARDENING

from gf_usd.core.materials.laws import LAWS, YIELD_STRESS
from gf_usd.physics.laws.registry import load
from gf_usd.physics.laws.von_mises import CLOSE
from gf_usd.verify.cases.patch import stress

MU, LAM, YIELD = 2.0, 3.0, 0.05  # [Pa]; it yields at a strain of about 0.01
BULK, CAP, TENSILE = LAM + 2.0 / 3.0 * MU, 2.12, 0.4
# Parameters of each law besides the yield stress; a law without a row here has none to speak of.
OWN = {
    "vonMises": {"hardening": 0.2, "saturation": 0.04, "saturation_rate": 15.0},
    "crushable": {"hardening": 0.3, "cap_shape": CAP, "tensile_yield_ratio": TENSILE},
}
OVER_OTHERS = ("vonMisesNeoHookean", "vonMisesCorotated")  # elastic energies than Hencky's
OWN |= dict.fromkeys(OVER_OTHERS, OWN["vonMises"])
ISOCHORIC = ("vonMises", *OVER_OTHERS, ROW.token)


def yielding() -> list[str]:
    """The laws that yield at a stress.

    What bears more the more it is pressed has its own file, and what flows without limit does it by
    the code of another.
    """
    return [t for t, row in LAWS.items() if YIELD_STRESS in row.parameters and not row.unbounded]


# One law over another energy is held to everything at once, the second with the slow tests.
SLOW = {OVER_OTHERS[1]: (pytest.mark.slow,)}
flowing = pytest.mark.parametrize(
    "token",
    [pytest.param(t, marks=SLOW.get(t, ())) for t in yielding()] + [ROW.token],
)


@pytest.fixture(autouse=True)
def _with_a_law_that_flows():
    with registered():
        yield


def hardened(n: int, seed: int = 5) -> np.ndarray:
    """(n, 1) equivalent plastic strains from before."""
    return np.random.default_rng(seed).uniform(0.0, 0.1, (n, 1))


def returned(token: str, F: np.ndarray, a: np.ndarray, real: type = np.float64):
    return flow(token, F, a, MU, LAM, real, yield_stress=YIELD, **OWN.get(token, {}))


def excess(token: str, F: np.ndarray, a: np.ndarray) -> np.ndarray:
    """(n,) [Pa] equivalent stress over what the material bears, as the laws' sources have it."""
    e, a = np.log(np.linalg.svd(F)[1]), a[:, 0]
    dev = e - e.mean(1, keepdims=True)
    shear = np.sqrt(1.5) * 2.0 * MU * np.linalg.norm(dev, axis=1)
    if token in OVER_OTHERS:
        tau = np.array([stress(token, one, MU, LAM) @ one.T for one in F])
        tau -= np.trace(tau, axis1=1, axis2=2)[:, None, None] / 3.0 * np.eye(3)
        shear = np.sqrt(1.5) * np.linalg.norm(tau, axis=(1, 2))
    if token in ("vonMises", *OVER_OTHERS):
        return shear - YIELD - 0.2 * a - 0.04 * (1.0 - np.exp(-15.0 * a))
    if token == "crushable":
        p = -BULK * e.sum(1)
        cap = np.where(p < 0.0, CAP / TENSILE, CAP) ** 2
        return np.sqrt((shear**2 + cap * p**2) / (1.0 + CAP**2 / 9.0)) - YIELD - 0.3 * a
    assert token == ROW.token
    return shear - YIELD - HARDENING * MU * a


@flowing
@pytest.mark.parametrize("real", [np.float64, np.float32])
def test_inside_the_yield_surface_nothing_changes_not_a_bit(token, real):
    F, a = gradients(64, 0.0008).astype(real), hardened(64).astype(real)
    E, after = returned(token, F, a, real)
    assert np.array_equal(E, F)
    assert np.array_equal(after, a)


@flowing
def test_at_rest_nothing_flows_however_turned(token):
    F, a = random_turns(16, 3), np.zeros((16, 1))
    E, after = returned(token, F, a)
    assert np.array_equal(E, F)
    assert np.array_equal(after, a)


@flowing
@pytest.mark.parametrize(("real", "rounding"), [(np.float64, 2e-16), (np.float32, 1e-7)])
def test_beyond_it_the_stress_lands_on_it(token, real, rounding):
    F, a = gradients(256, 0.3), hardened(256)
    beyond = excess(token, F, a) > 0.0
    assert beyond.sum() > 200
    E, after = returned(token, F, a, real)
    # Logarithms of stretches from 0.7 to 1.4 by F^T F, some dozen operations, times 2 mu or 3 K;
    # and, of what is found by Newton's iteration, the square of its last residual but one.
    landing = 50 * rounding * 3.0 * BULK + (token != ROW.token) * CLOSE**2
    assert np.abs(excess(token, E, after)[beyond]).max() < landing
    a = a.astype(real)
    assert (after[beyond] >= a[beyond]).all()
    assert (after[beyond] > a[beyond]).mean() > 0.4, "some are pressed"


@flowing
def test_to_return_twice_is_to_return_once(token):
    E, a = returned(token, gradients(64, 0.3), hardened(64))
    again, after = returned(token, E, a)
    # Rounding of some dozen operations; and what Newton's iteration leaves, as above.
    near = 1e-14 + (token != ROW.token) * CLOSE**2
    np.testing.assert_allclose(again, E, rtol=0.0, atol=near)
    np.testing.assert_allclose(after, a, rtol=0.0, atol=near)


@pytest.mark.parametrize("token", [pytest.param(t, marks=SLOW.get(t, ())) for t in ISOCHORIC])
def test_volume_stays(token):
    F = gradients(64, 0.3)
    E, _ = returned(token, F, hardened(64))
    np.testing.assert_allclose(np.linalg.det(E), np.linalg.det(F), rtol=1e-13)


@flowing
def test_flow_takes_energy(token):
    F, a = gradients(256, 0.3), hardened(256)
    E, _ = returned(token, F, a)
    before, after = (evaluate(token, G, MU, LAM)[0] for G in (F, E))
    assert (after[excess(token, F, a) > 0.0] < before[excess(token, F, a) > 0.0]).all()
    assert (after <= before).all()


@flowing
def test_flow_turns_with_the_body_and_with_the_material(token):
    F, a, Q = gradients(64, 0.3), hardened(64), random_turns(64, 9)
    E, after = returned(token, F, a)
    for turned, expected in ((Q @ F, Q @ E), (F @ Q, E @ Q)):
        seen, seen_after = returned(token, turned, a)
        np.testing.assert_allclose(seen, expected, rtol=0.0, atol=1e-13)
        np.testing.assert_allclose(seen_after, after, rtol=0.0, atol=1e-13)


def test_radial_return_in_numbers():
    # Uniaxial stretch e of a material with nu = 0.3: dev e = 2/3 (1 + nu) e = 2/3 ..., by hand
    e = np.array([0.04, -0.01, -0.01])  # dev e = (.1/3, -.05/3, -.05/3), |dev e| = .05 sqrt(2/3)
    size = 0.05 * np.sqrt(2.0 / 3.0)
    H = HARDENING * MU
    g = (2.0 * MU * size - np.sqrt(2.0 / 3.0) * YIELD) / (2.0 * MU + 2.0 / 3.0 * H)
    dev = e - e.mean()
    expected = np.diag(np.exp(e - g * dev / size))
    E, a = returned(ROW.token, np.diag(np.exp(e))[None], np.zeros((1, 1)))
    np.testing.assert_allclose(E[0], expected, rtol=0.0, atol=1e-15)
    assert a[0, 0] == pytest.approx(np.sqrt(2.0 / 3.0) * g, rel=1e-14)


def test_what_is_pressed_together_stays_smaller_and_what_is_sheared_does_not():
    squeezed, sheared = np.full((1, 3), -0.05), np.array([[0.1, -0.1, 0.0]])
    for e, lost in ((squeezed, True), (-squeezed, False), (sheared, False)):
        F = np.exp(e)[:, :, None] * np.eye(3)
        E, a = returned("crushable", F, np.zeros((1, 1)))
        assert np.abs(E - F).max() > 1e-3
        assert (a[0, 0] > 1e-3) == lost
        if lost:
            assert a[0, 0] == pytest.approx(np.log(np.linalg.det(E[0]) / np.linalg.det(F[0])))


@pytest.mark.parametrize("tension", [1.0, 0.25])
def test_the_tensile_yield_ratio_is_that_of_the_pressures_at_yield(tension):
    # All around: |p| = Y sqrt(1 + alpha^2 / 9) / alpha, in tension times the ratio.
    e = np.array([[-0.02] * 3, [0.02] * 3])
    own = {"yield_stress": YIELD, "cap_shape": CAP, "tensile_yield_ratio": tension}
    E, _ = flow("crushable", np.exp(e)[:, :, None] * np.eye(3), np.zeros((2, 1)), MU, LAM, **own)
    p = BULK * np.log(np.linalg.det(E))
    pressed = YIELD * np.sqrt(1.0 + CAP**2 / 9.0) / CAP
    np.testing.assert_allclose(p, [-pressed, tension * pressed], rtol=CLOSE**2 + 1e-12)


def test_a_viscous_return_is_that_of_perzyna_backwards_in_time():
    # sigma* - 3 mu g = Y + eta g / dt, by hand for linear hardening.
    e, dt, eta = np.array([0.04, -0.01, -0.01]), 1e-3, 2e-3
    dev = e - e.mean()
    trial = np.sqrt(1.5) * 2.0 * MU * np.linalg.norm(dev)
    F = np.diag(np.exp(e))[None]
    own = {"yield_stress": YIELD, "hardening": 0.2, "flow_viscosity": eta}
    _, a = flow("vonMises", F, np.zeros((1, 1)), MU, LAM, dt=dt, **own)
    assert a[0, 0] == pytest.approx((trial - YIELD) / (3.0 * MU + 0.2 + eta / dt), rel=1e-12)
    _, a = flow("vonMises", F, np.zeros((1, 1)), MU, LAM, dt=0.0, **own)
    assert a[0, 0] < 1e-20, "in no time nothing that is viscous flows"


def test_over_another_energy_it_flows_along_the_deviator_of_the_strain():
    F, a = gradients(64, 0.3), np.zeros((64, 1))
    E, after = returned("vonMisesNeoHookean", F, a)
    before, left = (np.log(np.linalg.svd(G)[1]) for G in (F, E))
    dev = before - before.mean(1, keepdims=True)
    along = np.sqrt(1.5) * after * dev / np.linalg.norm(dev, axis=1, keepdims=True)
    np.testing.assert_allclose(before - left, along, rtol=0.0, atol=1e-13)


def test_a_viscous_return_over_another_energy_leaves_the_stress_that_its_rate_asks_for():
    F, a, eta, dt = gradients(64, 0.3), hardened(64), 2e-3, 1e-3
    own = {**OWN["vonMisesNeoHookean"], "yield_stress": YIELD, "flow_viscosity": eta}
    E, after = flow("vonMisesNeoHookean", F, a, MU, LAM, dt=dt, **own)
    flown = after > a
    assert flown.mean() > 0.8
    left = excess("vonMisesNeoHookean", E, after) - eta * (after - a)[:, 0] / dt
    assert np.abs(left[flown[:, 0]]).max() < 1e-10  # as where it lands, above


@pytest.mark.parametrize("token", OVER_OTHERS)
def test_a_law_over_another_has_its_functions(token):
    law, under = (load(LAWS[name]) for name in (token, LAWS[token].over))
    assert (law.psi, law.pk1, law.stored, law.moduli) == (
        under.psi, under.pk1, under.stored, under.moduli,
    )  # fmt: skip


FLAT_OR_INSIDE_OUT = [
    # By stretches, and near a turn or a reflection by the series; the last of each eight flows.
    [1.0, 1.2, 0.05], [1.0, 1.2, -0.8], [-65.0, 1.0, 1.0], [-0.01, 1.0, 1.0], [0.0, 1.0, 1.0],
    [0.02, 0.02, 0.021], [-0.2, -0.3, -0.3], [1.5, 1.0, 0.7],
    [-1.0, 1.003, 1.0], [-1.003, -1.0, -1.0], [1.0, 0.997, -1.0], [0.03, 0.03009, 0.03],
    [-0.3, 0.3, 0.3009], [-9.0, 9.027, 9.0], [-9.0, -9.027, -9.0], [1.003, 1.0, 0.998],
]  # fmt: skip


@pytest.mark.parametrize("real", [np.float64, np.float32])
@pytest.mark.parametrize(
    "token",
    [*yielding(), ROW.token, pytest.param("druckerPrager", marks=pytest.mark.slow)],
)
def test_what_is_flat_or_inside_out_is_left_to_the_law(token, real):
    stretches = np.array(FLAT_OR_INSIDE_OUT)
    F = random_turns(16, 1) @ (stretches[:, :, None] * random_turns(16, 2).swapaxes(1, 2))
    F = F.astype(real).astype(float)
    weak = {**OWN.get(token, {}), "yield_stress": 1e-3}
    own = {"internal_friction": 0.6} if token == "druckerPrager" else weak
    E, after, loss = flow_with_loss(token, F, np.zeros((16, 1)), MU, LAM, real, **own)
    acts = np.arange(16) % 8 == 7
    assert np.array_equal(E[~acts], F[~acts])
    assert not loss[~acts].any()
    assert not after[~acts].any()
    assert (np.abs(E - F)[acts] > 1e-5).any((1, 2)).all()
    assert np.isfinite(E).all()


def test_flow_gives_no_energy_where_the_stress_falls_with_the_stretch():
    # tau = 2 mu (s - 1) s of the corotated law falls below s = 1/2, at constant volume.
    s = np.random.default_rng(0).uniform(0.12, 0.5, (64, 3))
    F = random_turns(64, 1) @ (s[:, :, None] * random_turns(64, 2).swapaxes(1, 2))
    own = {**OWN["vonMisesCorotated"], "yield_stress": YIELD}
    E, after, loss = flow_with_loss("vonMisesCorotated", F, np.zeros((64, 1)), MU, LAM, **own)
    assert (loss >= 0.0).all()
    stays = after[:, 0] == 0.0
    assert stays.sum() > 32
    assert np.array_equal(E[stays], F[stays])
