"""The comparison of readers with independent judges: it finds what differs, and finds nothing silent in a foreign corpus."""

from __future__ import annotations

import dataclasses
import io
import json
import os
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from rich.console import Console

from bench.files import report
from bench.files.comparison import ASPECTS, NOTED, Comparison, judges_differ, verdict_of
from bench.files.measure import CLAMP, MIRROR, REPEAT, ModelMeasure, ModelPart, measure
from bench.files.readers import READERS, FileReading
from bench.files.report import FilesBench, missing_judges, run_files_bench
from bench.files.tables import print_files
from flows.commands.bench import command
from schemas.errors import InputError
from tests.conftest import REPOSITORY

BOX = "".join(f"v {x} {y} {z} 0.8 0.4 0.2\n" for x in (0, 1) for y in (0, 1) for z in (0, 1))
FACES = "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
LIBRARY = next(reader for reader in READERS if reader.name == "library")


def read(folder: Path, name: str, text: str) -> FileReading:
    (folder / name).write_text(text)
    return LIBRARY.read(folder / name, folder)


@pytest.mark.parametrize(
    ("altered", "aspects"),
    [
        (BOX + FACES, None),
        (BOX.replace("0.8 0.4 0.2", "0.79 0.405 0.2") + FACES, None),
        (BOX + FACES.replace("f 2 6 8 4\n", "f 2 6 8\n"), "triangles"),
        (BOX.replace("v 1 1 1", "v 1 1 1.001") + FACES, "extents"),
        (BOX.replace("0.8 0.4 0.2", "0.8 0.5 0.2") + FACES, "color"),
        (BOX.replace("v 1", "v 2").replace("0.8", "0.1") + FACES.replace("f 1 2 4 3\n", ""), "triangles, extents, color"),
    ],
)
def test_a_file_that_was_altered_differs_and_an_equal_one_does_not(tmp_path: Path, altered: str, aspects: str | None) -> None:
    outcome, judged = read(tmp_path, "a.obj", BOX + FACES), read(tmp_path, "b.obj", altered).measure
    assert judged is not None
    compared = verdict_of(outcome, {"judge": judged})
    agreement = "triangles with judge; extents with judge; color with judge"
    assert (compared.verdict, compared.reason.partition(":")[0]) == (("agrees", agreement) if aspects is None else ("silent", aspects))
    assert compared.unchecked == ()


def test_only_a_note_on_what_differs_excuses_it(tmp_path: Path) -> None:
    outcome, judged = read(tmp_path, "a.obj", BOX + FACES), read(tmp_path, "b.obj", BOX.replace("0.8", "0.1") + FACES).measure
    assert judged is not None
    for note, verdict in (("a.obj: wood.png is missing, drawn without it", "noted"), ("a.obj: cameras: are not read", "silent")):
        assert verdict_of(dataclasses.replace(outcome, notes=(note,)), {"judge": judged}).verdict == verdict
    smaller = dataclasses.replace(judged, triangles=11)
    noted = dataclasses.replace(outcome, notes=("a.obj: wood.png is missing, drawn without it",))
    assert verdict_of(noted, {"judge": smaller}).verdict == "silent"


@pytest.mark.parametrize(
    "note",
    [
        "room.glb: points and lines: are not read: they have no surface", "a.obj: the outline of its image is thin",
        "room.glb: mesh a: its normalTexture has texture coordinates of its own: drawn without it", "a.obj: material cloud is read",
        "room.glb: mesh a: textures other than the base color of its vertex-colored surface are not read",
    ],
)  # fmt: skip
def test_notes_that_hold_a_word_of_another_do_not_excuse_a_difference(tmp_path: Path, note: str) -> None:
    outcome = dataclasses.replace(read(tmp_path, "a.obj", BOX + FACES), notes=(note,))
    assert outcome.measure is not None
    for change in ({"triangles": 3}, {"low": (-9.0, 0.0, 0.0)}, {"color": (0.0, 0.0, 0.0)}):
        assert verdict_of(outcome, {"judge": dataclasses.replace(outcome.measure, **change)}).verdict == "silent"


def test_a_surface_that_a_reader_estimates_is_noted(tmp_path: Path) -> None:
    note = "a.ply: a point cloud of 9 points: its surface is estimated, with voxels of 2 cm"
    outcome = dataclasses.replace(read(tmp_path, "a.obj", BOX + FACES), notes=("a.ply: psz: not used", note))
    judged = ModelMeasure(3, (-9.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    assert verdict_of(outcome, {"judge": judged}) == Comparison("noted", note)


def test_phrases_that_excuse_a_difference_are_those_of_notes() -> None:
    texts = "".join(path.read_text() for path in sorted((REPOSITORY / "tasks").rglob("*.py")))
    assert [phrase for phrases in NOTED.values() for phrase in phrases if phrase not in texts] == []


def test_one_judge_that_agrees_is_enough_and_none_is_not(tmp_path: Path) -> None:
    outcome = read(tmp_path, "a.obj", BOX + FACES)
    assert outcome.measure is not None
    other = dataclasses.replace(outcome.measure, triangles=3)
    compared = verdict_of(outcome, {"one": other, "two": outcome.measure})
    assert compared == Comparison("agrees", "triangles with two; extents with one, two; color with one, two")
    assert judges_differ({"one": other, "two": outcome.measure, "three": "refuses it"}) == ("triangles",)
    assert verdict_of(outcome, {"one": "refuses it"}) == Comparison("unjudged", "one refuses it", ASPECTS)
    assert verdict_of(read(tmp_path, "b.obj", BOX), {"one": other}).verdict == "refused"


def test_judges_decide_only_the_aspects_that_they_state(tmp_path: Path) -> None:
    outcome = read(tmp_path, "a.obj", BOX + FACES)
    assert outcome.measure is not None
    colorless = dataclasses.replace(outcome.measure, color=None)
    blue = dataclasses.replace(outcome.measure, color=(0.0, 0.0, 255.0))
    # A judge without colors cannot excuse a color that another judge sees otherwise.
    compared = verdict_of(outcome, {"assimp": colorless, "three.js": blue})
    assert (compared.verdict, compared.reason.partition(":")[0], compared.unchecked) == ("silent", "color", ())
    assert judges_differ({"assimp": colorless, "three.js": blue}) == ()
    lost = dataclasses.replace(outcome, measure=colorless)
    assert verdict_of(lost, {"assimp": colorless, "three.js": blue}).verdict == "silent"
    # A color that no judge states is reported as unchecked.
    compared = verdict_of(outcome, {"assimp": colorless})
    assert compared == Comparison("agrees", "triangles with assimp; extents with assimp; color unchecked", ("color",))
    # Each aspect may have its own judge.
    mixed = {"assimp": colorless, "three.js": dataclasses.replace(outcome.measure, triangles=3)}
    assert verdict_of(outcome, mixed).reason == "triangles with assimp; extents with assimp, three.js; color with three.js"


def test_aspects_that_no_judge_checked_are_counted_in_the_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.obj").write_text(BOX + FACES)
    read_measure = LIBRARY.read(tmp_path / "a.obj", tmp_path).measure
    assert read_measure is not None
    monkeypatch.setattr(report, "missing_judges", lambda: {"three.js": "get it"})
    monkeypatch.setattr(report, "by_assimp", lambda path: dataclasses.replace(read_measure, color=None))
    found = run_files_bench(FilesBench(tmp_path), lambda _: None)
    assert found["rows"]
    assert all((row["verdict"], row["unchecked"]) == ("agrees", ["color"]) for row in found["rows"])
    printed = io.StringIO()
    print_files(found, Console(file=printed, width=160))
    assert "color unchecked" in printed.getvalue()


def test_colors_are_means_of_light_over_the_area() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces, uv = np.array([[0, 1, 2], [0, 2, 3]]), square[:, :2]
    image = np.zeros((8, 8, 3), np.uint8)
    image[:, :4] = 255
    shown = measure([ModelPart(square, faces, np.ones(3), uv=uv, image=image)])
    # Half of the light is 188 of 255.
    assert shown.color == pytest.approx((188,) * 3, abs=1)
    for wrap, color in ((REPEAT, 255), (MIRROR, 0), (CLAMP, 0)):
        part = ModelPart(square, faces, np.ones(3), uv=uv * 0.4 + 1.05, image=image, wraps=(wrap, wrap))
        assert measure([part]).color == pytest.approx((color,) * 3), wrap
    flat = ModelPart(square * [1, 0, 0], faces, np.ones(3))
    assert measure([flat]) == ModelMeasure(0, (0.0,) * 3, (0.0,) * 3, None)
    assert measure([flat, ModelPart(square, faces)]).triangles == 2


def test_a_corpus_that_is_absent_is_told_in_one_line(tmp_path: Path) -> None:
    for folder, problem in ((tmp_path / "gone", "is not there"), (tmp_path, "holds no model files")):
        with pytest.raises(InputError) as caught:
            assert not FilesBench(folder).files
        assert problem in str(caught.value)
        assert "--corpus FOLDER" in str(caught.value)
        assert "\n" not in str(caught.value)
    assert isinstance(CliRunner().invoke(command, ["files", "--corpus", str(tmp_path / "gone")]).exception, InputError)


@pytest.mark.whole
@pytest.mark.browser
@pytest.mark.realdata
@pytest.mark.timeout(3600)
def test_no_file_of_the_corpus_is_read_otherwise_without_a_word() -> None:
    corpus = Path(os.environ.get("METASCENES_CORPUS") or REPOSITORY.parent / "shared" / "corpus")
    if not corpus.is_dir():
        pytest.skip(f"the corpus is not in {corpus}; set METASCENES_CORPUS to its folder")
    if missing := missing_judges():  # one alone cannot read every file
        pytest.skip(f"a judge is not on this machine: {missing}")
    found = run_files_bench(FilesBench(corpus), lambda _: None)
    silent = [row for row in found["rows"] if row["verdict"] in ("silent", "unjudged")]
    assert silent == []
    assert {row["reader"] for row in found["rows"]} >= {reader.name for reader in READERS}
    assert found["counts"]["agrees"] > found["counts"]["refused"]
    printed = io.StringIO()
    print_files(found, Console(file=printed, width=160))
    assert "silent differences" in printed.getvalue()
    assert json.dumps(found)
