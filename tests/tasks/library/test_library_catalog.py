"""Catalogs: which kind a file is of, what comes first, and what a folder says of all its models."""

from __future__ import annotations

import gzip
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from schemas.errors import InputError
from tasks.library.catalog import catalog_of
from tests.tasks.library.test_library_metadata import ANNOTATION, LISTING, TABLE

Pack = Callable[[bytes], bytes]


def write(folder: Path, name: str, data: object, pack: Pack = bytes) -> Path:
    text = data if isinstance(data, str) else json.dumps(data)
    (folder / name).write_bytes(pack(text.encode()))
    return folder / name


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "models").mkdir()
    return tmp_path / "models"


@pytest.mark.parametrize("pack", [bytes, gzip.compress], ids=["plain", "packed"])
@pytest.mark.parametrize("as_list", [False, True])
def test_objaverse_is_known_by_its_uids(tmp_path: Path, folder: Path, pack: Pack, as_list: bool) -> None:
    rows = {"aa11": ANNOTATION, "bb22": ANNOTATION | {"uid": "bb22"}}
    lvis = write(tmp_path, "lvis.json", {"stool": ["aa11"], "zebra": []}, pack)
    annotations = write(tmp_path, "000-001.json.gz", list(rows.values()) if as_list else rows, pack)
    for order in ([lvis, annotations], [annotations, lvis]):
        catalog = catalog_of(folder, order)
        assert (catalog.of("glbs/000-000/aa11.glb").category, catalog.of("bb22.glb").category) == ("stool", "chair")
    with pytest.raises(InputError, match="no annotations say more"):
        catalog_of(folder, [lvis])


@pytest.mark.parametrize("pack", [bytes, gzip.compress], ids=["plain", "packed"])
def test_abo_is_known_by_its_listings_and_has_the_license_of_its_folder(tmp_path: Path, folder: Path, pack: Pack) -> None:
    write(folder, "LICENSE", "CC BY-NC 4.0")
    table = write(tmp_path, "3dmodels.csv", TABLE, pack)
    listings = write(tmp_path, "listings_0.json", "\n".join(json.dumps(row) for row in (LISTING, {"item_id": "B0"})), pack)
    facts = catalog_of(folder, [listings, table]).of("C/B07ABC.glb")
    assert (facts.category, facts.license.name, facts.license.is_noncommercial) == ("coffee table", "CC-BY-NC-4.0", True)
    with pytest.raises(InputError, match="come without"):
        catalog_of(folder, [listings])


def test_what_is_named_comes_before_the_folders_own(tmp_path: Path, folder: Path) -> None:
    write(folder, "index.json", [{"file": "a.glb", "category": "chair", "license": "MIT"}, {"file": "b.glb", "category": "bed"}])
    write(folder, "LICENSE.md", "\n  CC0 \n")
    catalog = catalog_of(folder, [write(tmp_path, "mine.json", [{"file": "a.glb", "category": "stool"}])])
    assert [(catalog.of(name).category, catalog.of(name).license.name) for name in ("a.glb", "b.glb", "c.glb")] == [
        ("stool", "CC0-1.0"),
        ("bed", "CC0-1.0"),
        ("", "CC0-1.0"),
    ]


@pytest.mark.parametrize("data", ["{", "3", "{}", '{"a": 1}', "\x1f\x8bnothing", ""])
def test_what_is_no_catalog_is_refused(tmp_path: Path, folder: Path, data: str) -> None:
    with pytest.raises(InputError, match=r"^odd.json: content: "):
        catalog_of(folder, [write(tmp_path, "odd.json", data)])
