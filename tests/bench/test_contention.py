"""Processes on one lake at once, as the benchmark of the warehouse lets them meet; and that its eyes would see a fault."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.warehouse.contention import CAPTIONS, SLOTS, contention, rows_per_scene, scene_id, seen_wrong, stage_scene
from warehouse.lake import Lake

pytestmark = pytest.mark.whole


@pytest.mark.slow
def test_writers_committers_and_readers_do_not_disturb_each_other(tmp_path: Path) -> None:
    found = contention(tmp_path / "lake", scenes=12, writers=4, committers=2, readers=1, kills=2)
    assert found.errors == ()
    assert (found.halves, found.mixed, found.lost, found.doubled) == (0, 0, 0, 0)
    assert found.kills == 2
    assert found.reads > 0
    assert found.commits >= 2  # every scene was committed twice
    reader = Lake.open(tmp_path / "lake").snapshot()
    assert sum(reader.arrow(table).num_rows for table in ("scenes", "captions", "candidates")) == found.rows == 12 * rows_per_scene()


def test_a_reader_counts_half_scenes_and_mixed_ones(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    stage_scene(lake, 0, "time 0", at=0)
    stage_scene(lake, 1, "time 0", at=1)
    lake.commit()
    assert seen_wrong(lake.snapshot()) == (0, 0)
    # The candidates' staged files go: their run is recorded as lost, and a half of the scene is committed.
    stage_scene(lake, 0, "time 1", at=1000)
    for one in lake.staging.runs():
        if one.run.stage == "candidates":
            lake.storage.remove(one.files["candidates"])
    lake.commit()
    assert seen_wrong(lake.snapshot())[0] == 1
    # Rows of two times in one scene: what no commit leaves is written past it.
    import pyarrow as pa
    from deltalake import write_deltalake

    reader = Lake.open(tmp_path / "lake").snapshot()
    rows = reader.arrow("captions", scene_id(1)).slice(0, 1)
    place = rows.schema.get_field_index("sentence")
    write_deltalake(tmp_path / "lake" / "tables" / "captions", rows.set_column(place, "sentence", pa.array(["time 1"])), mode="append")
    mixed = _at_head(lake)
    assert mixed == (2, 1)  # a row too many and a row of another time in one scene, half of the other


def _at_head(lake: Lake) -> tuple[int, int]:
    """What a reader sees that trusts the head of `captions` instead of the snapshot."""
    reader = lake.snapshot()
    opened = lake.tables.open("captions")
    assert opened is not None
    reader._files["captions"] = lake.tables.files("captions", opened)
    return seen_wrong(reader)


def test_a_scene_has_the_rows_that_are_counted(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    stage_scene(lake, 3, "time 0", at=0)
    lake.commit()
    reader = lake.snapshot()
    assert reader.arrow("captions").num_rows == CAPTIONS
    assert reader.arrow("candidates").num_rows == CAPTIONS * SLOTS
    assert reader.arrow("assets").num_rows == SLOTS


@pytest.mark.timeout(120)
def test_a_process_that_dies_of_an_error_ends_it_and_is_told(tmp_path: Path) -> None:
    Lake.open(tmp_path / "lake").blobs.put(b"contention", "glb")
    (tmp_path / "lake" / "staged").write_text("no folder")  # nobody can stage
    found = contention(tmp_path / "lake", scenes=2, writers=4, committers=1, readers=1, kills=0)
    assert len(found.errors) >= 1
    assert "staged" in found.errors[0]
    assert (found.commits, found.lost) == (0, 2 * rows_per_scene() + 2 * (SLOTS - 1) + 1)
