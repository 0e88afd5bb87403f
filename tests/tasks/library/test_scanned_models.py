"""Scanned models are found again in an index."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bench.models.retrieval import ScannedQuery, lacking, query_of, timed, write_library
from bench.models.rooms import MODELS_PER_ROOM, asked, query_rooms
from bench.realdata import MODELS
from bench.shelves import models_in
from tasks.library.catalog import catalog_of
from tasks.library.indexing import IndexConfig, index_folder
from tasks.library.search import LibrarySearch


@pytest.mark.slow
@pytest.mark.whole
def test_models_of_a_scanned_room_are_found(realdata: Callable[[str], Path], tmp_path: Path) -> None:
    place = realdata(str(MODELS))
    assert lacking(place.parent) is None
    write_library(place, tmp_path, 40, seed=0)
    index = index_folder(tmp_path, catalog_of(tmp_path), IndexConfig(), {})
    real = models_in(place)
    assert {entry.file for entry in index.entries if not entry.file.startswith("drawn_")} == {entry.file for entry in real}
    rooms = query_rooms(real, 0)
    assert sorted(entry.file for room in rooms for entry in room) == [entry.file for entry in real]
    assert max(map(len, rooms)) == MODELS_PER_ROOM
    queries = [ScannedQuery(entry.file, request.category, entry.category, request) for entry, request in asked(rooms[0], 0, 0)]
    assert len(queries) >= 7
    search = LibrarySearch.of(index.entries)
    found = [search.find(query_of("", query), 1)[0].file == query.file for query in queries]
    assert sum(found) >= round(0.7 * len(queries))
    assert len(timed(index, queries[:2], entries=200)) == 2


def test_distractors_are_the_same_for_the_same_seed(realdata: Callable[[str], Path], tmp_path: Path) -> None:
    place = realdata(str(MODELS))
    small = tmp_path / "models"
    small.mkdir()
    (small / "aws_Ball_01.glb").write_bytes((place / "aws_Ball_01.glb").read_bytes())
    (small / "index.json").write_text('[{"file": "aws_Ball_01.glb", "category": "exercise ball"}]')
    made = []
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        write_library(small, folder, 4, seed=3)
        made.append({path.name: path.read_bytes() for path in folder.iterdir()})
    assert made[0] == made[1]
    assert len(made[0]) == 6
    sizes = [model.extents for model in models_in(tmp_path / "a") if model.file.startswith("drawn_")]
    assert np.allclose(np.array(sizes[1]) / 0.63, 1, atol=0.8)
