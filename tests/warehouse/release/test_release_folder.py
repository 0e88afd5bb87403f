"""The folder of a release: what is in it, that it stays of use where it is copied to, and that it is made whole or not at all."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import duckdb
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from flows.cli import cli
from schemas.candidates import Asset
from schemas.capture import Instance, Scene
from schemas.errors import InputError
from schemas.optimization import Placement
from schemas.runs import Release
from schemas.tables import TABLES
from tests.conftest import REPOSITORY
from tests.samples import fingerprint, sample, stage_run
from tests.warehouse.lake_load import scene_id, stage_scene
from tests.warehouse.questions.view_answers import Database
from warehouse.lake import Lake
from warehouse.questions.macros import macros
from warehouse.questions.views import views
from warehouse.release import make_release, release_of, releases
from warehouse.release.attribution import attribution_of, attribution_of_rows
from warehouse.release.card import data_card
from warehouse.release.catalog import attach_release, variable_of
from warehouse.release.hub import without_head
from warehouse.tables.delta import nullable
from warehouse.tables.digest import digests
from warehouse.upkeep.vacuum import vacuum

VOLATILE = {"releases.parquet", "release.json", "README.md", "croissant.json", "SHA256SUMS", "v1.duckdb"}
"""Files that hold times, or hashes of files that do; DuckDB's own file differs from time to time."""


def filled(folder: Path) -> Lake:
    """Two snapshots of three scenes; in the last, a placed asset by somebody and one that was cut from its scan."""
    lake = Lake.open(folder)
    for i in range(2):
        for number in range(3):
            stage_scene(lake, number, "CC0-1.0", at=10 * i + number)
        lake.commit(f"run {i}")
        blob = lake.blobs.put(b"mesh", "glb")
        scene = scene_id(0)
        names = {"0001": ("CC-BY-4.0", "A. Maker", "https://models.example/chair|1"), "0002": ("LicenseRef-scan", None, f"scan {scene}"),
                 "0003": ("unknown", None, "a drawer")}  # fmt: skip
        assets = [
            sample(Asset, asset_id=fingerprint(name), mesh_blob=blob, license=license_, author=author, source=source)
            for name, (license_, author, source) in names.items()
        ]
        capture = fingerprint(scene, "more", "capture")
        rows = [sample(Instance, scene_id=scene, instance_id=name, points_blob=blob, is_structure=False) for name in names]
        lake.stage_rows(
            stage_run(scene, "capture", capture, at=100),
            {"scenes": [sample(Scene, scene_id=scene, dataset="demo", mesh_blob=blob, license="CC0-1.0")], "instances": rows},
        )
        print_ = fingerprint(scene, "more", "candidates")
        slots = [
            sample(TABLES["candidates"].record, scene_id=scene, instance_id=name, slot=1, asset_id=fingerprint(name)) for name in names
        ]
        lake.stage_rows(stage_run(scene, "candidates", print_, f"capture={capture}", at=101), {"candidates": slots, "assets": assets})
        placed = [sample(Placement, scene_id=scene, instance_id=name, asset_id=fingerprint(name)) for name in names]
        lake.stage_rows(
            stage_run(scene, "optimization", fingerprint(scene, "more"), f"candidates={print_}", at=102), {"placements": placed}
        )
        lake.commit("more")
    return lake


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """A lake with the release v1 of its last snapshot. Read only."""
    lake = filled(tmp_path_factory.mktemp("released") / "lake")
    make_release(lake, "v1", notes="for the paper")
    return lake


@pytest.fixture(scope="module")
def folder(lake: Lake) -> Path:
    return Path(lake.address, "releases", "v1")


def hashes(folder: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


def test_the_folder_has_every_table_and_says_so_three_times(lake: Lake, folder: Path) -> None:
    found = hashes(folder)
    named = {"tables.md", "README.md", "ATTRIBUTION.md", "croissant.json", "v1.duckdb", "SHA256SUMS", "release.json"}
    assert found.keys() == {f"{name}.parquet" for name in TABLES} | named
    sums = dict(reversed(line.split("  ")) for line in (folder / "SHA256SUMS").read_text().splitlines())
    assert sums == {name: value for name, value in found.items() if name not in ("SHA256SUMS", "release.json")}
    record = json.loads((folder / "release.json").read_text())
    listed = {file["path"]: file for file in record["files"]}
    assert {name: file["sha256"] for name, file in listed.items()} == {**sums, "SHA256SUMS": found["SHA256SUMS"]}
    counts = dict(entry.split("=") for entry in record["row_counts"])
    reader = lake.snapshot()
    for name, table in TABLES.items():
        file = pq.ParquetFile(folder / f"{name}.parquet")
        data = file.read()
        assert data.equals(reader.arrow(name).cast(nullable(table.arrow_schema))), "the lake's rows, in the order of the key"
        assert {c.name: c.metadata[b"description"].decode() for c in data.schema} == {c.name: c.description for c in table.columns}
        assert listed[f"{name}.parquet"]["rows"] == data.num_rows == int(counts[name])
        assert listed[f"{name}.parquet"]["bytes"] == (folder / f"{name}.parquet").stat().st_size
        if data.num_rows:
            assert file.metadata.row_group(0).column(0).compression == "ZSTD"
    assert not any(Path(lake.address, "tmp").iterdir()), "nothing half made is left"


@pytest.mark.whole
def test_the_same_snapshot_gives_the_same_bytes_except_times(lake: Lake, folder: Path, tmp_path: Path) -> None:
    shutil.copytree(lake.address, tmp_path / "lake")
    shutil.rmtree(tmp_path / "lake" / "releases")
    other = Lake.open(tmp_path / "lake")
    make_release(other, "v1", notes="for the paper")
    first, second = hashes(folder), hashes(tmp_path / "lake" / "releases" / "v1")
    assert first.keys() == second.keys()
    assert {name for name in first if first[name] != second[name]} <= VOLATILE
    cited = [next(line for line in (place / "README.md").read_text().splitlines() if line.startswith("> SHA-256"))
             for place in (folder, tmp_path / "lake" / "releases" / "v1")]  # fmt: skip
    assert cited[0] == cited[1]
    named = "".join(f"{first[f'{name}.parquet']}  {name}.parquet\n" for name in sorted(TABLES) if TABLES[name].stage)
    assert cited[0] == f"> SHA-256 {hashlib.sha256(named.encode()).hexdigest()}"


def test_the_card_states_counts_licenses_and_limits(lake: Lake, folder: Path) -> None:
    card = (folder / "README.md").read_text()
    release = release_of(lake, "v1")
    for count, what in ((release.scenes, "scenes"), (release.objects, "objects"), (release.placed_objects, "placed objects")):
        assert f"| {what} | {count:,} |" in card
    assert "for the paper" in card
    assert f"snapshot {release.snapshot_id}" in card
    assert "0 scans and 1 placed asset have no known license; 2 placed assets no known author." in card
    assert card.count("CC-BY-4.0") == 1
    page = (folder / "ATTRIBUTION.md").read_text()
    assert "**1 of these have no known license.**" in page
    asks = "name author and source, link the license, say what was changed"
    assert f"| CC-BY-4.0 | {asks} | A. Maker | https://models.example/chair\\|1 | 1 | 1 |" in page
    assert "| CC0-1.0 | nothing | unknown | cut from scans of demo | 1 | 1 |" in page
    assert "| unknown | unknown: ask before handing it on | unknown | a drawer | 1 | 1 |" in page


@pytest.fixture(scope="module")
def several() -> Iterator[Database]:
    """Two scenes captured here, and a scene of each of two imported datasets, which share an asset."""
    with Database() as made:
        rows: list[Any] = []
        for scene, objects in (("demo/a", 3), ("demo/b", 1), ("hssd/c", 2), ("ycb/d", 1)):
            dataset = scene.partition("/")[0]
            shown = "scannet" if dataset == "demo" else "habitat"
            rows.append(sample(Scene, scene_id=scene, dataset=dataset, scan_format=shown, license=None if dataset == "ycb" else "CC0-1.0"))
            for number in range(objects):
                of = {"scene_id": scene, "instance_id": f"{number:04}"}
                rows.append(sample(Instance, **of, is_structure=False, nyu40_id=number % 2, category=f"object {number}", box_volume_m3=2.0))
                asset = "shared" if number == 0 and dataset != "demo" else f"{dataset} {number}"
                rows.append(sample(Placement, **of, asset_id=fingerprint(asset)))
        rows += [
            sample(Asset, asset_id=fingerprint(name), provider=provider, license="CC-BY-4.0", author="A. Maker", source=source)
            for name, provider, source in (
                ("demo 0", "retrieval", "chair.glb"), ("demo 1", "retrieval", "chair.glb"), ("demo 2", "scan_crop_closed", "scan demo/a"),
                ("shared", "imported", "objects/chair.glb"), ("hssd 1", "imported", "objects/lamp.glb"),
            )
        ]  # fmt: skip
        failed = stage_run("demo/b", "exports", fingerprint("failed"))
        rows.append(dataclasses.replace(failed, outcome="failed", error="out of luck", error_kind="defect"))
        made.fill(*rows)
        yield made


def test_assets_of_imported_datasets_are_credited_to_the_dataset(several: Database) -> None:
    credits = {(one.what, one.items, one.scenes) for one in attribution_of(several.connection).assets}
    assert credits == {
        ("chair.glb", 2, 2), ("cut from scans of demo", 1, 1),
        ("dataset hssd, ycb: objects/chair.glb", 1, 2), ("dataset hssd: objects/lamp.glb", 1, 1),
    }  # fmt: skip
    scans = {row["scene_id"]: (row["dataset"], row["license"]) for row in several.ask("scenes")}
    columns = "scene_id, asset_id, license, author, source, provider"
    placed = several.connection.sql(f"SELECT {columns} FROM placements JOIN assets USING (asset_id)").fetchall()
    assert attribution_of_rows(scans, placed) == attribution_of(several.connection), "an export of everything credits the same"


def test_a_card_of_several_datasets_tells_them_apart(several: Database) -> None:
    release = sample(Release, name="v1", objects=7)
    card = data_card(release, several.connection, attribution_of(several.connection), [])
    for line in (
        "| demo | 2 | 2 | 4 | 1 | 4 | 100 | 2 |",
        "| hssd | 1 | 2 | 2 | 1 | 2 | 100 | 2 |",
        "| ycb | 1 | 1 | 1 | 0 | 1 | 100 | 2 |",
    ):
        assert line in card
    assert "What failed at its last attempt (`failures`); what an earlier attempt gave may be in it:\n\n| scene |" in card
    several.connection.execute("BEGIN")
    several.connection.execute("DELETE FROM scenes WHERE dataset <> 'demo'")
    assert "dataset_comparison" not in data_card(release, several.connection, attribution_of(several.connection), [])
    several.connection.execute("ROLLBACK")


def shell(sql: str, folder: Path) -> list[dict[str, object]]:
    """Answers of the DuckDB shell, started in a folder."""
    program = shutil.which("duckdb", path=str(Path(sys.executable).parent)) or shutil.which("duckdb")
    assert program, "the DuckDB shell is among what tests need: pip install duckdb-cli"
    done = subprocess.run([program, "-json", "-c", sql], capture_output=True, text=True, cwd=folder, check=False)
    assert done.returncode == 0, done.stderr
    return list(json.loads(done.stdout)) if done.stdout.strip() else []


@pytest.mark.whole
def test_any_duckdb_shell_attaches_the_release_and_reads_all_of_it(lake: Lake, folder: Path, tmp_path: Path) -> None:
    attach = f"ATTACH '{folder / 'v1.duckdb'}' AS v1 (READ_ONLY);"
    with lake.snapshot().connect() as connection:
        for name in TABLES:
            counted = connection.sql(f'SELECT count(*) FROM "{name}"').fetchall()[0][0]
            assert shell(f'{attach} SELECT count(*) AS n FROM v1."{name}"', tmp_path) == [{"n": counted}], name
    known = shell(f"{attach} SELECT view_name, comment FROM duckdb_views() WHERE database_name = 'v1'", tmp_path)
    comments = {row["view_name"]: row["comment"] for row in known}
    assert comments == {name: table.description for name, table in TABLES.items()} | {view.name: view.comment for view in views()}
    functions = shell(
        f"{attach} SELECT DISTINCT function_name AS name, comment FROM duckdb_functions() WHERE database_name = 'v1'", tmp_path
    )
    assert {row["name"]: row["comment"] for row in functions}.items() >= {macro.name: macro.comment for macro in macros()}.items()
    assert shell(f"{attach} USE v1; SELECT category FROM top_categories(1)", tmp_path) == [{"category": "text"}]


@pytest.mark.whole
def test_every_view_of_the_catalog_answers_as_the_lake_does(lake: Lake, folder: Path) -> None:
    with duckdb.connect() as other, lake.snapshot().connect() as own:
        other.execute("SET TimeZone = 'UTC'")
        other.execute(f"ATTACH '{folder / 'v1.duckdb'}' AS v1 (READ_ONLY)")
        for view in views():
            found = other.sql(f'SELECT * FROM v1."{view.name}"')
            expected = own.sql(f'SELECT * FROM "{view.name}"')
            assert found.columns == expected.columns
            assert sorted(map(repr, found.fetchall())) == sorted(map(repr, expected.fetchall())), view.name
        with pytest.raises(duckdb.Error):
            other.execute("CREATE TABLE v1.x AS SELECT 1")


def test_a_copied_folder_is_of_use_wherever_it_lies(lake: Lake, folder: Path, tmp_path: Path) -> None:
    copied = tmp_path / "it's copied"
    shutil.copytree(folder, copied)
    expected = shell(f"ATTACH '{folder / 'v1.duckdb'}' AS v1 (READ_ONLY); SELECT scenes, placed_objects FROM v1.headline", tmp_path)
    moved = tmp_path / "elsewhere"
    shutil.copytree(folder, moved)
    (moved / "scenes.parquet").write_bytes((copied / "annotations.parquet").read_bytes())  # to tell the folders apart
    quoted = str(copied).replace("'", "''")
    here = f"SET VARIABLE {variable_of('v1')} = '{quoted}'; ATTACH '{quoted}/v1.duckdb' AS r (READ_ONLY);"
    here += "SELECT scenes, placed_objects FROM r.headline"
    assert shell(here, tmp_path) == expected
    (copied / "placements.parquet").unlink()
    with pytest.raises(AssertionError, match="placements"):
        shell(here, tmp_path)
    attach_release(Lake.open(tmp_path / "no lake"), str(folder), tmp_path / "made" / "new.duckdb")
    assert shell("ATTACH 'made/new.duckdb' AS r (READ_ONLY); SELECT scenes, placed_objects FROM r.headline", tmp_path) == expected
    assert not (tmp_path / "no lake").exists()


def test_a_release_of_an_older_version_attaches_with_what_it_has(lake: Lake, folder: Path, tmp_path: Path) -> None:
    older = tmp_path / "older"
    shutil.copytree(folder, older)
    (older / "quality_reviews.parquet").unlink()
    table = pq.read_table(older / "scenes.parquet")
    pq.write_table(table.drop_columns(["license"]), older / "scenes.parquet")
    attach_release(lake, str(older), tmp_path / "older.duckdb")
    asked = "ATTACH 'older.duckdb' AS r (READ_ONLY); SELECT count(*) AS n, count(license) AS licensed FROM r.scenes"
    assert shell(asked, tmp_path) == [{"n": table.num_rows, "licensed": 0}]
    assert shell("ATTACH 'older.duckdb' AS r (READ_ONLY); SELECT count(*) AS n FROM r.quality_reviews", tmp_path) == [{"n": 0}]


def test_what_cannot_be_attached_is_refused_and_nothing_is_written(lake: Lake, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.duckdb"
    with pytest.raises(InputError, match=r"no release 'v9'; there are: v1"):
        attach_release(lake, "v9", out)
    (tmp_path / "bare").mkdir()
    shutil.copy(folder / "release.json", tmp_path / "bare" / "release.json")
    with pytest.raises(InputError, match="has no tables"):
        attach_release(lake, str(tmp_path / "bare"), out)
    (tmp_path / "bare" / "scenes.parquet").write_bytes(b"PAR1 but not")
    with pytest.raises(duckdb.Error):
        attach_release(lake, str(tmp_path / "bare"), out)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bare"]
    out.write_text("mine")
    refused = CliRunner().invoke(cli, ["release", "attach", str(folder), "--out", str(out)])
    assert "is there already" in str(refused.exception)
    assert out.read_text() == "mine"
    assert CliRunner().invoke(cli, ["release", "attach", str(folder), "--out", str(out), "--force"]).exit_code == 0
    assert out.read_bytes()[8:12] == b"DUCK"


@pytest.mark.parametrize("name", ["latest", "7", "V1", "v1", "../v1", "a/b", ".hidden", "", "x" * 101])
def test_names_that_cannot_be_or_are_taken_are_refused_before_anything_is_written(lake: Lake, name: str) -> None:
    before = {str(path): path.stat().st_mtime_ns for path in Path(lake.address).rglob("*")}
    with pytest.raises(InputError):
        make_release(lake, name)
    assert {str(path): path.stat().st_mtime_ns for path in Path(lake.address).rglob("*")} == before


@pytest.mark.whole
def test_a_snapshot_that_goes_while_it_is_released_is_no_release(tmp_path: Path) -> None:
    lake = filled(tmp_path / "lake")

    def meanwhile(table: str) -> None:
        if table == "scenes":
            vacuum(lake, days=0)

    with pytest.raises(InputError, match="snapshot 1 was removed"):
        make_release(lake, "v1", snapshot_id=1, advance=meanwhile)
    assert releases(lake) == []
    assert not (tmp_path / "lake" / "releases").exists()


@pytest.mark.whole
def test_a_name_that_is_taken_meanwhile_stays_with_who_was_first(tmp_path: Path) -> None:
    lake = filled(tmp_path / "lake")
    first = []

    def meanwhile(table: str) -> None:
        if not first:
            first.append(make_release(Lake.open(lake.address), "v1", snapshot_id=2, notes="first"))

    with pytest.raises(InputError, match="v1 is released already"):
        make_release(lake, "v1", snapshot_id=1, notes="second", advance=meanwhile)
    assert releases(lake) == first
    assert pq.read_table(tmp_path / "lake" / "releases" / "v1" / "snapshots.parquet").num_rows == 2


LAST = 2 * len(TABLES) + 6
"""Changes of files that a release makes: tables written, files moved in, the record, the lease."""


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize(
    "steps",
    [
        (5, len(TABLES) + 9, LAST - 2, LAST + 50),
        (1, len(TABLES), len(TABLES) + 2, LAST - 6, LAST - 2, LAST - 1, LAST, LAST + 50),
    ],
    ids=["some", "more"],
)
def test_a_release_that_dies_at_any_step_is_none_and_is_made_by_the_same_command(
    lake: Lake, folder: Path, tmp_path: Path, steps: tuple[int, ...]
) -> None:
    shutil.copytree(lake.address, tmp_path / "prepared")
    shutil.rmtree(tmp_path / "prepared" / "releases")
    command = [
        sys.executable,
        "-m",
        "tests.warehouse.release.release_load",
        str(tmp_path / "prepared"),
        str(tmp_path / "work"),
        *map(str, steps),
    ]
    done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, check=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    told = [json.loads(line) for line in done.stdout.splitlines()]
    assert [one["step"] for one in told] == list(steps)
    assert {one["codes"][0] for one in told} == {0, 9}, "it died, and did not where it had no such step"
    partial = 0
    expected = hashes(folder)
    for one in told:
        assert one["codes"][1:] == [0, 0, 0], (one, done.stderr)
        whole = "release.json" in one["before"]["files"]
        assert one["before"]["names"] == (["v1"] if whole else [])
        partial += bool(one["before"]["files"]) and not whole
        assert one["after"]["names"] == ["v1"]
        assert one["after"]["left"] == []
        assert not one["after"]["lease"]
        assert one["after"]["files"].keys() == expected.keys()
        same = {name for name, value in expected.items() if one["after"]["files"][name] == value}
        assert same >= expected.keys() - VOLATILE
    assert partial >= 2, "some died when some files were in their place"


@pytest.mark.whole
def test_the_commands_tell_what_they_do(lake: Lake, tmp_path: Path) -> None:
    shutil.copytree(lake.address, tmp_path / "lake")
    run = CliRunner().invoke
    where = ["--lake", str(tmp_path / "lake")]
    dry = json.loads(run(cli, ["release", "create", "v2", "--dry-run", "--json", *where]).output)
    assert not Path(dry["folder"]).exists()
    made = json.loads(run(cli, ["release", "create", "v2", "--notes", "two\nlines", "--snapshot", "1", "--json", *where]).output)
    assert Path(made["folder"], "release.json").is_file()
    assert (made["snapshot_id"], dry["snapshot_id"]) == (1, lake.snapshot().snapshot_id)
    assert {name: dry[name] for name in ("scenes", "objects", "assets")} == {
        name: getattr(release_of(lake, "v1"), name) for name in ("scenes", "objects", "assets")
    }
    listed = json.loads(run(cli, ["release", "list", "--json", *where]).output)["releases"]
    assert [one["name"] for one in listed] == ["v1", "v2"]
    lines = run(cli, ["release", "list", *where]).output.splitlines()
    assert [line.split()[0] for line in lines] == ["release", "v1", "v2"]
    assert run(cli, ["release", "show", "v2", *where]).output == without_head(Path(made["folder"], "README.md").read_text())
    assert json.loads(run(cli, ["release", "show", "v2", "--json", *where]).output)["files"]
    assert "no release 'v3'" in str(run(cli, ["release", "show", "v3", *where]).exception)
    assert digests(Lake.open(tmp_path / "lake").snapshot()) == digests(lake.snapshot())
