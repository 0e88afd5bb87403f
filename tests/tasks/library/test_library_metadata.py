"""What catalogs say of models. The files are small ones made to the public descriptions of the formats, not parts of the catalogs."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InputError
from tasks.library.catalog import Catalog
from tasks.library.licenses import license_of
from tasks.library.metadata import ModelFacts, abo_facts, objaverse_facts, plain_facts

ANNOTATION = {
    "uri": "https://api.sketchfab.com/v3/models/aa11", "uid": "aa11", "name": "Old wooden Stuhl", "viewerUrl": "https://sketchfab.com/3d-models/aa11",
    "tags": [{"slug": "wood", "name": "wood"}, {"slug": "chair", "name": "chair"}], "categories": [{"uri": "", "name": "furniture-home"}],
    "license": "by-nc-sa", "user": {"uid": "u", "username": "maker1", "displayName": "A. Maker", "profileUrl": "https://sketchfab.com/maker1"},
    "isDownloadable": True, "vertexCount": 1000, "faceCount": 1900,
}  # fmt: skip


@pytest.mark.parametrize("pack", [lambda data: data, gzip.compress])
def test_objaverse_annotations(pack: Callable[[bytes], bytes]) -> None:
    annotations = {"aa11": ANNOTATION, "bb22": ANNOTATION | {"uid": "bb22", "license": "cc0", "tags": [], "name": "thing", "user": None}}
    lvis = {"coffee_table": ["bb22"], "armchair": ["zz"]}
    facts = objaverse_facts(pack(json.dumps(annotations).encode()), pack(json.dumps(lvis).encode()))
    assert set(facts) == {"aa11", "bb22"}
    one, other = facts["aa11"], facts["bb22"]
    assert (one.category, one.category_source, one.name, one.author) == ("chair", "tags", "Old wooden Stuhl", "A. Maker")
    assert one.license == ("CC-BY-NC-SA-4.0", True)
    assert one.source_url == "https://sketchfab.com/3d-models/aa11"
    assert (other.category, other.category_source, other.author, other.license) == ("coffee table", "lvis", "", ("CC0-1.0", False))
    assert objaverse_facts(json.dumps(list(annotations.values())).encode())["aa11"] == one


LISTING = {
    "item_id": "B07ABC", "3dmodel_id": "B07ABC", "product_type": [{"value": "COFFEE_TABLE"}],
    "brand": [{"language_tag": "en_US", "value": "Rivet"}],
    "item_name": [{"language_tag": "de_DE", "value": "Couchtisch"}, {"language_tag": "en_US", "value": "Round Coffee Table, Oak"}],
    "item_dimensions": {
        "height": {"normalized_value": {"unit": "inches", "value": 20.0}, "unit": "inches", "value": 20.0},
        "length": {"normalized_value": {"unit": "inches", "value": 40.0}}, "width": {"unit": "centimeters", "value": 50.8},
    },
}  # fmt: skip
TABLE = (
    "3dmodel_id,path,meshes,materials,textures,images,image_height_max,image_height_min,image_width_max,image_width_min,vertices,faces,"
    "extent_x,extent_y,extent_z\nB07ABC,C/B07ABC.glb,1,1,1,1,8,8,8,8,10,10,1.0,0.5,0.5\nB08XYZ,Z/B08XYZ.glb,1,1,1,1,8,8,8,8,10,10,0.4,0.9,0.4\n"
)


@pytest.mark.parametrize("pack", [lambda data: data, gzip.compress])
def test_abo_listings_and_models(pack: Callable[[bytes], bytes]) -> None:
    other = {"item_id": "B0", "product_type": [{"value": "SHOES"}]}
    lines = "\n".join(json.dumps(row) for row in (LISTING, other)).encode()
    facts = abo_facts([pack(lines)], pack(TABLE.encode()), "CC BY-NC 4.0")
    assert set(facts) == {"B07ABC", "B08XYZ"}
    table = Catalog(facts).of("C/B07ABC.glb")
    assert (table.category, table.category_source, table.name, table.author) == (
        "coffee table",
        "product_type",
        "Round Coffee Table, Oak",
        "Rivet",
    )
    assert table.extents_m == pytest.approx((1.016, 0.508, 0.508))
    assert table.license == ("CC-BY-NC-4.0", True)
    assert table.source_url.endswith("B07ABC")
    assert facts["B08XYZ"].extents_m == (0.4, 0.9, 0.4)
    assert facts["B08XYZ"].category == ""


def test_the_index_of_a_folder() -> None:
    rows = [
        {"file": "a/chair.glb", "category": "Chair", "licence": "MIT-0 text (c) 2019 Amazon", "author": "A\n Maker", "repo": "r",
         "source": "s", "up": "Z", "front": "+Y", "unit_m": 0.01, "extents_m": [1, 2, 3]},
        {"file": "b.obj", "unit_m": -1, "extents_m": [1, "x", 3], "up": "sideways", "license": "by"},
        {"category": "chair"}, 7,
    ]  # fmt: skip
    facts = plain_facts(json.dumps(rows).encode())
    assert facts["a/chair.glb"] == ModelFacts("", "Chair", "index", license_of("MIT-0"), "A Maker", "r s", (1.0, 2.0, 3.0), 0.01, "z", "+y")
    assert facts["b.obj"] == ModelFacts(license=license_of("CC-BY-4.0"))
    assert Catalog(facts).of("c.glb") == ModelFacts()


@pytest.mark.parametrize(
    ("text", "name", "is_noncommercial"),
    [
        ("by", "CC-BY-4.0", False), ("by-sa", "CC-BY-SA-4.0", False), ("by-nd", "CC-BY-ND-4.0", False), ("by-nc", "CC-BY-NC-4.0", True),
        ("by-nc-sa", "CC-BY-NC-SA-4.0", True), ("by-nc-nd", "CC-BY-NC-ND-4.0", True), ("cc0", "CC0-1.0", False),
        ("CC-BY-4.0", "CC-BY-4.0", False), ("CC BY-NC 3.0", "CC-BY-NC-3.0", True), ("Apache-2.0", "Apache-2.0", False),
        ("https://creativecommons.org/licenses/by-nc-sa/4.0/", "CC-BY-NC-SA-4.0", True),
        ("http://creativecommons.org/publicdomain/zero/1.0/", "CC0-1.0", False), ("mit", "MIT", False),
        ("Creative Commons Attribution-NonCommercial 4.0 International", "CC-BY-NC-4.0", True),
        ("Sketchfab Standard", "Sketchfab Standard", False), ("free for non-commercial use", "free for non-commercial use", True),
        ("", "unknown", False), ("MIT-0 text (c) 2019 Amazon", "MIT-0", False),
    ],
)  # fmt: skip
def test_licenses_by_their_identifiers(text: str, name: str, is_noncommercial: bool) -> None:
    assert license_of(text) == (name, is_noncommercial)
    assert license_of(license_of(text).name) == (name, is_noncommercial)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 5) | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from([*ANNOTATION, *LISTING, "file", "value", "name", "aa11", "unit", "height"]), inner, max_size=5)
    ),
    max_leaves=8,
)
READERS: list[Callable[[bytes], Any]] = [
    objaverse_facts, plain_facts, lambda data: objaverse_facts(json.dumps([ANNOTATION]).encode(), data),
    lambda data: abo_facts([data], TABLE.encode(), "by"), lambda data: abo_facts([], data, "by"),
]  # fmt: skip


@given(JSON | st.lists(JSON, max_size=3), st.sampled_from(range(len(READERS))))
def test_whatever_a_catalog_holds_is_read_or_refused(value: Any, reader: int) -> None:
    refused = ""
    facts = {}
    try:
        facts = READERS[reader](json.dumps(value).encode())
    except InputError as error:
        refused = str(error)
    assert refused.isprintable()
    assert all(isinstance(one, ModelFacts) and one.name.isprintable() for one in facts.values())


@given(st.binary(max_size=60), st.booleans())
def test_what_is_no_catalog_is_refused(data: bytes, is_packed: bool) -> None:
    for read in READERS:
        refused = ""
        try:
            read(b"\x1f\x8b" + data if is_packed else data)
        except InputError as error:
            refused = str(error)
        assert len(refused) < 600
