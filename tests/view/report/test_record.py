"""What a page shows of a bake: its numbers, as text, and what is missing."""

from __future__ import annotations

import json
import math
from dataclasses import asdict, fields

import pytest
from recordings import FallingBox, report_of

from gf_usd.core.frames.frame import Health
from gf_usd.core.frames.settings import Field, Settings
from gf_usd.core.materials.material import Material
from gf_usd.pipeline.health.log import HealthLog
from gf_usd.pipeline.health.warnings import RULES
from gf_usd.view.report.labels import (
    MARKS,
    MATERIAL,
    ROWS,
    SETTINGS,
    health_rows,
    named_rows,
    number,
    quantity,
)
from gf_usd.view.report.record import load_report, make_record, report_path

SETTINGS_OF_A_BAKE = Settings(
    frames=2, fps=24.0, time_codes_per_second=24.0, start=1.0, gravity=(0, -9.81, 0), up=(0, 1, 0)
)
ABOUT = {
    "command": "gf-usd bake box.usda",
    "version": "1.2.3",
    "inputHash": "abc",
    "looks": {
        "rubber": {
            "health": {"min_J": 0.4, "rollbacks": 2},
            "materials": {"0": {"name": "rubber", "density": 1000.0}},
            "settings": {"frames": 7, "fps": 24.0},
        }
    },
}


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.0008708, "m", "871\u00a0µm"),
        (0.0, "m", "0\u00a0m"),
        ([0.0, 0.0, 0.07], "m", "0, 0, 0.07 m"),
        (2.641e-5, "m³", "26.4\u00a0cm³"),
        (0.0022, "J", "0.0022 J"),
        (None, "m", "not set"),
        (3, "", "3"),
    ],
)
def test_lengths_and_volumes_have_the_unit_that_suits_them(
    value: object, unit: str, text: str
) -> None:
    assert quantity(value, unit) == text


def test_the_report_next_to_the_root_layer_is_read(tmp_path):
    root = tmp_path / "box.rubber.usda"
    assert report_path(root).name == "box.rubber.report.json"
    assert load_report(root) == ({}, "there is no box.rubber.report.json next to the file")
    report_path(root).write_text("{", encoding="utf-8")
    assert "cannot be read" in load_report(root)[1]
    report_path(root).write_text("[1]", encoding="utf-8")
    assert "is not the report of a bake" in load_report(root)[1]
    report_path(root).write_text(json.dumps(report_of()), encoding="utf-8")
    assert load_report(root) == (report_of(), "")


def test_a_report_of_this_bake_is_taken_whole():
    record = make_record(FallingBox(about=ABOUT).recording(), report_of(), "")
    assert record.missing == ()
    assert record.health["min_J"] == 0.5
    assert len(record.frames) == 7
    assert record.materials[0]["law"] == "corotated"
    assert record.facts == {"particles": 40}
    assert record.notes == ("a note of the bake",)


@pytest.mark.parametrize(
    ("report", "why", "message"),
    [
        ({}, "there is no x.json next to the file", "there is no x.json next to the file"),
        (report_of(input_sha256="other"), "", "belongs to another bake"),
        (report_of(look="jelly"), "", "does not contain this variant"),
    ],
)
def test_without_it_the_root_layer_speaks_and_says_so(report, why, message):
    record = make_record(FallingBox(about=ABOUT).recording(), report, why)
    assert message in record.missing[0]
    assert "energies" in record.missing[0]
    assert record.health == {"min_J": 0.4, "rollbacks": 2}
    assert record.materials[0]["density"] == 1000.0
    assert record.frames == ()


def test_a_file_that_says_nothing_is_said_so():
    record = make_record(FallingBox(variant="").recording(), {}, "no report")
    assert record.health == {}
    assert "does not record how it was baked" in record.missing[0]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (None, "not set"),
        (True, "yes"),
        (12345, "12\u202f345"),
        (26720.37, "26\u202f720"),
        (0.00012873, "0.0001287"),
        (2.0, "2"),
        ("inf", "inf"),
        (math.inf, "inf"),
        ([0.0, -9.81, 0.0], "0, -9.81, 0"),
    ],
)
def test_numbers_read_well(value, text):
    assert number(value) == text


def test_units_stand_with_values_and_unknown_keys_are_kept():
    rows = named_rows({"new_thing": 3, "density": 1100.0, "friction": None}, MATERIAL)
    assert rows == [("Density", "1\u202f100 kg/m³"), ("Friction", "not set"), ("New thing", "3")]


@pytest.mark.parametrize(
    ("count", "text"), [(2, "</A0>, </A1>"), (300, "</A0>, </A1>, </A2>, </A3> and 296 more")]
)
def test_a_page_names_a_few_of_many_meshes(count: int, text: str) -> None:
    """Three hundred of them were in one cell."""
    (row,) = health_rows({"outside_meshes": [f"/A{k}" for k in range(count)]})
    assert row.value == text


def test_rows_of_warnings_are_marked():
    health = {"min_J": -0.02, "rollbacks": 0, "energy_gain_max_J": None, "new_key": 4}
    rows = health_rows(health, {"inside-out", "not a rule"})
    assert [(row.value, row.marked) for row in rows] == [
        ("0", False), ("-0.02", True), ("none", False), ("4", False),
    ]  # fmt: skip
    assert rows[3].label == "New key"
    # what a warning is about is never folded away
    assert all(row.first for row in rows if row.marked)


def test_every_rule_of_the_judgment_marks_rows_that_there_are():
    assert set(MARKS) == set(RULES)
    assert {key for keys in MARKS.values() for key in keys} <= {row.key for row in ROWS}


def test_every_key_of_a_summary_has_words():
    log = HealthLog(SETTINGS_OF_A_BAKE, spacing=0.1, drop=0.0, radius=1.0, particles=8)
    log.add(Health(mass=1.0))
    log.add(Health(mass=1.0, penetration=0.01))
    former = {"let_go_max", "overlap_names"}  # of released_max; of overlap_pair
    assert set(log.summary()) - former <= {row.key for row in ROWS}


def test_every_setting_has_words():
    assert {field.name for field in fields(Settings)} <= set(SETTINGS)
    assert {field.name for field in fields(Material)} - {"name", "parameters"} <= set(MATERIAL)


def test_warnings_of_this_variant_are_taken():
    warning = {"about": "inside-out", "message": "inside out", "hint": "lower it"}
    report = report_of(
        warnings=[
            {"variant": "jelly", **warning, "message": "other"},
            {"look": "rubber", **warning},  # the key of former versions
        ]
    )
    record = make_record(FallingBox(about=ABOUT).recording(), report, "")
    assert [(w.about, w.message, w.hint) for w in record.warnings] == [
        ("inside-out", "inside out", "lower it")
    ]
    looks = {"rubber": {**ABOUT["looks"]["rubber"], "warnings": ["bad"], "failure": "gave up"}}
    record = make_record(FallingBox(about={**ABOUT, "looks": looks}).recording(), {}, "gone")
    assert [w.message for w in record.warnings] == ["bad"]
    assert record.failure == "gave up"


@pytest.mark.parametrize(
    ("field", "label", "shown"),
    [
        (Field(kind="wind", vector=(3.0, 0.0, 0.5)), "wind", "3, 0, 0.5 m/s²"),
        (
            Field(kind="radial", strength=-20.0, center=(0.0, 0.3, 0.0), radius=0.5),
            "radial", "-20 m/s²; around 0, 0.3, 0 m; radius 0.5 m",
        ),
        (
            Field(kind="noise", strength=4.0, length=0.3, rate=1.5),
            "noise", "4 m/s²; length 0.3 m; rate 1.5 1/s",
        ),
        (
            Field(kind="gravity", times=(1.0, 25.0), values=((0, -9.81, 0), (0, 0, 0))),
            "gravity", "2 keys, time codes 1 to 25: 0, -9.81, 0; 0, 0, 0",
        ),
    ],
)  # fmt: skip
def test_a_field_is_a_row_in_words(field, label, shown):
    values = {"fields": [asdict(field), asdict(field)], "seed": 0}
    row = (f"Field: {label}", shown)
    assert named_rows(values, SETTINGS) == [row, row, ("Seed", "0")]


def test_without_fields_the_row_says_so():
    assert named_rows({"fields": []}, SETTINGS) == [("Fields besides gravity", "none")]
