"""Runs that take candidates from a library: of the lake by name, or of a folder; the same rows, and computed again when it changed."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from flows.library.adding import remove_library
from flows.outputs.explain import explain, settings_of
from flows.run.configuration import Configuration, configure
from flows.run.fingerprints import FileHashes
from flows.run.libraries import NamedLibrary, given_library, library_input
from flows.run.plan import ScenePlan, make_plan
from flows.run.scene import job_of
from flows.worker import execute
from schemas.candidates import Asset, Candidate
from schemas.errors import InputError
from schemas.indexing import LibraryModel
from schemas.runs import StageRun
from tasks.capture.formats import find_scans
from tasks.capture.scan import Scan
from tasks.lineage.outline import outline
from tests.capture_scans import OBJECTS, box_room, write_scannet
from tests.flows.library.libraries import added, write_models
from tests.samples import lasting
from warehouse.lake import Lake

pytestmark = pytest.mark.whole

SETTINGS = ('candidates.slots=[{provider={kind="library"}}, {provider={kind="library", k=2}}, {provider={kind="scan_crop"}}]',)
STAGES = ("capture", "captions", "candidates")


@pytest.fixture(scope="module")
def scan(tmp_path_factory: pytest.TempPathFactory) -> Scan:
    folder = tmp_path_factory.mktemp("scanned")
    write_scannet(folder / "scene0000_00", box_room(OBJECTS[1:2], cameras=8))
    return find_scans(folder)[0][0]


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    with pytest.MonkeyPatch.context() as patch:
        place = tmp_path_factory.mktemp("cache")
        patch.setenv("METASCENES_CACHE", str(place))
        yield place


@pytest.fixture
def folder(tmp_path: Path, cache: Path) -> Path:
    return write_models(tmp_path / "models")


def planned(lake: Lake, scan: Scan, configuration: Configuration) -> ScenePlan:
    (scene,) = make_plan(lake, [scan], (), configuration).scenes
    return scene


def candidates_of(lake: Lake, scan: Scan, library: Path | None) -> tuple[list[Candidate], list[Asset], StageRun]:
    """Rows after what is to be done of the first stages, committed."""
    configuration = configure(settings=SETTINGS, library=library)
    scene = planned(lake, scan, configuration)
    runs = [execute(job_of(lake, scene, step, configuration)) for step in scene.todo if step.stage in STAGES]
    assert [run.error for run in runs] == [None] * len(runs)
    lake.commit()
    reader = lake.snapshot()
    return reader.rows(Candidate, scan.scene_id), reader.rows(Asset), runs[-1]


def todo(lake: Lake, scan: Scan, library: Path | None) -> dict[str, str]:
    scene = planned(lake, scan, configure(settings=SETTINGS, library=library))
    return {step.stage: step.why for step in scene.todo if step.stage in STAGES}


def bare(rows: Sequence[Candidate]) -> list[Candidate]:
    return [dataclasses.replace(lasting(row), library=None) for row in rows]


def test_a_library_of_the_lake_gives_what_its_folder_gives(tmp_path: Path, scan: Scan, folder: Path) -> None:
    by_name, by_folder = Lake.open(tmp_path / "named"), Lake.open(tmp_path / "folder")
    models: Mapping[str, LibraryModel] = {row.file: row for row in added(by_name, folder).models}
    first, offered, named_run = candidates_of(by_name, scan, Path("chairs"))
    other, assets, folder_run = candidates_of(by_folder, scan, folder)
    assert bare(first) == bare(other)
    assert offered == assets
    chosen = [row for row in first if row.provider == "library"]
    assert [row.outcome for row in chosen] == ["filled"] * 2
    assert {row.library for row in chosen} == {"chairs"}
    assert {row.library_file for row in chosen} == {"a_chair.glb", "c_chair.obj"}
    assert sorted((row.library_score or 0 for row in chosen), reverse=True) == [row.library_score for row in chosen]
    for row in chosen:
        assert models[str(row.library_file)].asset_id == row.asset_id
        assert by_name.blobs[f"{row.asset_id}.glb"] == by_folder.blobs[f"{row.asset_id}.glb"]
    terms = {asset.name: (asset.license, asset.author, asset.source) for asset in offered if asset.provider == "library"}
    assert terms["a_chair"] == ("CC-BY-4.0", "A. Maker", "https://example.org/a")
    assert any(line.startswith("library: broken.glb: content: is not a readable GLB") for line in folder_run.degradations)
    assert named_run.degradations == ()


def test_the_folder_may_go_once_it_is_indexed(tmp_path: Path, scan: Scan, folder: Path) -> None:
    import shutil

    lake = Lake.open(tmp_path / "lake")
    added(lake, folder)
    shutil.rmtree(folder)
    rows, _, _ = candidates_of(lake, scan, Path("chairs"))
    assert [row.outcome for row in rows[:2]] == ["filled"] * 2


def test_candidates_are_computed_again_when_what_they_take_changed(tmp_path: Path, scan: Scan, folder: Path) -> None:
    lake, name = Lake.open(tmp_path / "lake"), Path("chairs")
    added(lake, folder)
    candidates_of(lake, scan, name)
    assert todo(lake, scan, name) == {}
    (folder / "bad.glb").write_bytes(b"glTF")
    assert len(added(lake, folder).refused) == 2
    assert todo(lake, scan, name) == {}, "a file that is refused is no candidate"
    (folder / "c_chair.obj").unlink()
    added(lake, folder)
    assert todo(lake, scan, name) == {"candidates": "library changed"}
    rows, _, _ = candidates_of(lake, scan, name)
    assert [(row.provider, row.outcome, row.library_file) for row in rows[:2]] == [
        ("library", "filled", "a_chair.glb"),
        ("library", "empty", None),
    ]
    remove_library(lake, "chairs")
    with pytest.raises(InputError, match=r"chairs: library: is neither a library of .* nor a folder"):
        todo(lake, scan, name)
    assert todo(lake, scan, None) == {"candidates": "library changed"}


def test_a_name_means_the_library_of_the_lake_before_a_folder(
    tmp_path: Path, scan: Scan, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lake = Lake.open(tmp_path / "lake")
    monkeypatch.chdir(tmp_path)
    candidates_of(lake, scan, Path("models"))
    added(lake, folder, "models")
    assert todo(lake, scan, Path("models")) == {"candidates": "library changed"}
    assert todo(lake, scan, tmp_path / "models") == {}, "more of its path tells the folder"
    with pytest.raises(InputError, match="is not a folder"):
        configure(library=Path("not/there"))


def test_a_job_gets_the_library_that_it_was_planned_with_or_is_lost(tmp_path: Path, scan: Scan, folder: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    before = added(lake, folder).library
    configuration = configure(settings=SETTINGS, library=Path("chairs"))
    scene = planned(lake, scan, configuration)
    jobs = [job_of(lake, scene, step, configuration) for step in scene.todo if step.stage in STAGES]
    assert dict(jobs[-1].outside)["library"] == NamedLibrary("chairs", before.content)
    for job in jobs[:-1]:
        assert execute(job).error is None
    (folder / "a_chair.glb").unlink()
    (folder / "b_chair.glb").unlink()
    added(lake, folder)
    late = dataclasses.replace(jobs[-1], snapshot_id=None, outside=(("library", NamedLibrary("chairs", "0" * 64)),))
    run = execute(late)
    assert (run.outcome, run.error_kind) == ("lost", "lost")
    assert "it was indexed again or removed" in str(run.error)
    assert execute(jobs[-1]).error is None, "the snapshot that it was planned from is there"
    rows: list[Candidate] = lake.staged_rows("candidates", scan.scene_id, jobs[-1].fingerprint) or []
    assert "a_chair.glb" in {row.library_file for row in rows}


def test_explain_names_library_file_and_license(tmp_path: Path, scan: Scan, folder: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    added(lake, folder)
    rows, _, _ = candidates_of(lake, scan, Path("chairs"))
    asset_id = next(str(row.asset_id) for row in rows if row.library_file == "a_chair.glb")
    lineage = explain(lake, asset_id)
    assert lineage.problems == ()
    text = outline(lineage, settings_of)
    for words in ("library chairs, file a_chair.glb", "license CC-BY-4.0", "author A. Maker", "https://example.org/a"):
        assert words in text
    remove_library(lake, "chairs")
    gone = explain(lake, asset_id)
    assert gone.problems == ()
    assert "the library was removed or indexed again" in outline(gone, settings_of)


def test_views_say_what_was_taken_and_what_was_refused(tmp_path: Path, scan: Scan, folder: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    added(lake, folder)
    rows, _, _ = candidates_of(lake, scan, Path("chairs"))
    taken = [row for row in rows if row.library is not None]
    assert asked(lake, "library_usage") == [
        {
            "library": "chairs", "category": "chair", "models": 2, "noncommercial_models": 0, "offered": 2, "candidates": len(taken),
            "chosen": 0, "scenes": 1, "mean_score": pytest.approx(sum(row.library_score or 0 for row in taken) / len(taken)),
        }
    ]  # fmt: skip
    (refusal,) = asked(lake, "library_refusals")
    assert (refusal["field"], refusal["files"], refusal["example"], refusal["share"]) == ("content", 1, "broken.glb", 0.25)


def asked(lake: Lake, view: str) -> list[dict[str, Any]]:
    with lake.snapshot().connect() as connection:
        rows: list[dict[str, Any]] = connection.sql(f"FROM {view}").to_arrow_table().to_pylist()
    return rows


def test_slots_without_a_library_say_so(tmp_path: Path, scan: Scan, cache: Path) -> None:
    rows, _, run = candidates_of(Lake.open(tmp_path / "lake"), scan, None)
    assert [(row.outcome, row.reason) for row in rows[:2]] == [("empty", "no library given")] * 2
    assert json.dumps(run.degradations).count("no library given") == 1


def test_a_path_is_a_folder_even_where_the_lake_has_a_library_of_that_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake = Lake.open(tmp_path / "lake")
    added(lake, write_models(tmp_path / "chairs"))
    monkeypatch.chdir(tmp_path)
    assert library_input(lake, given_library("chairs"), FileHashes()).startswith("chairs@")
    by_path = {library_input(lake, given_library(text), FileHashes()) for text in ("./chairs", "chairs/", str(tmp_path / "chairs"))}
    assert len(by_path) == 1
    assert "@" not in by_path.pop()
