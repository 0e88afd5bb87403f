"""The lake's inspection, tested by damage: every kind is found by its own finding, and a sound lake has none."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from flows.cli import cli
from schemas.captions import Caption
from schemas.tables import TABLES
from tests.samples import fingerprint, stage_run
from tests.whole_scenes import stage_batch, stage_whole_scene
from warehouse.lake import Lake
from warehouse.release import make_release
from warehouse.sharing.claims import path_of
from warehouse.sharing.writer import this_writer
from warehouse.tables.commit import Commit, versions_of
from warehouse.tables.datafiles import exchange, write_files
from warehouse.upkeep.compaction import compact
from warehouse.upkeep.inspection import Inspection, inspect

SCENES = [f"demo/scene{number:04d}_00" for number in range(2)]
DEAD = f"{this_writer().machine}-999999-1-1"


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lake with two snapshots, a batch, a release and a staged run."""
    lake = Lake.open(tmp_path_factory.mktemp("sound") / "lake")
    for number, scene in enumerate(SCENES):
        stage_whole_scene(lake, scene, "old", at=number)
    lake.commit("first")
    make_release(lake, "v1")
    stage_whole_scene(lake, SCENES[1], "new", at=10)
    stage_batch(lake, "batch-1", SCENES, at=11)
    lake.commit("second")
    stage_whole_scene(lake, "demo/scene0009_00", "staged", at=20)
    return Path(lake.address)


@pytest.fixture
def lake(sound: Path, tmp_path: Path) -> Lake:
    shutil.copytree(sound, tmp_path / "lake")
    return Lake.open(tmp_path / "lake")


def one(lake: Lake, pattern: str) -> Path:
    return sorted(Path(lake.address).glob(pattern))[0]


def data_file(lake: Lake, table: str = "instances") -> Path:
    return Path(lake.address) / lake.snapshot().files(table)[0]


def blob(lake: Lake) -> Path:
    name = lake.snapshot().arrow("scenes").column("mesh_blob")[0].as_py()
    return lake.blobs.path(name)


def put_in_force(lake: Lake, table: str, change: Callable[[pa.Table], pa.Table]) -> None:
    """A new snapshot in which a table has other rows, as no code of ours would write them."""
    opened = lake.tables.open(table)
    assert opened is not None
    with lake.leased() as lease:
        paths = lake.tables.files(table, opened)
        rows = change(lake.tables.read(TABLES[table], paths))
        new = write_files(lake.storage, table, rows.to_batches(), rows.schema, lease.check)
        version = exchange(lake.tables, lake.storage, table, paths, new, lease.check)
        last = lake.snapshot().snapshots[-1]
        named = versions_of(last) | {table: version}
        row = dataclasses.replace(
            last, snapshot_id=last.snapshot_id + 1, tables=tuple(f"{name}={number}" for name, number in sorted(named.items()))
        )
        Commit(lake.tables, lake.staging, lease).rewrite_snapshots([*lake.snapshot().snapshots, row])


def with_value(column: str, value: Any, kind: pa.DataType | None = None) -> Callable[[pa.Table], pa.Table]:
    """The first row's value of a column is another."""

    def change(rows: pa.Table) -> pa.Table:
        values = rows.column(column).to_pylist()
        index = rows.schema.get_field_index(column)
        field = rows.schema.field(column) if kind is None else pa.field(column, kind)
        return rows.set_column(index, field, pa.array([value, *values[1:]], field.type))

    return change


def old(path: Path) -> Path:
    os.utime(path, (0, 0))
    return path


def overwrite(path: Path, data: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def flip_middle(path: Path) -> None:
    data = bytearray(path.read_bytes())
    for index in range(4, min(len(data) // 2, 400)):
        data[index] ^= 0xFF
    path.write_bytes(bytes(data))


def dead_lease(lake: Lake) -> None:
    lake.storage.create("lease.json", json.dumps({"token": DEAD, "host": "here", "expires": 9e9, "life": 60}).encode())


def dead_claim(lake: Lake) -> None:
    holder = {"token": DEAD, "host": "here", "expires": 9e9, "life": 60, "scene_id": SCENES[0], "since": 0.0}
    lake.storage.create(path_of(SCENES[0]), json.dumps(holder).encode())


def dead_run(lake: Lake) -> None:
    with lake.presence({"scans": "scans"}) as presence:
        told = lake.storage.read(f"runs/{presence.run.token}.json")
    lake.storage.create(f"runs/{DEAD}.json", told.replace(presence.run.token.encode(), DEAD.encode()))


def half_staged(lake: Lake) -> None:
    name = f"demo~2fx@captions@{fingerprint('x')}@{DEAD}@captions.parquet"
    overwrite(Path(lake.address) / "staged" / name, b"PAR1")


def faulty_staged(lake: Lake) -> None:
    one(lake, "staged/*@capture@*@instances.parquet").unlink()


def renamed_snapshot(lake: Lake) -> None:
    with lake.leased() as lease:
        rows = list(lake.snapshot().snapshots)
        commit = Commit(lake.tables, lake.staging, lease)
        commit.rewrite_snapshots([*rows[:-1], dataclasses.replace(rows[-1], tables=("instances=one",))])


def release_of_no_snapshot(lake: Lake) -> None:
    path = Path(lake.address) / "releases/v1/release.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"snapshot_id": 77}))


DAMAGES: dict[str, tuple[Callable[[Lake], Any], str, str, bool]] = {
    # name: what is done, the kind of the finding, a word of its text, whether it is an error
    "blob is gone": (lambda lake: blob(lake).unlink(), "blob", "is missing", True),
    "blob holds something else": (lambda lake: blob(lake).write_bytes(b"x"), "content", "differs from the name", True),
    "blob that nobody names": (
        lambda lake: (
            overwrite(one(lake, "blobs").joinpath("ab", "cd", f"abcd{'0' * 60}.glb"), b"x") or old(one(lake, "blobs/ab/cd/abcd0*"))
        ),
        "unnamed blob",
        "nobody names it",
        False,
    ),
    "stranger among blobs": (lambda lake: overwrite(one(lake, "blobs") / "ab" / "notes.txt", b"x"), "foreign file", "notes.txt", False),
    "data file is gone": (lambda lake: data_file(lake).unlink(), "data file", "is missing", True),
    "data file is cut short": (lambda lake: os.truncate(data_file(lake), 100), "size", "is 100 B", True),
    "data file has no footer": (
        lambda lake: overwrite(data_file(lake), b"x" * data_file(lake).stat().st_size),
        "footer",
        "cannot be read",
        True,
    ),
    "page is damaged": (lambda lake: flip_middle(data_file(lake)), "unreadable", "cannot be read", True),
    "data file that no version names": (
        lambda lake: shutil.copy(
            data_file(lake), data_file(lake).with_name("part-00000-12345678-1234-1234-1234-123456789abc-c000.parquet")
        ),
        "unnamed file",
        "no version",
        False,
    ),
    "stranger in a table": (lambda lake: overwrite(data_file(lake).with_name("mine.parquet"), b"x"), "foreign file", "mine.parquet", False),
    "killed write of a table": (
        lambda lake: overwrite(data_file(lake).with_name("part-0.parquet#1"), b"x"),
        "unfinished file",
        "killed",
        False,
    ),
    "table that is none": (lambda lake: overwrite(Path(lake.address) / "tables/mine/a.parquet", b"x"), "table", "no table", False),
    "log is no JSON": (
        lambda lake: overwrite(sorted(Path(lake.address).glob("tables/instances/_delta_log/*.json"))[-1], b"{"),
        "log",
        "cannot be opened",
        True,
    ),
    "log of a table is gone": (lambda lake: shutil.rmtree(Path(lake.address) / "tables/masks/_delta_log"), "version", "is missing", True),
    "log of snapshots is damaged": (
        lambda lake: overwrite(sorted(Path(lake.address).glob("tables/snapshots/_delta_log/*.json"))[-1], b"{"),
        "log",
        "tables/snapshots",
        True,
    ),
    "snapshot names no version": (renamed_snapshot, "snapshot", "instances=one", True),
    "key is there twice": (
        lambda lake: put_in_force(lake, "captions", lambda rows: pa.concat_tables([rows, rows.slice(0, 1)])),
        "key",
        "several rows",
        True,
    ),
    "value is missing": (lambda lake: put_in_force(lake, "captions", with_value("sentence", None)), "rule", "must not be missing", True),
    "value is none of the allowed": (
        lambda lake: put_in_force(lake, "captions", with_value("body_type", "gas")),
        "rule",
        "must be one of",
        True,
    ),
    "value has the wrong pattern": (lambda lake: put_in_force(lake, "candidates", with_value("asset_id", "x")), "rule", "must match", True),
    "value is too small": (lambda lake: put_in_force(lake, "captions", with_value("friction", -1.0)), "rule", "at least 0", True),
    "value is too large": (lambda lake: put_in_force(lake, "captions", with_value("friction", 3.0)), "rule", "at most 2", True),
    "value is not finite": (lambda lake: put_in_force(lake, "supports", with_value("gap_m", float("nan"))), "rule", "must be finite", True),
    "list is too short": (lambda lake: put_in_force(lake, "instances", with_value("box_size", [1.0])), "rule", "3 values", True),
    "list holds infinity": (
        lambda lake: put_in_force(lake, "instances", with_value("box_size", [1.0, float("inf"), 1.0])),
        "rule",
        "must be finite",
        True,
    ),
    "column has another type": (
        lambda lake: put_in_force(
            lake,
            "captions",
            lambda rows: rows.set_column(rows.schema.get_field_index("mass_kg"), "mass_kg", pa.array(["1"] * rows.num_rows, pa.string())),
        ),
        "type",
        "VARCHAR where the schema says DOUBLE",
        True,
    ),
    "scene is not there": (
        lambda lake: put_in_force(lake, "scenes", lambda rows: rows.slice(1)),
        "reference",
        "not in scenes",
        True,
    ),
    "instance is not there": (
        lambda lake: put_in_force(lake, "captions", with_value("instance_id", "0077")),
        "reference",
        "not in instances",
        True,
    ),
    "asset is not there": (lambda lake: put_in_force(lake, "assets", lambda rows: rows.slice(1)), "reference", "not in assets", True),
    "asset that nobody names": (
        lambda lake: put_in_force(
            lake, "assets", lambda rows: pa.concat_tables([rows, with_value("asset_id", "f" * 64)(rows).slice(0, 1)])
        ),
        "unnamed row",
        "no row of candidates",
        True,
    ),
    "rows are lost": (lambda lake: put_in_force(lake, "captions", lambda rows: rows.slice(1)), "row count", "1 instead of 2", True),
    "staged run lacks a file": (faulty_staged, "staged run", "is missing", True),
    "staged run is no Parquet": (
        lambda lake: overwrite(one(lake, "staged/*@capture@*@stage_runs.parquet"), b"x"),
        "staged run",
        "cannot be read",
        True,
    ),
    "half of a staged run": (half_staged, "unfinished run", "killed", False),
    "stranger among staged files": (
        lambda lake: overwrite(Path(lake.address) / "staged/mine.parquet", b"x"),
        "foreign file",
        "mine",
        False,
    ),
    "temporary file of the dead": (lambda lake: overwrite(Path(lake.address) / "tmp" / DEAD, b"x"), "temporary file", "died", False),
    "claim of the dead": (dead_claim, "claim", f"died while it computed {SCENES[0]}", False),
    "run of the dead": (dead_run, "run", "died at work", False),
    "stranger among claims": (lambda lake: overwrite(Path(lake.address) / "claims/demo.json", b"{}"), "foreign file", "demo.json", False),
    "stranger among runs": (lambda lake: overwrite(Path(lake.address) / "runs/notes/a.txt", b"x"), "foreign file", "a.txt", False),
    "lease of the dead": (dead_lease, "lease", "died", False),
    "release without a record": (
        lambda lake: one(lake, "releases/v1/release.json").unlink(),
        "unfinished release",
        "never finished",
        False,
    ),
    "record of a release is damaged": (
        lambda lake: one(lake, "releases/v1/release.json").write_text("{"),
        "release record",
        "cannot be read",
        True,
    ),
    "release of no snapshot": (release_of_no_snapshot, "release snapshot", "snapshot 77", True),
    "file of a release is gone": (lambda lake: one(lake, "releases/v1/tables.md").unlink(), "release file", "is missing", True),
    "file of a release is changed": (lambda lake: one(lake, "releases/v1/tables.md").write_text("x"), "checksum", "differs", True),
    "checksums of a release are changed": (
        lambda lake: overwrite(one(lake, "releases/v1/SHA256SUMS"), one(lake, "releases/v1/SHA256SUMS").read_bytes() + b"\n"),
        "checksum",
        "SHA256SUMS",
        True,
    ),
    "checksums of a release are gone": (lambda lake: one(lake, "releases/v1/SHA256SUMS").unlink(), "checksums", "is missing", True),
    "table of a release has other rows": (
        lambda lake: pq.write_table(
            pq.read_table(one(lake, "releases/v1/scenes.parquet")).slice(1), one(lake, "releases/v1/scenes.parquet")
        ),
        "release rows",
        "has 1 where",
        True,
    ),
    "stranger in a release": (lambda lake: overwrite(Path(lake.address) / "releases/v1/mine", b"x"), "foreign file", "mine", False),
    "stranger in the lake": (lambda lake: overwrite(Path(lake.address) / "thesis.tex", b"x"), "foreign file", "thesis.tex", False),
    "folder in the lake": (lambda lake: overwrite(Path(lake.address) / "thesis/a.tex", b"x"), "foreign file", "thesis", False),
    "erasure was not finished": (lambda lake: overwrite(Path(lake.address) / "erasure.json", b"{}"), "erasure", "not finished", True),
}


def hashes(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.slow
@pytest.mark.whole
def test_a_sound_lake_has_no_findings_and_is_not_changed(sound: Path) -> None:
    before = hashes(sound)
    for quick in (True, False):
        found = inspect(Lake.open(sound), quick=quick)
        assert [str(finding) for finding in found.findings] == []
    assert (found.snapshots, found.blobs) == (2, len(list((sound / "blobs").rglob("*.*"))) - _only_staged(Lake.open(sound)))
    assert found.blob_bytes > 0
    assert inspect(Lake.open(sound), 1, release="v1").findings == ()
    assert hashes(sound) == before


def _only_staged(lake: Lake) -> int:
    committed = {
        name
        for table in TABLES.values()
        for column in table.blob_columns
        for snapshot in lake.snapshot().snapshots
        for name in lake.snapshot(snapshot.snapshot_id).arrow(table.name).column(column).to_pylist()
    }
    return len(lake.staging.blob_names() - committed)


# One of each part of the inspection; the others go over the whole lake once more each, and wait for `make test-all`.
QUICK = {
    "blob is gone", "stranger among blobs", "data file is cut short", "data file that no version names", "log is no JSON",
    "key is there twice", "value is not finite", "instance is not there", "rows are lost", "staged run lacks a file",
    "claim of the dead", "release without a record", "file of a release is changed", "stranger in the lake",
}  # fmt: skip


@pytest.mark.whole
@pytest.mark.parametrize("name", [name if name in QUICK else pytest.param(name, marks=pytest.mark.slow) for name in DAMAGES])
def test_damage_is_found_by_its_own_finding(lake: Lake, name: str) -> None:
    damage, kind, text, is_error = DAMAGES[name]
    damage(lake)
    found = inspect(Lake.open(lake.address))
    fitting = [finding for finding in found.findings if finding.kind == kind and text in str(finding)]
    assert fitting, [f"{finding.kind}: {finding}" for finding in found.findings]
    assert {finding.is_error for finding in fitting} == {is_error}
    assert all(finding.remedy and "\n" not in str(finding) for finding in found.findings)


@pytest.mark.whole
def test_every_kind_of_damage_is_its_own() -> None:
    assert len({(kind, text) for _, kind, text, _ in DAMAGES.values()}) >= 40
    assert DAMAGES.keys() >= QUICK


@pytest.mark.whole
def test_the_command_says_what_is_wrong(lake: Lake) -> None:
    def ask(*arguments: str) -> tuple[int, Inspection | Any]:
        answer = CliRunner().invoke(cli, ["doctor", "lake", "--lake", lake.address, "--json", *arguments])
        return answer.exit_code, json.loads(answer.output)

    assert ask() == (0, {"errors": [], "warnings": []})
    overwrite(Path(lake.address) / "thesis.tex", b"x")
    code, found = ask()
    assert (code, found["errors"], len(found["warnings"])) == (0, [], 1)
    blob(lake).unlink()
    code, found = ask("--quick")
    assert (code, len(found["errors"])) == (1, 1)
    # The release names the blob, too, unless it is another scene's that came later.
    assert ask("--release", "v1")[0] == 1


@pytest.mark.whole
def test_compacted_and_empty_lakes_are_sound(lake: Lake, tmp_path: Path) -> None:
    compact(lake)
    assert inspect(lake).errors == ()
    assert inspect(Lake.open(tmp_path / "empty")).findings == ()


@pytest.mark.whole
def test_failed_and_withdrawn_runs_are_accounted_for(lake: Lake) -> None:
    failed = stage_run(SCENES[0], "captions", fingerprint("failed"), at=50, outcome="failed", error="x", error_kind="input")
    lake.stage_rows(failed)
    lake.stage_rows(stage_run(SCENES[1], "capture", fingerprint("changed"), at=51))
    assert lake.commit(scenes=SCENES) is not None
    reader = lake.snapshot()
    assert {row.scene_id for row in reader.rows(Caption)} == {SCENES[0]}
    found = inspect(lake)
    assert [str(finding) for finding in found.findings] == []
