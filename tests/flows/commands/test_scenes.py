"""`metascenes scenes`: what it lists of a lake, which of it, and what it says of words that match nothing."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from schemas.capture import Instance, Scene, Shell
from schemas.optimization import Certificate
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake
from warehouse.questions.sql import query

KINDS = {"demo/room_1": "bedroom", "demo/room_2": "kitchen", "other/room_1": "bedroom"}


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """Three scenes, of which the captions of one failed, and a scan that could not be captured."""
    made = Lake.open(tmp_path_factory.mktemp("lake"))
    blob = made.blobs.put(b"mesh", "glb")
    for number, (scene, kind) in enumerate(KINDS.items()):
        rows = {
            "scenes": [sample(Scene, scene_id=scene, dataset=scene.split("/")[0], mesh_blob=blob)],
            "shells": [sample(Shell, scene_id=scene, room_type=kind)],
            "instances": [
                sample(Instance, scene_id=scene, instance_id=f"{i:04d}", is_structure=False, points_blob=blob) for i in range(number)
            ],
        }
        made.stage_rows(stage_run(scene, "capture", fingerprint(number), seconds=2.0), rows)
    failed = {"outcome": "failed", "error_kind": "input"}
    made.stage_rows(stage_run("demo/room_2", "captions", fingerprint(7), error="captions: no words", **failed), {})
    made.stage_rows(stage_run("demo/torn", "capture", fingerprint(8), error="mesh.ply: is torn", **failed), {})
    made.commit()
    return made


def said(capsys: pytest.CaptureFixture[str], lake: Lake, *words: str) -> tuple[int, str, str]:
    from flows.cli import main

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["metascenes", "scenes", *words, "--lake", lake.address])
        with pytest.raises(SystemExit) as end:
            main()
    told = capsys.readouterr()
    return int(end.value.code or 0), told.out, told.err


def test_the_list_has_a_line_for_each_scene_and_for_scans_that_failed(capsys: pytest.CaptureFixture[str], lake: Lake) -> None:
    code, out, err = said(capsys, lake)
    assert (code, err) == (0, "")
    head, *lines, total = out.splitlines()
    assert head.split() == ["scene", "room", "type", "dataset", "format", "objects", "done", "failed", "seconds", "stable"]
    assert [line.split() for line in lines] == [
        ["demo/room_1", "bedroom", "demo", "scannet", "0", "1", "0", "2.0", "-"],
        ["demo/room_2", "kitchen", "demo", "scannet", "1", "1", "1", "2.0", "-", "captions"],
        ["demo/torn", "-", "demo", "-", "-", "0", "1", "0.0", "-", "capture"],
        ["other/room_1", "bedroom", "other", "scannet", "2", "1", "0", "2.0", "-"],
    ]
    assert total == "4 scenes, 2 failed"


@pytest.mark.parametrize(
    ("words", "scenes"),
    [
        (["--failed"], ["demo/room_2", "demo/torn"]),
        (["--room-type", "bedroom"], ["demo/room_1", "other/room_1"]),
        (["--room-type", "bedroom", "--room-type", "kitchen", "--dataset", "demo"], ["demo/room_1", "demo/room_2"]),
        (["room_1"], ["demo/room_1", "other/room_1"]),
        (["demo/*"], ["demo/room_1", "demo/room_2", "demo/torn"]),
        (["room_?", "--failed"], ["demo/room_2"]),
        (["torn", "other/room_1"], ["demo/torn", "other/room_1"]),
        (["room_1", "--failed"], []),
    ],
)
def test_filters_take_what_meets_all_of_them(capsys: pytest.CaptureFixture[str], lake: Lake, words: list[str], scenes: list[str]) -> None:
    code, out, err = said(capsys, lake, *words, "--json")
    assert (code, err) == (0, "")
    told = json.loads(out)
    every = query(lake.snapshot(), "FROM scene_overview").to_pylist()
    assert told == {"snapshot_id": 1, "scenes": [row for row in every if row["scene_id"] in scenes]}
    assert [row["scene_id"] for row in told["scenes"]] == scenes
    text = said(capsys, lake, *words)[1].splitlines()
    assert [line.split()[0] for line in text[1:-1]] == scenes
    failed = sum(row["stages_failed"] > 0 for row in told["scenes"])
    assert text[-1] == f"{len(scenes)} scene{'' if len(scenes) == 1 else 's'} of 4, {failed} failed"


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["rom_1"], "did you mean room_1?"),
        (["dmeo/torn"], "did you mean demo/torn?"),
        (["--room-type", "Bedrom"], "did you mean bedroom?"),
        (["--dataset", "othr"], "did you mean other?"),
        (["nothing*like"], "`metascenes scenes` lists all"),
    ],
)
def test_what_matches_nothing_is_one_line_with_what_was_meant(
    capsys: pytest.CaptureFixture[str], lake: Lake, words: list[str], hint: str
) -> None:
    code, out, err = said(capsys, lake, *words)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert words[-1] in err
    assert hint in err


def test_the_stable_share_is_that_of_the_free_objects(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    made = Lake.open(tmp_path / "lake")
    scene = sample(Scene, scene_id="demo/a", mesh_blob=made.blobs.put(b"mesh", "glb"))
    made.stage_rows(stage_run("demo/a", "capture", fingerprint(1)), {"scenes": [scene]})
    judged = [(True, True), (True, False), (False, True), (True, False)]  # fixed ones count for nothing
    certificates = [
        sample(Certificate, scene_id="demo/a", instance_id=f"{i:04d}", engine="mujoco", is_stable_5cm=stable, is_fixed=fixed)
        for i, (stable, fixed) in enumerate(judged)
    ]
    upstream = (f"capture={fingerprint(1)}",)
    made.stage_rows(stage_run("demo/a", "optimization", fingerprint(2), upstream=upstream), {"certificates": certificates})
    made.commit()
    assert said(capsys, made)[1].splitlines()[1].split()[-1] == "100%"
