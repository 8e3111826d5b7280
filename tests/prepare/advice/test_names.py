"""Materials by names: how names are split, which phrase decides, and with what confidence."""

from __future__ import annotations

import pytest

from gf_usd.core.materials.presets import presets
from gf_usd.core.stage import Advice, Subject
from gf_usd.prepare.advice import LEAST, with_fallback
from gf_usd.prepare.advice.names import (
    OBJECTS,
    PHRASES,
    STAND_INS,
    SUBSTANCES,
    by_names,
    phrases_in,
    split,
)
from gf_usd.prepare.fill.notes import advice_notes


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        ("rubber_duck", ("rubber", "duck")),
        ("RubberDuck", ("rubber", "duck")),
        ("rubberDuck01", ("rubber", "duck")),
        ("M_Steel-02a", ("m", "steel", "a")),
        ("PDMSBlock", ("pdms", "block")),
        ("seat cushion", ("seat", "cushion")),
        ("42", ()),
        ("Größe_gummi", ("größe", "gummi")),
    ],
)
def test_names_are_split_at_signs_digits_and_capitals(name, parts):
    assert split(name) == parts


@pytest.mark.parametrize(
    ("name", "material"),
    [
        ("rubber", "rubber"), ("SteelBeam", "metal"), ("jello_cube", "jelly"),
        ("gelatineBlock", "gelatin"), ("SoftSilicone_01", "soft-silicone"),
        ("silicone_rubber", "silicone"), ("wetsuit", "neoprene"), ("latexGlove", "natural-rubber"),
        ("tyre_FL", "hard-rubber"), ("foamRubber", "foam"), ("hardRubberWheel", "hard-rubber"),
        ("BowlingBall", "hard-rubber"), ("oak_wood", "metal"),
    ],
)  # fmt: skip
def test_words_name_presets(name, material):
    assert by_names(Subject(path=f"/{name}")).material == material


@pytest.mark.parametrize("name", ["Armor", "Metallica", "foamy", "irony", "Mesh_0", "steelworks"])
def test_part_of_a_word_is_no_word(name):
    advice = by_names(Subject(path=f"/{name}"))
    assert (advice.material, advice.confidence) == ("rubber", 0.0)
    assert "no name or label is known; rubber is assumed" in advice.reason


def test_every_list_names_a_preset_and_no_phrase_stands_in_two():
    every = [
        (tuple(phrase.split()), preset)
        for lists in (SUBSTANCES, OBJECTS, STAND_INS)
        for preset, text in lists.items()
        for phrase in text.split(";")
    ]
    # A name that says steel gets the look `metal`: the real ones cost minutes: not the default.
    by_hand = {"dented", "polyurethane-foam", "aluminium", "mild-steel", "copper", "lead"}
    by_hand |= {"modelling-clay", "wet-clay"}
    # What flows without limit has no mesh: no name of a prim implies that.
    by_hand |= {"dry-sand", "wet-sand", "gravel", "powder-snow", "wet-snow", "water"}
    by_hand |= {"toothpaste", "mud", "cream", "honey"}
    assert {preset for _, preset in every} == set(presets()) - by_hand
    assert len({phrase for phrase, _ in every}) == len(every) == len(PHRASES)
    assert all(split(" ".join(phrase)) == phrase for phrase, _ in every)


SOURCES = {
    "labels": ({"labels": ("steel",)}, "/a/b", "", 0.9),
    "material": ({"looks": ("/Looks/Steel",)}, "/a/b", "", 0.8),
    "name": ({}, "/a/steel", "", 0.7),
    "labels above": ({"labels_above": ("steel",)}, "/a/b", "", 0.6),
    "above": ({}, "/steel/b", "", 0.5),
    "file": ({}, "/a/b", "steel", 0.4),
}


@pytest.mark.parametrize("source", SOURCES)
def test_confidence_is_that_of_the_source(source):
    more, path, file, confidence = SOURCES[source]
    advice = by_names(Subject(path=path, **more), file)
    assert (advice.material, advice.confidence) == ("metal", confidence)
    assert "'steel'" in advice.reason


@pytest.mark.parametrize(
    ("more", "path", "material"),
    [
        ({"labels": ("foam",), "looks": ("/L/steel",)}, "/jelly", "foam"),
        ({"looks": ("/L/steel",), "labels_above": ("foam",)}, "/jelly", "metal"),
        ({"labels_above": ("foam",)}, "/steel/jelly", "jelly"),
        ({"labels_above": ("foam",)}, "/steel/b", "foam"),
        ({"labels": ("vehicle", "foam")}, "/steel", "foam"),
        ({"looks": ("/L/blinn1", "/L/foam")}, "/steel", "foam"),
        ({}, "/steel/foam/b", "foam"),
    ],
)
def test_the_best_source_that_knows_a_word_decides(more, path, material):
    assert by_names(Subject(path=path, **more), "silicone").material == material


def test_things_and_stand_ins_count_for_less():
    assert by_names(Subject(path="/tire")).confidence == pytest.approx(0.7 * 0.8)
    wood = by_names(Subject(path="/wood"))
    assert wood.confidence == pytest.approx(0.7 * 0.5)
    assert "to which metal is the nearest preset" in wood.reason


def test_a_name_that_contradicts_itself_counts_half_and_its_last_word_decides():
    advice = by_names(Subject(path="/jelly_on_steel"))
    assert (advice.material, advice.confidence) == ("metal", 0.35)
    assert "also what would be jelly" in advice.reason


def test_what_is_unsure_becomes_rubber_and_says_so():
    advice = by_names(Subject(path="/wood/part"))  # 0.5 of a prim above, 0.5 of a stand-in
    assert (advice.material, advice.confidence) == ("rubber", 0.0)
    assert f"metal is too uncertain, 0.25 < {LEAST}" in advice.reason
    assert "rubber is assumed" in advice.reason
    sure = Advice(path="/a", material="foam", confidence=LEAST, reason="x")
    assert with_fallback(sure) is sure


def test_longer_phrases_use_their_words_up():
    assert [p[:2] for p in phrases_in("hard_rubber_rubber_foam")] == [
        ("hard rubber", "hard-rubber"),
        ("rubber foam", "foam"),
    ]


def test_meshes_without_a_known_name_share_a_note():
    """A spider of 13 meshes had 13 notes that said only that nothing was known."""
    advice = [by_names(Subject(path=f"/Spider/Bein{k}")) for k in range(9)]
    advice.insert(4, by_names(Subject(path="/Spider/SteelFang")))
    assert advice_notes(advice) == (
        "</Spider/Bein0> and 8 more are rubber (0.00): no name or label is known; rubber is"
        " assumed",
        "</Spider/SteelFang> is metal (0.70): its name 'SteelFang' says 'steel'",
    )
    assert len(advice_notes(advice[:3])) == 3, "few are listed one by one"
