"""Names and labels that a stage gives its prims."""

from __future__ import annotations

import pytest
from physics_stages import bound, mesh, prim

from gf_usd.core.errors import InputError
from gf_usd.readers import read_asset
from gf_usd.readers.usd_bake.settings import read_subjects


@pytest.fixture
def subjects(write):
    def subjects(body, *paths):
        path = write(body)
        return read_subjects(path, read_asset(path).facts, paths)

    return subjects


def label(taxonomy, *labels):
    listed = ", ".join(f'"{one}"' for one in labels)
    return f"token[] semantics:labels:{taxonomy} = [{listed}]"


def test_labels_of_the_prim_and_of_those_above_it(subjects):
    inner = mesh(
        "Part", label("kind", "seat", "cushion"), label("color", "red"),
        apis=["SemanticsLabelsAPI:kind", "SemanticsLabelsAPI:color"],
    )  # fmt: skip
    middle = prim("Xform", "Mid", label("kind", "sofa"), inner, apis=["SemanticsLabelsAPI:kind"])
    body = prim("Xform", "Top", label("kind", "room"), middle, apis=["SemanticsLabelsAPI:kind"])
    (one,) = subjects(body, "/Top/Mid/Part")
    assert set(one.labels) == {"seat", "cushion", "red"}
    assert one.labels_above == ("sofa", "room")


def test_labels_that_are_not_applied_are_none(subjects):
    (one,) = subjects(mesh("Part", label("kind", "foam")), "/Part")
    assert one.labels == ()


def test_bound_materials_of_shading_of_physics_and_from_above(subjects):
    looks = prim("Material", "Steel") + prim("Material", "Contact")
    part = mesh("Part", bound("/Contact"), apis=["MaterialBindingAPI"])
    body = looks + prim("Xform", "Top", bound("/Steel", ""), part, apis=["MaterialBindingAPI"])
    (one,) = subjects(body, "/Top/Part")
    assert one.looks == ("/Steel", "/Contact")


def test_the_material_of_most_faces_comes_first(subjects):
    subset = prim(
        "GeomSubset", "Rest", 'uniform token elementType = "face"',
        'uniform token familyName = "materialBind"', "int[] indices = [0, 1, 2, 3]",
        bound("/Tread", ""), apis=["MaterialBindingAPI"],
    )  # fmt: skip
    looks = prim("Material", "Rim") + prim("Material", "Tread")
    body = looks + mesh("Wheel", bound("/Rim", ""), subset, apis=["MaterialBindingAPI"])
    (one,) = subjects(body, "/Wheel")
    assert one.looks == ("/Tread", "/Rim")


def test_a_path_without_a_prim_is_refused(subjects):
    with pytest.raises(InputError):
        subjects(mesh("Part"), "/Nothing")
