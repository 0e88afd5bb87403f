"""Pages that are open while a scene is erased: no address that answered before gives the scene's bytes again, and lists leave it out."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from fastapi.testclient import TestClient

from flows.view import bundle
from flows.view.annotating.drafts import Drafts
from flows.view.application import application, scene_routes
from flows.view.scene import Scenes
from schemas.errors import InputError
from tests.annotated import SCENES as ROOMS
from tests.conftest import REPOSITORY
from tests.flows.view.batches import BATCH, LAUNCH, Desk, Guest, asked_lake, serving, stand_in
from tests.flows.view.lakes import SCENES, shown_lake
from tests.samples import fingerprint, stage_run
from warehouse.lake import Lake
from warehouse.release import make_release
from warehouse.upkeep.erasure import erase

pytestmark = [pytest.mark.whole, pytest.mark.usefixtures("own_machine")]

Ask = Callable[[str], Any]
GONE, STAYS = SCENES


def addresses_of(value: Any) -> Iterator[str]:
    """Addresses that a page finds in a document: those that are written out, and blobs by name."""
    if isinstance(value, dict):
        for item in value.values():
            yield from addresses_of(item)
    elif isinstance(value, list):
        for item in value:
            yield from addresses_of(item)
    elif isinstance(value, str) and re.fullmatch(r"[0-9a-f]{64}\.\w+", value):
        yield f"/blobs/{value}"
    elif isinstance(value, str) and value.startswith(("/api/", "/blobs/", "/points/", "/photos/", "/thumbnails/")):
        yield value


def open_scene(ask: Ask, scene: str) -> dict[str, bytes]:
    """Answers to all that the page asks of a scene, by address."""
    address = f"/api/scenes/{scene}"
    document = ask(address).json()
    addresses = {address, *addresses_of(document)}
    addresses |= {f"{address}/objects/{row['id']}" for row in document["objects"]}
    for frame in document["frames"]["rows"]:
        addresses |= {f"{address}/frames/{frame['id']}", f"{address}/frames/{frame['id']}/picture"}
    answers = {name: ask(name) for name in sorted(addresses)}
    assert {answer.status_code for answer in answers.values()} == {200}
    return {name: answer.content for name, answer in answers.items()}


def check_gone(ask: Ask, before: dict[str, bytes], shared: set[str]) -> None:
    """No address answers with bytes of the scene but those that other scenes have; a refusal is one line."""
    for address in before.keys() - shared:
        answer = ask(address)
        assert answer.status_code in (404, 410), address
        assert answer.content != before[address]
        assert "\n" not in answer.json()["error"]


@pytest.fixture
def view(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Ask]:
    """Opens the viewer's application on a lake; what asks it."""
    monkeypatch.setattr(bundle, "BUILT", stand_in(tmp_path / "built"))

    def opened(lake: Lake, **choice: Any) -> Ask:
        return TestClient(application([scene_routes(Scenes(lake, **choice))])).get

    return opened


@pytest.mark.parametrize("shown", ["last", pytest.param("snapshot", marks=pytest.mark.slow), "release"])
@pytest.mark.parametrize("others", [pytest.param("idle", marks=pytest.mark.slow), "commit before"])
def test_an_open_viewer_forgets_an_erased_scene(tmp_path: Path, view: Callable[..., Ask], shown: str, others: str) -> None:
    lake = shown_lake(tmp_path)
    if shown == "release":
        make_release(lake, "v1")
    choice = {"snapshot": {"snapshot_id": 1}, "release": {"snapshot_id": 1, "release": "v1"}}.get(shown, {})
    ask = view(lake, **choice)
    before, other = open_scene(ask, GONE), open_scene(ask, STAYS)
    if others == "commit before":  # the snapshot that is shown is not the last one, and an erasure drops it unless it is released
        lake.stage_rows(stage_run(STAYS, "fidelity", fingerprint("x"), at=9, outcome="failed", error="full", error_kind="input"))
        lake.commit("later")
        assert ask(f"/api/scenes/{GONE}").status_code == 200, "a commit is no erasure"
    erase(lake, GONE)
    is_dropped = shown == "snapshot" and others == "commit before"
    check_gone(ask, before, set() if is_dropped else before.keys() & other.keys())
    listed = ask("/api/scenes")
    if is_dropped:
        assert "there is no snapshot 1" in listed.json()["error"]
        return
    assert (listed.status_code, [row["id"] for row in listed.json()["scenes"]], listed.json()["first"]) == (200, [STAYS], STAYS)
    assert {address: ask(address).content for address in other if "/blobs/" in address} == {
        address: data for address, data in other.items() if "/blobs/" in address
    }, "a page of another scene that is open gets its files without being loaded again"
    assert open_scene(ask, STAYS).keys() == other.keys()


def test_a_browser_is_not_told_that_its_copy_is_right(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundle, "BUILT", stand_in(tmp_path / "built"))
    lake = shown_lake(tmp_path)
    client = TestClient(application([scene_routes(Scenes(lake))]))
    blobs = [address for address in open_scene(client.get, GONE) if "/blobs/" in address]
    tags = {address: {"if-none-match": client.get(address).headers["etag"]} for address in blobs}
    assert {client.get(address, headers=tags[address]).status_code for address in blobs} == {304}
    for scene in SCENES:
        erase(lake, scene)
    assert {client.get(address, headers=tags[address]).status_code for address in blobs} == {404}
    assert client.get("/api/scenes").json() == {"error": f"{lake.address}: scenes: the lake has no scene; see `metascenes status`"}


def test_a_scene_that_is_read_while_it_is_erased_is_not_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A request that began before the erasure ends after it: what it read must not answer the next one."""
    lake = shown_lake(tmp_path)
    scenes = Scenes(lake)
    real = scenes._show

    def show(scene_id: str) -> Any:
        shown = real(scene_id)
        erase(lake, GONE)
        return shown

    monkeypatch.setattr(scenes, "_show", show)
    scenes.shown(GONE)
    monkeypatch.setattr(scenes, "_show", real)
    scenes.refresh()
    with pytest.raises(InputError, match="there is no such scene"):
        scenes.shown(GONE)


def test_a_look_at_an_idle_lake_is_one_listing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lake = shown_lake(tmp_path)
    scenes = Scenes(lake)
    monkeypatch.setattr(lake, "snapshot", lambda *_: pytest.fail("read a snapshot"))
    calls: list[str] = []
    names = lake.storage.names
    monkeypatch.setattr(lake.storage, "names", lambda *arguments: calls.append(arguments[0]) or names(*arguments))
    for _ in range(3):
        scenes.refresh()
    assert calls == ["tables/snapshots/_delta_log"] * 3


def open_batch(ask: Ask) -> dict[str, dict[str, bytes]]:
    """Answers by address to all that an annotator's page asks of objects and rooms, by scene."""
    work = ask("/api/work").json()
    answers: dict[str, dict[str, bytes]] = {}
    for row in work["objects"]:
        for address in addresses_of(row):
            answers.setdefault(row["scene_id"], {})[address] = ask(address).content
    for scene in answers:
        answers[scene] |= open_scene(ask, scene)
    return answers


def test_an_annotation_page_forgets_an_erased_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundle, "BUILT", stand_in(tmp_path / "built"))
    desk = Desk(tmp_path)
    ada = desk.client("ada")
    keys = [row["key"] for row in ada.get("/api/work").json()["objects"]]
    gone, stays = ROOMS
    own = {scene: next(key for key in keys if key.startswith(f"{scene}/")) for scene in ROOMS}
    for scene in ROOMS:
        assert ada.post(f"/api/figures/{own[scene]}", json={"choice": 1}).status_code == 200
        assert ada.put(f"/api/drafts/{own[scene]}", json={"choice": 1, "edit": 1}).status_code == 200
    before = {row["key"]: [*addresses_of(row)] for row in ada.get("/api/work").json()["objects"]}
    files = {address: ada.get(address).content for row in before.values() for address in row}
    erase(desk.lake, gone)
    work = ada.get("/api/work").json()
    assert {row["scene_id"] for row in work["objects"]} == {stays} == {row["scene_id"] for row in work["scenes"]}
    shared = {address for key in before if key.startswith(f"{stays}/") for address in before[key]}
    check_gone(ada.get, files, shared)
    assert all(ada.get(address).content == files[address] for address in shared), "thumbnails and crops of others"
    assert [row["id"] for row in ada.get("/api/scenes").json()["scenes"]] == [stays]
    assert ada.get("/api/scenes").json()["first"] == stays
    assert gone not in json.dumps([ada.get(address).json() for address in ("/api/work", "/api/me", "/api/progress", "/api/scenes")])
    assert {key[0] for key in desk.drafts.of("ada")} == {stays}, "the server removes drafts, wherever their file lies"
    assert ada.post(f"/api/figures/{own[stays]}", json={"choice": 1}).status_code == 200
    assert ada.post(f"/api/answers/{own[stays]}", json={"choice": 1}).status_code == 200, "its rows were written again, and are the same"
    erase(desk.lake, stays)
    for address in ("/api/work", "/api/scenes", "/api/progress", "/api/me"):
        assert ada.get(address).status_code in (200, 404), address
    assert ada.get("/api/scenes").status_code == 404
    check_gone(ada.get, files, set())


def test_a_viewer_process_forgets_an_erased_scene(tmp_path: Path) -> None:
    lake = shown_lake(tmp_path)
    command = [sys.executable, "-c", LAUNCH.format(first=""), str(stand_in(tmp_path / "built")), "view", "--lake", lake.address, "--json"]
    process = subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        guest = Guest(json.loads(process.stdout.readline())["address"])
        before, other = open_scene(guest.client.get, GONE), open_scene(guest.client.get, STAYS)
        command = [sys.executable, "-m", "flows.cli", "lake", "erase", GONE, "--yes", "--lake", lake.address, "--json"]
        done = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True)
        assert (done.returncode, json.loads(done.stdout)["proof"]["hits"]) == (0, []), done.stderr
        check_gone(guest.client.get, before, before.keys() & other.keys())
        assert [row["id"] for row in guest.ask("GET", "/api/scenes")["scenes"]] == [STAYS]
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()


@pytest.mark.slow
def test_an_annotation_server_forgets_an_erased_scene(tmp_path: Path) -> None:
    lake = asked_lake(tmp_path, people=("ada",))
    file = tmp_path / "elsewhere.sqlite"
    with serving(tmp_path, "--drafts", str(file)) as server:
        ada = server.guest("ada")
        gone, stays = sorted({row["scene_id"] for row in ada.objects()})
        answers = open_batch(ada.client.get)
        assert {part.split("/")[1] for part in answers[gone]} == {"api", "blobs", "points", "thumbnails"}
        key = next(row["key"] for row in ada.objects() if row["scene_id"] == gone)
        ada.ask("PUT", f"/api/drafts/{key}", {"choice": 1, "edit": 1})
        erase(lake, gone)
        check_gone(ada.client.get, answers[gone], answers[gone].keys() & answers[stays].keys())
        assert {row["scene_id"] for row in ada.objects()} == {stays}
        with pytest.raises(httpx.HTTPStatusError):
            ada.client.put(f"/api/drafts/{key}", json={"choice": 1, "edit": 2}).raise_for_status()
        assert server.end() == 0
    assert gone.encode() not in b"".join(path.read_bytes() for path in tmp_path.glob("elsewhere.sqlite*"))
    drafts = Drafts(file, BATCH)
    assert drafts.of("ada") == {}
    drafts.close()
