"""Which contact samples are searched in a substep: those left alone change nothing."""

from __future__ import annotations

import numpy as np
import pytest
from contact_scenes import contact_solver
from solids import sphere

from gf_usd.physics.contact import active
from gf_usd.physics.contact.active import ActiveSamples
from gf_usd.physics.total_lagrangian.limits import FALL, SLACK

FAST = 1e12  # [m/s] at which a sample may always have come to the floor


def landed(self_contact: bool = False, frames: int = 3):
    """A ball of 1 m that comes down at 3 m/s and is compressed, a few frames of 1/24 s on."""
    solver = contact_solver(
        sphere(center=(0.0, 1.05, 0.0), subdivisions=3), particles=400, frames=frames, floor=0.0,
        velocity=(0.0, -3.0, 0.0), self_contact=self_contact,
    )  # fmt: skip
    for _ in solver.frames():
        pass
    return solver


@pytest.mark.slow
@pytest.mark.parametrize("self_contact", [False, True])
def test_samples_left_alone_change_no_bit(self_contact: bool, monkeypatch):
    some = landed(self_contact)
    within = ActiveSamples._within

    def always(self, *args):
        near = within(self, *args)
        self._fall = FAST
        return near

    monkeypatch.setattr(ActiveSamples, "_within", always)
    every = landed(self_contact)
    for name in ("u", "v", "sample_depth", "sample_spring"):
        np.testing.assert_array_equal(some.state.get(name), every.state.get(name), err_msg=name)
    assert some.state.get("sample_depth").max() > 0.0, "it came to the floor"


@pytest.mark.slow
def test_samples_of_before_serve_as_well_to_the_bit(monkeypatch):
    kept = []
    serves = ActiveSamples._serves
    monkeypatch.setattr(
        ActiveSamples, "_serves", lambda self, *args: kept.append(serves(self, *args)) or kept[-1]
    )
    monkeypatch.setattr(active, "SURPLUS", 1e9)
    some = landed(self_contact=True, frames=6)
    assert any(kept), "some chunks keep the samples of the one before"
    monkeypatch.setattr(ActiveSamples, "_serves", lambda self, *args: False)
    every = landed(self_contact=True, frames=6)
    for name in ("u", "v", "sample_depth", "sample_spring"):
        np.testing.assert_array_equal(some.state.get(name), every.state.get(name), err_msg=name)
    assert some.state.get("sample_depth").max() > 0.0, "it came to the floor"


def test_a_sample_is_left_alone_as_long_as_it_may_fall():
    solver = landed()
    contact, numbers = solver.body.contact, solver.state.get("numbers")
    assert contact is not None
    assert numbers[FALL] > 0.0
    left = numbers[SLACK : SLACK + 2 * len(contact.samples.X) : 2]
    touches = solver.state.get("sample_depth") > 0.0
    assert (left > 0.0).any(), "some were high enough"
    assert (left[touches] <= 0.0).all(), "what touches is a spacing under what it has to spare"
