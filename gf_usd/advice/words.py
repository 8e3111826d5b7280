"""Words in names, and the presets that they stand for: plain data, American and British.

A phrase is words that follow each other.  Longer phrases are found first and use their words up,
so that a silicone rubber is a silicone.  A word counts as it is written here: nothing is stemmed,
so that plurals stand here too.
"""

from __future__ import annotations

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
        " styrofoam; upholstery"
    ),
}

OBJECTS: dict[str, str] = {
    "rubber": "ball; balls; rubber duck; rubber ducky; balloon; eraser; squeaky",
    "metal": (
        "anvil; bolt; bolts; screw; screws; wrench; spanner; gear; gears; chain;"
        " pipe; girder; rim; rims; hubcap; cutlery; spoon; fork; knife; blade; coin; coins"
    ),
    "jelly": "jellyfish; pudding; custard; panna cotta; flan; blob; gumdrop; gummybear; gummy bear",
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
    "soft-silicone": "flesh; fat; muscle; muscles; tissue; tongue; meat; dough; putty",
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
