"""Instances that hide opinions cannot be freed."""

from __future__ import annotations

import pytest

CHAIRS = """
class Xform "Chair"
{{
    def Cube "Seat" {{}}
    def "Leg" (
        instanceable = true
        references = </Post>
    )
    {{
    }}
}}
class Xform "Post"
{{
    def Cube "Box" {{}}
}}
def Xform "World"
{{
    def "A" (
        instanceable = true
        references = </Chair>
    )
    {{
        double3 xformOp:translate = (5, 0, 0)
        uniform token[] xformOpOrder = ["xformOp:translate"]
        {below}
    }}
    def "B" (
        instanceable = true
        references = </Chair>
    )
    {{
    }}
}}
"""
MOVED = """double3 xformOp:translate = (0, 9, 0)
            uniform token[] xformOpOrder = ["xformOp:translate"]"""
EVERY = ["/World/A/Seat", "/World/A/Leg/Box", "/World/B/Seat", "/World/B/Leg/Box"]


def over(body: str) -> str:
    return f'over "Seat"\n{{\n{body}\n}}'


@pytest.mark.parametrize("below", ["", over("")])
def test_instances_that_hide_nothing_are_baked(read, below):
    asset = read(CHAIRS.format(below=below))
    assert [s.path for s in asset.surfaces] == EVERY
    assert asset.skipped == ()


@pytest.mark.parametrize(
    ("below", "where"),
    [
        (over(MOVED), "Seat"),
        (over('token visibility = "invisible"'), "Seat"),
        ('over "Seat" (\nactive = false\n)\n{\n}', "Seat"),
        ('over "Leg"\n{\nover "Box"\n{\ndouble size = 3\n}\n}', "Leg/Box"),
        ('def Cube "More"\n{\n}', "More"),
    ],
)
def test_an_instance_that_hides_opinions_is_left_alone(read, below, where):
    asset = read(CHAIRS.format(below=below))
    assert [s.path for s in asset.surfaces] == EVERY[2:]
    reason = (
        f"the instance </World/A> hides opinions on </World/A/{where}>, which would take effect if"
        " it were made an ordinary prim: delete them, or turn off instancing in the file"
    )
    assert dict(asset.skipped) == dict.fromkeys(EVERY[:2], reason)


def test_what_is_not_baked_hides_what_it_likes(read):
    asset = read(CHAIRS.format(below=over(MOVED)), prims=("/World/B",))
    assert [s.path for s in asset.surfaces] == EVERY[2:]
