"""`metascenes annotate serve` as it runs: a batch from its first draft to the scenes, by HTTP, through a real server and a real lake."""

from __future__ import annotations

import contextlib
import itertools
import random
import signal
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner

from flows.cli import cli
from flows.inputs.annotation import batch_list
from flows.run.plan import annotation_digests
from flows.view import bundle
from flows.view.annotating.drafts import Drafts
from schemas.annotation import Annotation, AnnotationFigures, AnswerVerdict, Assignment
from schemas.errors import InputError
from tests.annotated import SCENES
from tests.flows.view.batches import BATCH, Guest, Server, asked_lake, serving, stand_in

pytestmark = pytest.mark.whole

PLACED = {"position": [-1.9, -1.95, 0.02], "yaw_degrees": 10, "scale": [1, 1, 1.1]}


def drafted(number: int, **values: Any) -> dict[str, Any]:
    """A draft whose content says which one it is."""
    return {"choice": 1 + number % 3, "transform": None, "ranking": [1 + number % 3], "seconds": number} | values


@pytest.mark.slow
def test_a_batch_goes_from_its_first_draft_to_the_scenes(tmp_path: Path) -> None:
    lake = asked_lake(tmp_path)
    with serving(tmp_path, "--reviewer", "rita", "--reviewer", "ADA") as server:
        ada, bob, rita = (server.guest(name) for name in ("ada", "bob", "rita"))
        assert {name: entry["roles"] for name, entry in server.addresses.items()} == {
            "ada": ["annotator", "reviewer"], "bob": ["annotator"], "rita": ["reviewer"],
        }  # fmt: skip
        assert ada.ask("GET", "/api/me")["settings"] == {"least_sample": 50, "pass_share": 0.98, "sample_share": 0.1}
        assignments = lake.snapshot().rows(Assignment)
        for guest, name in ((ada, "ada"), (bob, "bob")):
            rows = guest.objects()
            keys = [f"{row.scene_id}/{row.instance_id}" for row in sorted(assignments, key=lambda row: row.place) if row.annotator == name]
            assert [row["key"] for row in rows] == keys
            assert {(row["status"], row["is_open"], row["answer"], row["draft"]) for row in rows} == {("open", True, None, None)}
            for row in rows:
                assert [offer["slot"] for offer in row["candidates"]] == [1, 2, 3]
                for address in (row["points"], *(offer[kind] for offer in row["candidates"] for kind in ("glb", "thumbnail"))):
                    assert guest.client.get(address).status_code == 200
        refused = ada.ask("POST", "/api/submit", {}, 409)
        assert refused == {"error": "the batch has no answers"}
        first = ada.objects()[0]["key"]
        ada.ask("PUT", f"/api/drafts/{first}", drafted(0, transform=PLACED, edit=1, page="p"))
        (row,) = [row for row in ada.objects() if row["key"] == first]
        assert (row["status"], row["draft"]["transform"], row["draft"]["edit"]) == ("draft", PLACED, 1)
        assert {person["person"]: person["drafts"] for person in ada.ask("GET", "/api/progress")["people"]} == {"ada": 1, "bob": 0}
        foreseen = ada.ask("POST", f"/api/figures/{first}", drafted(0, transform=PLACED))
        saved = ada.ask("POST", f"/api/answers/{first}", drafted(0, transform=PLACED, edit=2, page="p"))
        assert saved == {"revision": 1, "figures": foreseen}
        late = ada.ask("PUT", f"/api/drafts/{first}", drafted(0, edit=1, page="p"), 409)
        assert late["draft"] is None, "what was answered is no draft again"
        assert ada.ask("POST", f"/api/answers/{first}", {"withdrawn": True})["revision"] == 2
        assert ada.objects()[0]["status"] == "withdrawn"
        for guest in (ada, bob):
            for row in guest.objects():
                guest.ask("POST", f"/api/answers/{row['key']}", {"choice": 2, "ranking": [2, 1, 3], "seconds": 4})
        assert {row["status"] for row in ada.objects()} == {"answered"}
        assert ada.ask("POST", "/api/submit", {})["state"] == "submitted"
        assert not any(row["is_open"] for row in bob.objects())
        bob.ask("POST", f"/api/answers/{bob.objects()[0]['key']}", {"choice": 1}, 409)
        assert rita.ask("POST", "/api/sample", {})["sampled"] == 8
        wrong = _judged(ada, rita, bob)
        counted = rita.ask("GET", "/api/progress")["reviews"]
        assert counted == {
            "sampled": 8,
            "judged": 8,
            "passed": 7,
            "pass_low": 0.875,
            "pass_high": 0.875,
        }
        assert rita.ask("POST", "/api/conclude", {})["verdict"] == "returned"
        assert annotation_digests(lake) == {}
        (row,) = [row for row in bob.objects() if row["remarks"]]
        assert (row["key"], row["is_open"], row["status"]) == (wrong, True, "answered")
        assert row["remarks"] == ["round 1, rita: <b>too large</b>"]
        assert row["answer"]["choice"] == row["candidates"][1]["asset_id"]
        assert bob.ask("POST", f"/api/answers/{wrong}", {"choice": 1})["revision"] == 2
        assert bob.ask("POST", "/api/submit", {})["round"] == 2
        rita.ask("POST", "/api/sample", {})
        for row in rita.ask("GET", "/api/reviews")["answers"]:
            rita.ask("PUT", f"/api/verdicts/{row['key']}/{row['annotator']}", {"passes": True})
        assert rita.ask("POST", "/api/conclude", {})["verdict"] == "accepted"
        assert annotation_digests(lake).keys() == set(SCENES)
        answers = lake.snapshot().rows(Annotation)
        assert {(row.tool, row.is_simulated) for row in answers} == {("metascenes", False)}
        assert len(lake.snapshot().rows(AnnotationFigures)) == len([row for row in answers if row.choice])
        assert server.end() == 0
    assert server.errors == ""


def _judged(ada: Guest, rita: Guest, bob: Guest) -> str:
    """Ada, who answered, judges half of what is not her own, rita the rest; the object of bob's that fails."""
    bob.ask("GET", "/api/reviews", status=403)
    everything = {(row["key"], row["annotator"]) for row in rita.ask("GET", "/api/reviews")["answers"]}
    mine = ada.ask("GET", "/api/reviews")["answers"]
    assert {(row["key"], row["annotator"]) for row in mine} == {entry for entry in everything if entry[1] == "bob"}
    for key, annotator in everything - {(row["key"], row["annotator"]) for row in mine}:
        ada.ask("PUT", f"/api/verdicts/{key}/{annotator}", {"passes": True}, 403)
    for row in mine[:2]:
        ada.ask("PUT", f"/api/verdicts/{row['key']}/bob", {"passes": True})
    rita.ask("POST", "/api/conclude", {}, 409)
    judged = {(row["key"], "bob") for row in mine[:2]}
    wrong = str(mine[2]["key"])
    rita.ask("PUT", f"/api/verdicts/{wrong}/bob", {"passes": False}, 400)
    for key, annotator in everything - judged:
        verdict = {"passes": True} if key != wrong else {"passes": False, "remark": "<b>too large</b>"}
        rita.ask("PUT", f"/api/verdicts/{key}/{annotator}", verdict)
    return wrong


@pytest.mark.slow
def test_two_annotators_at_once_never_step_on_each_other(tmp_path: Path) -> None:
    """Both have all objects. Each keeps a book of what they did; in the end the server says the same, and so does the lake."""
    lake = asked_lake(tmp_path, overlap=2, objects=2)
    with serving(tmp_path) as server:
        with ThreadPoolExecutor(2) as pool:
            books = dict(zip(("ada", "bob"), pool.map(lambda name: _work_through(server, name), ("ada", "bob")), strict=True))
        for name, book in books.items():
            for row in server.guest(name).objects():
                kind, number = book[row["key"]]
                assert (row["status"], row["key"]) == (kind, row["key"])
                if kind == "draft":
                    assert row["draft"]["seconds"] == number
                if kind == "answered":
                    assert (row["answer"]["seconds"], row["answer"]["choice"]) == (number, row["candidates"][number % 3]["asset_id"])
        server.end()
    revisions: dict[Any, list[int]] = {}
    for row in lake.snapshot().rows(Annotation):
        revisions.setdefault((row.scene_id, row.instance_id, row.annotator), []).append(row.revision)
    assert all(numbers == list(range(1, len(numbers) + 1)) for numbers in revisions.values())


def _work_through(server: Server, name: str) -> dict[str, tuple[str, int]]:
    """Drafts, answers and withdrawals of one annotator, drawn by their name; what each object is at in the end, and by which act."""
    guest, draw = server.guest(name), random.Random(name)
    book: dict[str, tuple[str, int]] = {row["key"]: ("open", 0) for row in guest.objects()}
    answered: dict[str, tuple[str, int]] = dict(book)
    for number in range(1, 41):
        key = draw.choice(sorted(book))
        act = draw.choice(["draft", "draft", "draft", "discard", "answer", "withdraw"])
        if act == "draft":
            guest.ask("PUT", f"/api/drafts/{key}", drafted(number, edit=number, page=name))
            book[key] = ("draft", number)
        elif act == "discard":
            guest.ask("DELETE", f"/api/drafts/{key}")
            book[key] = answered[key]
        elif act == "answer":
            guest.ask("POST", f"/api/answers/{key}", drafted(number))
            book[key] = answered[key] = ("answered", number)
        elif answered[key][0] == "answered":
            guest.ask("POST", f"/api/answers/{key}", {"withdrawn": True})
            book[key] = answered[key] = ("withdrawn", number)
    return book


def test_what_was_acknowledged_is_there_after_a_kill(tmp_path: Path) -> None:
    """Both write on; the server is killed in the midst of it. What it acknowledged is all there, under the same addresses."""
    asked_lake(tmp_path)
    acknowledged: dict[tuple[str, str], int] = {}
    enough = threading.Event()
    with serving(tmp_path) as server:
        rows = {name: [row["key"] for row in server.guest(name).objects()] for name in ("ada", "bob")}

        def write(name: str) -> None:
            guest = server.guest(name)
            for edit, key in zip(itertools.count(1), itertools.cycle(rows[name])):
                try:
                    guest.ask("PUT", f"/api/drafts/{key}", drafted(edit, edit=edit, page=name))
                except httpx.TransportError:
                    return
                acknowledged[name, key] = edit
                if len(acknowledged) == 8 and edit >= 30:
                    enough.set()

        threads = [threading.Thread(target=write, args=(name,)) for name in rows]
        for thread in threads:
            thread.start()
        assert enough.wait(300)
        server.end(signal.SIGKILL)
        for thread in threads:
            thread.join()
        first = server.addresses
    kept = Drafts(tmp_path / "lake" / "drafts" / f"{BATCH}.sqlite", BATCH)
    for (name, key), edit in acknowledged.items():
        draft = kept.of(name)[key.rpartition("/")[0], key.rpartition("/")[2]]
        assert draft.edit in (edit, edit + len(rows[name])), "the last that was acknowledged, or the one that was on its way"
        assert draft.body is not None
        assert draft.body["seconds"] == draft.edit
    kept.close()
    with serving(tmp_path) as server:
        assert server.addresses == first
        for name, keys in rows.items():
            assert {row["key"]: row["status"] for row in server.guest(name).objects()} == dict.fromkeys(keys, "draft")


SLOW = """
import time
from flows.view.annotating.settling import Rooms
figures, folder = Rooms.figures, Path({folder!r})
def slow(*arguments):
    (folder / "begun").touch()
    while not (folder / "go on").exists():
        time.sleep(0.01)
    return figures(*arguments)
Rooms.figures = slow
"""


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM])
def test_who_waits_for_figures_at_the_end_gets_them(tmp_path: Path, how: signal.Signals) -> None:
    asked_lake(tmp_path)
    with serving(tmp_path, first=SLOW.format(folder=str(tmp_path))) as server, ThreadPoolExecutor(1) as pool:
        ada = server.guest("ada")
        key = ada.objects()[0]["key"]
        asked = pool.submit(ada.ask, "POST", f"/api/figures/{key}", drafted(1))
        while not (tmp_path / "begun").exists():
            assert not asked.done()
        server.process.send_signal(how)
        with contextlib.suppress(httpx.TransportError):
            while httpx.get(ada.base).status_code:  # until nobody else is let in
                pass
        (tmp_path / "go on").touch()
        assert asked.result()["is_category_match"] is True
        server.errors = server.process.communicate()[1]
    assert "Traceback" not in server.errors
    assert "exceeded" not in server.errors
    assert server.process.returncode == (0 if how is signal.SIGINT else -signal.SIGTERM)


@pytest.fixture
def built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(bundle, "BUILT", stand_in(tmp_path / "built"))
    return tmp_path


def test_a_file_of_drafts_of_another_version_is_misuse_in_one_line(built: Path) -> None:
    import sqlite3

    lake = asked_lake(built)
    file = built / "older.sqlite"
    with sqlite3.connect(file) as connection:
        connection.execute("CREATE TABLE drafts (key TEXT, body TEXT)")
    result = CliRunner().invoke(cli, ["annotate", "serve", BATCH, "--lake", lake.address, "--drafts", str(file)])
    assert isinstance(result.exception, InputError)
    assert "has layout 0 of drafts, this version reads 1" in str(result.exception)
    assert (result.output, (built / "older.sqlite.tokens").exists()) == ("", False)


def test_settling_puts_an_object_to_rest_and_leaves_the_others(tmp_path: Path) -> None:
    lake = asked_lake(tmp_path, people=("ada",))
    with serving(tmp_path) as server:
        ada = server.guest("ada")
        first, second, *_ = ada.objects()
        place = second["candidates"][1]["transform"]["position"]
        pushed = {"position": [place[0] - 0.4, place[1], 0.1], "yaw_degrees": 0, "scale": [1, 1, 1]}
        before = ada.ask("POST", f"/api/figures/{first['key']}", {"choice": 2, "transform": pushed})
        assert (before["collides_with"], before["floating_m"]) == (second["instance_id"], pytest.approx(0.1, abs=1e-6))
        settled = ada.ask("POST", f"/api/settle/{first['key']}", {"choice": 2, "transform": pushed})
        assert settled["problem"] == ""
        assert settled["figures"]["collision_m"] < 0.002 < before["collision_m"]
        assert settled["figures"]["floating_m"] == pytest.approx(0.0, abs=1e-4)
        assert 0.1 <= settled["moved_m"] < 0.3
        again = ada.ask("POST", f"/api/settle/{first['key']}", {"choice": 2, "transform": pushed})
        assert again == settled, "the same every time"
        assert ada.ask("POST", f"/api/figures/{first['key']}", {"choice": 2, "transform": settled["transform"]}) == settled["figures"]
        away = {"position": [place[0], place[1] + 1.5, 0], "yaw_degrees": 0, "scale": [1, 1, 1]}
        ada.ask("PUT", f"/api/drafts/{second['key']}", {"choice": 2, "transform": away, "edit": 1})
        alone = ada.ask("POST", f"/api/figures/{first['key']}", {"choice": 2, "transform": pushed})
        assert alone["collides_with"] is None, "others stand as the annotator's own drafts have them"
        ada.ask("POST", f"/api/settle/{first['key']}", {"choice": None}, 400)
        assert ada.ask("POST", f"/api/figures/{first['key']}", {"choice": None}) is None
        far = pushed | {"position": [90, 0, 0]}
        assert "m from the instance" in ada.ask("POST", f"/api/settle/{first['key']}", {"choice": 2, "transform": far}, 400)["error"]
        assert server.end() == 0
    assert (lake.snapshot().rows(Annotation), lake.snapshot().rows(AnswerVerdict)) == ([], [])
    assert batch_list(lake, BATCH)[0]["state"] == "open"
