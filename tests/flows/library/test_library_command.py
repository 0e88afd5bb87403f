"""`metascenes library`: added, listed, shown and removed, in a real lake."""

from __future__ import annotations

import io
import json
import os
import time
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from PIL import Image

from flows.cli import cli
from flows.library.adding import add_library, contents_of, planned_library, remove_library
from schemas.errors import InputError
from schemas.indexing import IndexedLibrary
from schemas.runs import StageRun
from schemas.tables import TABLES
from tasks.indexing import STAGE
from tasks.library.indexing import IndexConfig
from tests.flows.library.libraries import added, write_models
from tests.tasks.library.models import as_glb, chair
from warehouse.lake import Lake
from warehouse.tables.digest import digests
from warehouse.upkeep.inspection import inspect
from warehouse.upkeep.vacuum import vacuum


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    return write_models(tmp_path / "chairs")


def asked(*words: object) -> Result:
    return CliRunner().invoke(cli, list(map(str, words)), standalone_mode=False)


def told(*words: object) -> str:
    done = asked(*words)
    assert done.exception is None, done.output
    return done.stdout


@pytest.mark.whole
def test_a_folder_becomes_a_library_and_goes_again(tmp_path: Path, folder: Path) -> None:
    lake = tmp_path / "lake"
    at = ("--lake", lake, "--set", "indexing.views=2")
    assert "new" in told("library", "add", folder, "--dry-run", *at)
    assert not lake.exists()
    done = asked("library", "add", folder, "--processes", 1, *at)
    said = done.stdout
    assert "broken.glb: refused: content: is not a readable GLB" in done.stderr
    assert "b_chair.glb: the same bytes as a_chair.glb" in said
    assert said.splitlines()[-1] == "library chairs: 3 models, 1 of them duplicates, 1 file refused"
    assert told("library", "add", folder, "--processes", 1, *at).splitlines()[-1].endswith("unchanged")
    assert "unchanged, nothing to do" in told("library", "add", folder, "--dry-run", *at)
    listed = told("library", "list", "--lake", lake).splitlines()
    assert [line.split() for line in listed][1][:4] == ["chairs", "3", "1", "1"]
    models = json.loads(told("library", "list", "chairs", "--lake", lake, "--json"))["libraries"][0]["models"]
    assert [row["file"] for row in models] == ["a_chair.glb", "b_chair.glb", "c_chair.obj"]
    assert (models[0]["license"], models[0]["author"], models[2]["unit_m"]) == ("CC-BY-4.0", "A. Maker", 0.01)
    shown = told("library", "list", "chairs", "--lake", lake)
    assert "the same bytes as a_chair.glb" in shown
    assert "read as centimetres" in shown
    assert "would be removed" in told("library", "remove", "chairs", "--dry-run", "--lake", lake)
    assert "3 models removed" in told("library", "remove", "chairs", "--lake", lake)
    assert "no library yet" in told("library", "list", "--lake", lake)
    assert isinstance(asked("library", "remove", "chairs", "--lake", lake).exception, InputError)
    assert "library chairs: 3 models" in told("library", "add", folder, "--processes", 1, *at), "a removed one is new again"


def test_the_whole_answer_is_json(tmp_path: Path, folder: Path) -> None:
    said: dict[str, Any] = json.loads(
        told("library", "add", folder, "--name", "mine", "--processes", 1, "--lake", tmp_path / "lake", "--json")
    )
    assert (said["library"], said["state"], said["refused_count"]) == ("mine", "new", 1)
    assert said["refused"][0]["file"] == "broken.glb"
    rows = Lake.open(tmp_path / "lake").snapshot().rows(IndexedLibrary)
    assert [row.content for row in rows] == [said["content"]]


def test_contact_sheets_show_every_model(tmp_path: Path, folder: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    models = added(lake, folder).models
    told("library", "list", "--pictures", tmp_path / "sheet.png", "--lake", lake.address)
    sheet = Image.open(tmp_path / "sheet.png").convert("RGB")
    assert sheet.size == (3 * 96, 96 + 2 * 12)
    for number, model in enumerate(models):
        picture = Image.open(io.BytesIO(lake.blobs[model.thumbnail_blob])).convert("RGB").resize((96, 96))
        assert sheet.crop((96 * number, 0, 96 * (number + 1), 96)).tobytes() == picture.tobytes()
    told("library", "list", "chairs", "--pictures", tmp_path / "sheet.html", "--lake", lake.address)
    page = (tmp_path / "sheet.html").read_text()
    assert page.count("<figure>") == page.count("data:image/png;base64,") == 3
    assert 'src="http' not in page
    with pytest.raises(InputError, match=r"ends in \.gif"):
        CliRunner().invoke(
            cli, ["library", "list", "--pictures", "a.gif", "--lake", lake.address], standalone_mode=False, catch_exceptions=False
        )


@pytest.mark.whole
def test_the_same_folder_again_brings_what_changed(tmp_path: Path, folder: Path) -> None:
    lake, whole = Lake.open(tmp_path / "lake"), Lake.open(tmp_path / "whole")
    first = added(lake, folder)
    (folder / "b_chair.glb").unlink()
    (folder / "d_chair.glb").write_bytes(as_glb(chair(7)))
    (folder / "broken.glb").write_bytes(as_glb(chair(8)))
    planned = planned_library(lake, folder, "chairs", (), IndexConfig(), 1)
    assert planned.why == "files changed"
    second = add_library(lake, planned)
    assert [row.file for row in second.models] == ["a_chair.glb", "broken.glb", "c_chair.obj", "d_chair.glb"]
    assert (second.refused, second.library.content != first.library.content) == ((), True)
    assert {row.file: row for row in second.models}["a_chair.glb"] == first.models[0]
    added(whole, folder)
    tables = STAGE.writes
    mine, theirs = digests(lake.snapshot()), digests(whole.snapshot())
    assert {name: mine[name] for name in tables} == {name: theirs[name] for name in tables}
    assert inspect(lake).errors == ()


def test_libraries_stand_side_by_side_and_vacuum_takes_what_nothing_names(tmp_path: Path, folder: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    first, other = added(lake, folder), added(lake, folder, "others")
    assert [row.file for row in first.models] == [row.file for row in other.models]
    assert first.library.content == other.library.content
    with pytest.raises(InputError, match="there are: chairs, others"):
        contents_of(lake.snapshot(), "third")
    remove_library(lake, "chairs")
    assert contents_of(lake.snapshot(), "others").models == other.models
    remove_library(lake, "others")
    for table in STAGE.writes:
        assert lake.snapshot().rows(TABLES[table].record) == []
    assert inspect(lake).errors == ()
    runs = [run for run in lake.snapshot().rows(StageRun) if run.stage == STAGE.name]
    assert [run.outcome for run in runs] == ["done"] * 4
    before = list(lake.blobs)
    assert before
    for name in before:  # put three days ago
        os.utime(lake.blobs.path(name), (time.time() - 3 * 86_400,) * 2)
    assert vacuum(lake, days=0.0).blobs == len(before)
    assert list(Lake.open(lake.address).blobs) == []


def test_a_folder_that_nobody_can_use_is_one_line(tmp_path: Path, folder: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    with pytest.raises(InputError, match="is no name"):
        planned_library(lake, folder, "a/b", (), IndexConfig(), 1)
    with pytest.raises(InputError, match="is no folder"):
        planned_library(lake, tmp_path / "nowhere", "", (), IndexConfig(), 1)
    (tmp_path / "odd.json").write_text("{")
    with pytest.raises(InputError, match=r"^odd.json: content"):
        planned_library(lake, folder, "", (tmp_path / "odd.json",), IndexConfig(), 1)


def test_what_a_dead_process_staged_is_taken_in_and_not_made_again(tmp_path: Path, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from flows.library import adding

    lake = Lake.open(tmp_path / "lake")
    planned = planned_library(lake, folder, "chairs", (), IndexConfig(), 1)
    assert adding.execute(planned.job).error is None
    assert lake.snapshot().rows(IndexedLibrary) == []
    again = planned_library(lake, folder, "chairs", (), IndexConfig(), 1)
    assert again.is_known
    monkeypatch.setattr(adding, "execute", lambda *_: pytest.fail("indexed again"))
    assert len(add_library(lake, again).models) == 3


def test_two_that_staged_the_same_library_leave_one(tmp_path: Path, folder: Path) -> None:
    from flows.library.adding import execute

    lake = Lake.open(tmp_path / "lake")
    execute(planned_library(lake, folder, "chairs", (), IndexConfig(), 1).job)
    (folder / "a_chair.glb").unlink()
    execute(planned_library(lake, folder, "chairs", (), IndexConfig(), 1).job)
    lake.commit()
    assert [row.file for row in contents_of(lake.snapshot(), "chairs").models] == ["b_chair.glb", "c_chair.obj"]
    assert inspect(lake).errors == ()
