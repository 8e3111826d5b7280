"""A preset by names alone: the rule of ``--material auto``.

Names are tried in the order of SOURCES, and the first that holds a known phrase decides.  Its
confidence is that of the source times the weight of the phrase (`PHRASES`), halved where other
phrases of the same name have other presets; the last phrase of a name decides, because names end in
the kind of the thing.

Words in names, and the presets that they stand for: plain data, American and British.

A phrase is words that follow each other.  Longer phrases are found first and use their words up,
so that a silicone rubber is a silicone.  A word counts as it is written here: nothing is stemmed,
so that plurals are listed too.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

from gf_usd.core.stage import Advice, Subject
from gf_usd.prepare.advice import FALLBACK, with_fallback

# confidence of each source
LABEL, LOOK, NAME, LABEL_ABOVE, ABOVE, FILE = 0.9, 0.8, 0.7, 0.6, 0.5, 0.4

SEPARATOR = re.compile(r"[\W\d_]+")
CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Z])(?=[A-Z][a-z])")


def split(name: str) -> tuple[str, ...]:
    """The words of a name, in lower case: parts at signs, digits, and changes to capitals."""
    parts = (part for run in SEPARATOR.split(name) for part in CAMEL.split(run))
    return tuple(part.lower() for part in parts if part)


def phrases_in(name: str) -> list[tuple[str, str, float]]:
    """(phrase, preset, weight) of all known phrases of a name, in their order."""
    words, found, at = split(name), [], 0
    while at < len(words):
        for length in range(min(LONGEST, len(words) - at), 0, -1):
            known = PHRASES.get(words[at : at + length])
            if known is not None:
                found.append((" ".join(words[at : at + length]), *known))
                at += length
                break
        else:
            at += 1
    return found


def by_names(subject: Subject, file: str = "") -> Advice:
    """The preset of a subject from its names; rubber with confidence 0 where no name is known.

    file : name of the asset's file without its suffix.
    """
    for source, name, confidence in sources(subject, file):
        found = phrases_in(name)
        if not found:
            continue
        phrase, preset, weight = found[-1]
        reason = f"{source} {name!r} says {phrase!r}"
        if weight == STAND_IN:
            reason += f", to which {preset} is the nearest preset"
        others = sorted({other for _, other, _ in found} - {preset})
        if others:
            confidence /= 2.0
            reason += f", and also what would be {' or '.join(others)}"
        return with_fallback(
            Advice(
                path=subject.path, material=preset,
                confidence=round(confidence * weight, 4), reason=reason,
            )
        )  # fmt: skip
    return Advice(
        path=subject.path, material=FALLBACK, confidence=0.0,
        reason=f"no name or label is known; {FALLBACK} is assumed",
    )  # fmt: skip


def sources(subject: Subject, file: str) -> Iterator[tuple[str, str, float]]:
    """(kind, name, confidence) of the names of a subject, best first."""
    *above, own = subject.path.strip("/").split("/")
    for label in subject.labels:
        yield "its label", label, LABEL
    for material in subject.looks:
        yield "its material", material.rsplit("/", 1)[-1], LOOK
    yield "its name", own, NAME
    for label in subject.labels_above:
        yield "a label above it,", label, LABEL_ABOVE
    for name in reversed(above):
        yield "a prim above it,", name, ABOVE
    if file:
        yield "the file's name", file, FILE


SUBSTANCE = 1.0  # the word names what it is made of
OBJECT = 0.8  # the word names a thing that is mostly made of it
STAND_IN = 0.5  # no preset is it; this one is nearest

SUBSTANCES: dict[str, str] = {
    "rubber": (
        "rubber; rubbery; rubberized; rubberised; elastomer; elastomeric; elastic; bouncy;"
        " vinyl; tpu; tpe"
    ),
    "metal": (
        "metal; metallic; metals; steel; iron; aluminum; aluminium; brass; bronze; copper; gold;"
        " silver; chrome; titanium; tin; zinc; nickel; alloy; cast iron"
    ),
    "jelly": "jelly; jello; slime; goo; gel; gummy; gooey",
    "gelatin": "gelatin; gelatine; agar; aspic; ballistic gel",
    "soft-silicone": "soft silicone; ecoflex; silicone gel; soft rubber; gel silicone",
    "silicone": "silicone; silicon rubber; silicone rubber; pdms; sylgard",
    "neoprene": "neoprene; chloroprene; polychloroprene",
    "natural-rubber": "natural rubber; latex; caoutchouc; gum rubber",
    "hard-rubber": "hard rubber; ebonite; vulcanite; vulcanized rubber; vulcanised rubber",
    "foam": (
        "foam; foams; sponge; spongy; polyurethane; memory foam; foam rubber; rubber foam;"
        " upholstery"
    ),
    "clay": "clay; plasticine; play dough; playdough; modelling clay; modeling clay; putty",
    "styrofoam": "styrofoam; polystyrene; expanded polystyrene; crash foam; floral foam",
    "dough": "dough; pastry; batter",
    "wax": "wax; paraffin; beeswax; tallow",
}

OBJECTS: dict[str, str] = {
    "rubber": "ball; balls; rubber duck; rubber ducky; balloon; eraser; squeaky",
    "metal": (
        "anvil; bolt; bolts; screw; screws; wrench; spanner; gear; gears; chain;"
        " pipe; girder; rim; rims; hubcap; cutlery; spoon; fork; knife; blade; coin; coins"
    ),
    "jelly": "jellyfish; pudding; custard; panna cotta; flan; blob; gumdrop; gummybear; gummy bear",
    "wax": "candle; candles; crayon; crayons",
    "silicone": "spatula; gasket; gaskets; oven mitt",
    "neoprene": "wetsuit; mousepad; mouse pad",
    "natural-rubber": "glove; gloves; rubber band; rubber bands",
    "hard-rubber": (
        "tire; tires; tyre; tyres; tread; treads; puck; bumper; bumpers; caster; casters; castor;"
        " castors; bowling ball"
    ),
    "foam": (
        "pillow; pillows; cushion; cushions; mattress; sofa; couch; padding; plush; plushie;"
        " teddy; teddy bear; marshmallow; bread; cake"
    ),
}

STAND_INS: dict[str, str] = {
    "metal": (
        "wood; wooden; stone; rock; rocks; marble; granite; concrete; brick; glass; ceramic;"
        " ceramics; porcelain; clay pot; plastic; plastics; bone; bones; crystal"
    ),
    "soft-silicone": "flesh; fat; muscle; muscles; tissue; tongue; meat",
    "foam": "cloth; fabric; cotton; wool; felt; leather; textile; fur",
}


def _phrases() -> dict[tuple[str, ...], tuple[str, float]]:
    found: dict[tuple[str, ...], tuple[str, float]] = {}
    for lists, weight in ((SUBSTANCES, SUBSTANCE), (OBJECTS, OBJECT), (STAND_INS, STAND_IN)):
        for preset, text in lists.items():
            for phrase in text.split(";"):
                found[tuple(phrase.split())] = preset, weight
    return found


# words -> (preset, weight)
PHRASES: dict[tuple[str, ...], tuple[str, float]] = _phrases()
LONGEST = max(len(phrase) for phrase in PHRASES)
