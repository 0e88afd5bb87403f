"""Schemas change, lakes stay: one written under an older or a newer schema is read, replaced, kept small and released."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from schemas.captions import Caption
from schemas.errors import InputError
from schemas.record import Column, Table, table_of
from schemas.tables import TABLES
from tests.samples import fingerprint, sample, stage_run
from tests.whole_scenes import stage_whole_scene
from warehouse.lake import Lake
from warehouse.questions.sql import query
from warehouse.release import make_release
from warehouse.upkeep.backup import backup, restore
from warehouse.upkeep.compaction import compact
from warehouse.upkeep.erasure import erase
from warehouse.upkeep.inspection import inspect
from warehouse.upkeep.vacuum import vacuum

pytestmark = pytest.mark.whole

SCENES = ["demo/scene0000_00", "demo/scene0001_00"]
MISSING = "shape"


@contextmanager
def declared(monkeypatch: pytest.MonkeyPatch, columns: tuple[Column, ...]) -> Iterator[None]:
    """Captions as another version of the project declares them."""
    table, real = dataclasses.replace(table_of(Caption), columns=columns), table_of
    with monkeypatch.context() as patch:
        patch.setitem(TABLES, "captions", table)
        patch.setattr("schemas.record.table_of", lambda record: table if record is Caption else real(record))
        yield


def without(name: str) -> tuple[Column, ...]:
    return tuple(column for column in table_of(Caption).columns if column.name != name)


def sentences(lake: Lake, snapshot_id: int | None = None) -> dict[str, set[str | None]]:
    """Shapes of the captions by scene."""
    rows = query(lake.snapshot(snapshot_id), f"SELECT scene_id, {MISSING} AS value FROM captions").to_pylist()
    return {scene: {row["value"] for row in rows if row["scene_id"] == scene} for scene in sorted({row["scene_id"] for row in rows})}


@pytest.mark.slow
def test_a_column_that_is_younger_than_the_lake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Written with a column less; read, replaced, compacted, released, backed up, vacuumed and erased with it."""
    lake = Lake.open(tmp_path / "lake")
    with declared(monkeypatch, without(MISSING)):
        for number, scene in enumerate(SCENES):
            stage_whole_scene(lake, scene, "old", at=number)
        lake.commit("old")
        assert MISSING not in lake.snapshot().arrow("captions").column_names
        make_release(lake, "old")
    lake = Lake.open(lake.address)
    assert sentences(lake) == {SCENES[0]: {None}, SCENES[1]: {None}}
    assert [row.shape for row in lake.snapshot().rows(Caption)] == [None] * 4
    stage_whole_scene(lake, SCENES[1], "new", at=10)
    lake.commit("new")
    expected = {SCENES[0]: {None}, SCENES[1]: {"text"}}
    assert sentences(lake) == expected
    assert sentences(lake, 1) == {SCENES[0]: {None}, SCENES[1]: {None}}
    assert compact(lake).tables
    assert sentences(lake) == expected
    make_release(lake, "new")
    released = pq.read_table(Path(lake.address) / "releases/new/captions.parquet")
    assert set(zip(released.column("scene_id").to_pylist(), released.column(MISSING).to_pylist(), strict=True)) == {
        (SCENES[0], None), (SCENES[1], "text"),
    }  # fmt: skip
    backup(lake, tmp_path / "backup")
    restore(tmp_path / "backup", tmp_path / "restored")
    assert sentences(Lake.open(tmp_path / "restored")) == expected
    vacuum(lake, days=0)
    assert sentences(lake) == expected
    # The inspection says that rows lack a value which the schema asks for, and how to have it.
    found = inspect(lake)
    assert {(finding.kind, finding.field) for finding in found.errors} == {("rule", MISSING)}
    assert all("run the stage again" in finding.remedy for finding in found.errors)
    assert erase(lake, SCENES[1]).proof.hits == ()  # type: ignore[union-attr]
    assert sentences(lake) == {SCENES[0]: {None}}
    stage_whole_scene(lake, SCENES[0], "new", at=20)
    lake.commit()
    assert inspect(lake, lake.snapshot().snapshot_id).errors == ()


def test_a_column_that_is_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An older version's column is neither read nor lost: its files keep it, compaction and erasure included."""
    lake = Lake.open(tmp_path / "lake")
    for number, scene in enumerate(SCENES):
        stage_whole_scene(lake, scene, "old", at=number)
        lake.commit()
    with declared(monkeypatch, without(MISSING)):
        lake = Lake.open(lake.address)
        assert MISSING not in lake.snapshot().arrow("captions").column_names
        stage_whole_scene(lake, SCENES[1], "new", at=10)
        lake.commit()
        compact(lake)
        assert inspect(lake).errors == ()
        make_release(lake, "v1")
        assert MISSING not in pq.read_schema(Path(lake.address) / "releases/v1/captions.parquet").names
        assert len(query(lake.snapshot(), "SELECT * FROM captions")) == 4
    assert sentences(Lake.open(lake.address)) == {SCENES[0]: {"text"}, SCENES[1]: {None}}


@contextmanager
def not_known(table: Table) -> Iterator[None]:
    """A version that does not know a table. After it the tables are in their order again, in which pages list them."""
    before = dict(TABLES)
    del TABLES[table.name]
    try:
        yield
    finally:
        TABLES.clear()
        TABLES.update(before)


def test_a_table_of_another_version_is_left_alone(tmp_path: Path) -> None:
    """A newer version made it: an older one compacts, vacuums and erases without touching what it does not know."""
    lake = Lake.open(tmp_path / "lake")
    for number, scene in enumerate(SCENES):
        stage_whole_scene(lake, scene, "x", at=number)
        lake.commit()
    unknown: Table = TABLES["unreachable_targets"]
    with not_known(unknown):
        compact(lake)
        vacuum(lake, days=0)
        done = erase(lake, SCENES[1])
        assert done.proof is not None
        assert done.proof.hits == ()
    rows = lake.snapshot().arrow(unknown.name)
    assert set(rows.column("scene_id").to_pylist()) == {SCENES[0]}


def test_lakes_of_a_newer_format_are_refused(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    lake.stage_rows(stage_run("demo/a", "captions", fingerprint(1)), {"captions": [sample(Caption, scene_id="demo/a")]})
    lake.commit()
    (tmp_path / "lake" / "lake.json").write_text('{"format": 99}')
    for work in (lambda one: compact(one), lambda one: vacuum(one), lambda one: inspect(one), lambda one: erase(one, "demo/a")):
        with pytest.raises(InputError, match="the lake has format 99, this version reads 1; update the project"):
            work(Lake.open(tmp_path / "lake"))


def test_columns_keep_their_types_when_they_are_compacted(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    for number, scene in enumerate(SCENES):
        stage_whole_scene(lake, scene, "x", at=number)
        lake.commit()
    before = {table: lake.snapshot().arrow(table) for table in lake.snapshot().versions}
    types = {table: _types(lake, table) for table in before}
    compact(lake)
    assert {table: _types(lake, table) for table in before} == types
    assert all(lake.snapshot().arrow(table).equals(rows) for table, rows in before.items())


def _types(lake: Lake, table: str) -> dict[str, pa.DataType]:
    opened = lake.tables.open(table)
    assert opened is not None
    return {field.name: field.type for field in pa.schema(opened.schema().to_arrow())}
