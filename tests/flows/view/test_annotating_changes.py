"""The lake changes while a batch is served: nothing is saved but what was shown, and nothing of what was erased comes back."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from flows.cli import cli
from flows.view import bundle
from schemas.annotation import Annotation
from schemas.candidates import Asset, Candidate
from schemas.selection import Selection
from tests.annotated import SCENES
from tests.flows.view.batches import Desk, stand_in
from tests.samples import fingerprint, stage_run
from warehouse.lake import Lake


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Desk:
    monkeypatch.setattr(bundle, "BUILT", stand_in(tmp_path / "built"))
    return Desk(tmp_path)


def run_again(lake: Lake, scene: str, change: Callable[[Any], Any]) -> None:
    """A run that finds other candidates, or aligns them otherwise: `change` of every row."""
    reader = lake.snapshot()
    selections = [change(row) for row in reader.rows(Selection, scene)]
    candidates = [change(row) for row in reader.rows(Candidate, scene)]
    made: dict[str, dict[str, list[Any]]] = {
        "candidates": {"candidates": candidates, "assets": reader.rows(Asset)}, "selection": {"selections": selections},
    }  # fmt: skip
    for stage, rows in made.items():
        lake.stage_rows(stage_run(scene, stage, fingerprint(scene, stage, "again"), at=9), rows)
    assert lake.commit(scenes=[scene]) is not None


def in_other_slots(instance_id: str) -> Callable[[Any], Any]:
    """Slots of an object the other way round."""
    return lambda row: dataclasses.replace(row, slot=4 - row.slot) if row.instance_id == instance_id else row


def moved(instance_id: str) -> Callable[[Any], Any]:
    """An object's candidates aligned elsewhere."""

    def change(row: Any) -> Any:
        is_moved = isinstance(row, Selection) and row.instance_id == instance_id
        return dataclasses.replace(row, scale=(2.0, 2.0, 2.0)) if is_moved else row

    return change


@pytest.mark.parametrize("change", [in_other_slots, moved])
def test_nothing_is_saved_but_what_was_shown(desk: Desk, change: Callable[[str], Callable[[Any], Any]]) -> None:
    ada = desk.client("ada")
    rows = [row for row in ada.get("/api/work").json()["objects"] if row["scene_id"] == SCENES[0]]
    first, second = rows[0], rows[1]
    shown = first["candidates"][0]["asset_id"]
    run_again(desk.lake, SCENES[0], change(first["instance_id"]))
    for choice in (1, shown, None):
        refused = ada.post(f"/api/answers/{first['key']}", json={"choice": choice})
        assert refused.status_code == 409
        assert refused.json() == {"error": "the scene's candidates have changed since the server was started; start it again"}
    assert desk.lake.snapshot().rows(Annotation) == []
    assert ada.post(f"/api/answers/{second['key']}", json={"choice": 1}).status_code == 200, "its candidates are as shown"
    (row,) = desk.lake.snapshot().rows(Annotation)
    assert (row.instance_id, row.choice) == (second["instance_id"], second["candidates"][0]["asset_id"])


def test_an_answer_is_taken_back_whatever_changed(desk: Desk) -> None:
    ada = desk.client("ada")
    key = desk.own("ada")
    assert ada.post(f"/api/answers/{key}", json={"choice": 1}).status_code == 200
    scene, _, instance = key.rpartition("/")
    run_again(desk.lake, scene, in_other_slots(instance))
    assert ada.post(f"/api/answers/{key}", json={"withdrawn": True}).json()["revision"] == 2


@pytest.mark.usefixtures("own_machine")
def test_what_was_erased_does_not_come_back(desk: Desk) -> None:
    ada, key = desk.client("ada"), desk.own("ada")
    scene = key.rpartition("/")[0]
    (kept, *_) = [row["key"] for row in ada.get("/api/work").json()["objects"] if row["scene_id"] != scene]
    assert ada.put(f"/api/drafts/{key}", json={"choice": 1, "edit": 1, "page": "p"}).status_code == 200
    erased = CliRunner().invoke(cli, ["lake", "erase", scene, "--yes", "--lake", desk.lake.address, "--json"])
    assert json.loads(erased.output)["proof"]["hits"] == []
    for method, path in (("PUT", "drafts"), ("DELETE", "drafts"), ("POST", "answers"), ("POST", "figures"), ("POST", "settle")):
        body = {"choice": 1, "edit": 2, "page": "p"}
        refused = ada.request(method, f"/api/{path}/{key}", json=None if method == "DELETE" else body)
        assert (refused.status_code, refused.json()) == (404, {"error": "this object is in the lake no more"}), (method, path)
    assert ada.put(f"/api/drafts/{kept}", json={"choice": 1, "edit": 1}).status_code == 200
    assert all(scene.encode() not in path.read_bytes() for path in Path(desk.lake.address).rglob("*") if path.is_file())


def test_drafts_name_what_was_shown_whatever_its_slot_is_later(desk: Desk) -> None:
    ada = desk.client("ada")
    row = ada.get("/api/work").json()["objects"][0]
    assets = {offer["slot"]: offer["asset_id"] for offer in row["candidates"]}
    for edit, body in enumerate([{"choice": 2, "ranking": [2, 3]}, {"choice": assets[2], "ranking": [assets[2], 3]}], 1):
        assert ada.put(f"/api/drafts/{row['key']}", json=body | {"edit": edit}).status_code == 200
        draft = ada.get("/api/work").json()["objects"][0]["draft"]
        assert (draft["choice"], draft["ranking"]) == (assets[2], [assets[2], assets[3]])
    assert ada.put(f"/api/drafts/{row['key']}", json={"choice": None, "edit": 3}).status_code == 200
    assert ada.get("/api/work").json()["objects"][0]["draft"]["choice"] is None
