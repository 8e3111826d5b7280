"""What is said of poorly filled parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gf_usd.geometry.thin.advice import poor_note, specks_note
from gf_usd.geometry.thin.parts import Part
from gf_usd.prepare.prepare import _without_excessive

ROD = Part(
    path="/Body", shell=1, kind="thin", low=np.zeros(3), high=np.array([0.3, 0.4, 0.0]),
    area=0.1, particles=9, wall=0.01, suggested=9000, rays=(np.zeros((0, 3)), np.zeros((0, 3))),
    within=np.zeros(0), thickness=0.02,
)  # fmt: skip
PLATE = replace(ROD, kind="bare region", suggested=None)
SPECK = replace(ROD, shell=2, kind="empty", speck=True, suggested=900_000)


def test_nothing_is_said_of_nothing():
    assert poor_note((), 8000) == specks_note(()) == ""


def test_one_part_is_named_with_the_number_that_fills_it():
    assert poor_note((ROD,), 4500) == (
        "1 part contains few particles or none, and may be too stiff; --particles 9000 would fill"
        " it and take up to 2.5 times as long (shell 1 of </Body>, 50 cm large and 2 cm thick;"
        " gf-usd inspect shows where)"
    )


def test_the_largest_of_several_is_named():
    assert poor_note((PLATE, ROD), 4500) == (
        "2 parts contain few particles or none, and may be too stiff; --particles 9000 would fill"
        " all but the thinnest and take up to 2.5 times as long (the largest: a region of </Body>,"
        " 50 cm large and 2 cm thick; gf-usd inspect shows where)"
    )


def test_no_number_is_given_where_none_is_sensible():
    assert "--particles" not in poor_note((PLATE,), 4500)


def test_a_number_that_takes_no_longer_has_no_cost():
    assert "--particles 9000 would fill it (shell" in poor_note((ROD,), 8900)


def test_a_number_that_a_bake_has_is_not_suggested():
    assert "--particles" not in poor_note((ROD,), 9000)


def test_specks_are_no_parts_that_are_too_stiff():
    assert poor_note((SPECK,), 4500) == ""
    assert specks_note((ROD, SPECK)).startswith("1 speck, 50 cm large, is apart from the rest")
    assert poor_note((ROD, SPECK), 4500) == poor_note((ROD,), 4500)


def test_far_more_particles_than_a_bake_has_are_not_suggested():
    """For the eyes of a character 20,000 were where 4,000 did."""
    eyes = replace(ROD, suggested=20_001)
    assert [p.suggested for p in _without_excessive((ROD, eyes), 20_000)] == [9000, None]
    assert "--particles" not in poor_note(_without_excessive((eyes,), 20_000), 4000)
