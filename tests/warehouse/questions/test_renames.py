"""Old names beside new ones: of views, of their columns, and of columns of tables whose files have them under either."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import duckdb
import pyarrow.parquet as pq
import pytest

from schemas.captions import Caption
from schemas.record import table_of
from schemas.tables import TABLES
from tests.whole_scenes import stage_whole_scene
from warehouse.lake import Lake
from warehouse.questions import renames
from warehouse.questions.catalog import described, empty_lake, entries, views_page
from warehouse.questions.documentation import table_section
from warehouse.questions.renames import RENAMES, Rename
from warehouse.questions.sql import query
from warehouse.questions.views import views
from warehouse.release import make_release
from warehouse.release.catalog import attach_release
from warehouse.release.difference import difference
from warehouse.upkeep.inspection import inspect

SCENES = ["demo/scene0000_00", "demo/scene0001_00"]
RENAMED = (
    Rename("how_many", "objects_per_scene"),
    Rename("things", "objects", of="objects_per_scene"),
    Rename("is_empty", "objects", of="objects_per_scene", value="objects = 0"),
    Rename("shape", "form", of="captions"),
)


@pytest.fixture
def lake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lake:
    """A lake of two scenes whose captions have a column `shape`; the second one is written anew once it is called `form`."""
    lake = Lake.open(tmp_path / "lake")
    for number, scene in enumerate(SCENES):
        stage_whole_scene(lake, scene, "old", at=number)
    lake.commit("old")
    make_release(lake, "old")
    table = table_of(Caption)
    columns = tuple(dataclasses.replace(one, name="form") if one.name == "shape" else one for one in table.columns)
    monkeypatch.setitem(TABLES, "captions", dataclasses.replace(table, columns=columns))
    monkeypatch.setattr(renames, "RENAMES", RENAMED)
    return Lake.open(lake.address)


def test_every_rename_leads_somewhere() -> None:
    names = {view.name for view in views()} | TABLES.keys()
    with empty_lake() as connection:
        for one in RENAMES:
            assert (one.of or one.after) in names, one
            assert one.before not in names, one
            if one.of:
                assert one.after in {row[0] for row in connection.execute(f'DESCRIBE "{one.of}"').fetchall()}, one


def test_a_view_and_a_column_of_one_answer_by_both_names(lake: Lake) -> None:
    reader = lake.snapshot()
    assert query(reader, "FROM how_many").equals(query(reader, "FROM objects_per_scene"))
    rows = query(reader, "SELECT objects, things, is_empty FROM objects_per_scene").to_pylist()
    assert rows
    assert all(row["objects"] == row["things"] and row["is_empty"] is False for row in rows)
    with empty_lake() as connection:
        one = next(view for view in views() if view.name == "objects_per_scene")
        assert "things" not in described(connection, one)["columns"]
        comments = dict(connection.execute("SELECT view_name, comment FROM duckdb_views() WHERE NOT internal").fetchall())
    assert comments["how_many"] == "Old name of objects_per_scene; it goes with the next version."
    assert "how_many" in [entry.name for entry in entries()]
    page = views_page()
    assert "| `how_many` | [`objects_per_scene`](#objects_per_scene) |" in page
    assert "| `things` | old name of `objects`, goes with the next version |" in page
    assert "| `is_empty` | old name of `objects = 0`, goes with the next version |" in page
    assert "(before: `shape`)" in table_section(TABLES["captions"])


def test_a_view_that_takes_all_of_another_has_its_old_names_once(monkeypatch: pytest.MonkeyPatch) -> None:
    of = ("navigation_groups", "navigation_metrics")
    monkeypatch.setattr(renames, "RENAMES", tuple(Rename("trials", "n", of=view) for view in of))
    with empty_lake() as connection:
        for view in of:
            names = [row[0] for row in connection.execute(f'DESCRIBE "{view}"').fetchall()]
            assert (names.count("n"), names.count("trials"), len(names)) == (1, 1, len(set(names)))
        macro_columns = [row[0] for row in connection.execute("DESCRIBE FROM objects_of(NULL)").fetchall()]
        assert len(macro_columns) == len(set(macro_columns))


@pytest.mark.whole
def test_files_under_the_old_name_of_a_column_are_read(lake: Lake) -> None:
    assert query(lake.snapshot(), "SELECT DISTINCT form, shape FROM captions").to_pylist() == [{"form": "text", "shape": "text"}]
    for scene in (None, SCENES[0]):
        assert set(lake.snapshot().arrow("captions", scene).column("form").to_pylist()) == {"text"}
    assert "shape" not in lake.snapshot().arrow("captions").column_names
    assert difference(lake, lake.snapshot(), lake.snapshot()).scenes.changed.count == 0
    found = [one for one in inspect(lake).errors if one.field in ("form", "shape")]
    assert found == []
    make_release(lake, "new")
    released = pq.read_table(Path(lake.address) / "releases/new/captions.parquet")
    assert set(released.column("form").to_pylist()) == {"text"}
    assert "shape" not in released.column_names


def test_an_older_release_is_asked_by_the_new_name(lake: Lake, tmp_path: Path) -> None:
    out = tmp_path / "old.duckdb"
    attach_release(lake, "old", out)
    with duckdb.connect() as connection:
        connection.execute(f"ATTACH '{out}' AS r (READ_ONLY); USE r")
        assert connection.execute("SELECT DISTINCT form, shape FROM captions").fetchall() == [("text", "text")]
        assert connection.execute("SELECT count(*) FROM how_many").fetchall() == [(2,)]


def test_files_under_both_names_lie_side_by_side(lake: Lake) -> None:
    before = lake.snapshot().arrow("captions")
    writer = lake.tables.writer(TABLES["captions"], lake.snapshot().versions["captions"], lambda: None)
    new = before.filter([scene == SCENES[1] for scene in before.column("scene_id").to_pylist()])
    form = new.column_names.index("form")
    writer.replace(new.set_column(form, "form", [["round"] * new.num_rows]), "scene_id", [SCENES[1]])
    files = lake.tables.files("captions", lake.tables.open("captions"))
    rows = lake.tables.read(TABLES["captions"], files)
    found = set(zip(rows.column("scene_id").to_pylist(), rows.column("form").to_pylist(), strict=True))
    assert found == {(SCENES[0], "text"), (SCENES[1], "round")}
    only = lake.tables.read(TABLES["captions"], files, ["form"], {"form": ["round"]})
    assert set(only.column("form").to_pylist()) == {"round"}
