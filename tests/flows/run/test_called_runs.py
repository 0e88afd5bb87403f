"""Runs whose captions a model words: killed and started again, beyond a budget, replayed without a network; and what `explain` says."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from flows.outputs.explain import explain, settings_of
from schemas.calls import ModelCall
from schemas.captions import Caption
from tasks.lineage.outline import outline
from tests.capture_scans import OBJECTS, box_room, write_scannet
from tests.conftest import REPOSITORY
from tests.tasks.calls.servers import Answer, Server
from warehouse.lake import Lake
from warehouse.tables.digest import digests

pytestmark = pytest.mark.whole

LOOKS = {
    "category": "box", "colors": ["brown"], "materials": ["wood"], "texture": "flat", "shape": "plain", "sentence": "A brown box.",
}  # fmt: skip
BEHAVES = {"physics_attributes": {"category": "Rigid Body", "mass": 4.0, "friction": 0.4, "bounciness": 0}}


def answering(seconds: float = 0.0) -> Answer:
    """A model that says the same of everything, and takes its time."""

    def answer(body: dict[str, Any]) -> tuple[int, Any, dict[str, str]]:
        time.sleep(seconds)
        is_physics = "physics_attributes" in json.dumps(body["response_format"])
        text = json.dumps(BEHAVES if is_physics else LOOKS)
        usage = {"prompt_tokens": 100, "completion_tokens": 10}
        return 200, {"choices": [{"message": {"role": "assistant", "content": text}}], "usage": usage}, {}

    return answer


@pytest.fixture(scope="module")
def scans(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("called") / "scans"
    write_scannet(folder / "scene0000_00", box_room((OBJECTS[0], OBJECTS[3]), cameras=8))
    write_scannet(folder / "scene0001_00", box_room(OBJECTS[1:3], cameras=8))
    return folder


def settings_file(folder: Path, server: Server) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "settings.toml"
    path.write_text(
        f'[captions.provider]\nkind = "vision_language"\nurl = "{server.url}"\nmodel = "seer-1"\nprompt_usd_per_million = 100.0\n'
        "pause_seconds = 0.0\nattempts = 2\n"
    )
    return path


def started(scans: Path, lake: Path, config: Path, *more: str) -> subprocess.Popen[str]:
    command = [
        sys.executable,
        "-m",
        "flows.cli",
        "run",
        "--scans",
        str(scans),
        "--lake",
        str(lake),
        "--config",
        str(config),
        "--workers",
        "2",
    ]
    return subprocess.Popen(
        [*command, *more], cwd=REPOSITORY, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True
    )


def ran(scans: Path, lake: Path, config: Path, *more: str, code: int = 0) -> str:
    process = started(scans, lake, config, *more)
    out, err = process.communicate()
    assert process.returncode == code, out + err
    return out + err


def asked(server: Server) -> Counter[str]:
    """How often each request came, by its content."""
    return Counter(
        json.dumps([body["messages"], body["response_format"]["json_schema"]["schema"]], sort_keys=True) for _, _, body in server.requests
    )


@pytest.fixture(scope="module")
def model() -> Iterator[Server]:
    """One for all runs: settings name its address, and runs of other settings are other runs."""
    made = Server()
    yield made
    made.close()


@pytest.fixture
def server(model: Server) -> Server:
    """The same, of whom nothing was asked yet."""
    model.requests.clear()
    return model


@pytest.fixture(scope="module")
def whole(scans: Path, model: Server, tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """What nobody disturbed."""
    model.answers = [answering()]
    folder = tmp_path_factory.mktemp("whole")
    ran(scans, folder / "lake", settings_file(folder, model))
    assert set(asked(model).values()) == {1}
    lake = Lake.open(folder / "lake")
    assert len(lake.snapshot().rows(ModelCall)) == len(model.requests)
    return lake


def test_captions_name_their_calls_and_explain_goes_on_to_the_prompt(whole: Lake) -> None:
    captions = whole.snapshot().rows(Caption)
    calls = {row.call_id: row for row in whole.snapshot().rows(ModelCall)}
    assert captions
    for row in captions:
        assert not row.is_fallback
        assert calls[str(row.appearance_call_id)].prompt == "appearance"
        assert calls[str(row.physics_call_id)].prompt == "physics_corrected"
    lineage = explain(whole, f"{captions[0].scene_id}/{captions[0].instance_id}")
    assert lineage.problems == ()
    text = outline(lineage, settings_of)
    assert "looks told by" in text
    assert "asked: You are shown one object that was cut out of a photo of a scanned room." in text
    assert "asked: [picture]" in text
    assert 'answered: {"physics_attributes"' in text
    assert json.loads(json.dumps(lineage.document()))


@pytest.mark.slow
def test_a_run_that_is_killed_asks_nothing_twice_but_what_was_under_way(scans: Path, whole: Lake, server: Server, tmp_path: Path) -> None:
    server.answers = [answering(0.3)]
    config, lake = settings_file(tmp_path, server), tmp_path / "lake"
    kills = 0
    for wanted in (1, 4, 7):
        process = started(scans, lake, config)
        while len(server.requests) < wanted and process.poll() is None:
            time.sleep(0.02)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            kills += 1
        process.communicate()
    assert kills == 3
    server.answers = [answering()]
    ran(scans, lake, config)
    made = Lake.open(lake)
    assert digests(made.snapshot()) == digests(whole.snapshot())
    repeated = {request: count - 1 for request, count in asked(server).items() if count > 1}
    assert sum(repeated.values()) <= 2 * kills, "two workers were at it"
    rows = made.snapshot().rows(ModelCall)
    assert sum(row.lost for row in rows) >= sum(repeated.values())
    assert len(rows) == len(asked(server))


@pytest.mark.slow
def test_a_budget_stops_a_run_and_the_next_one_goes_on(scans: Path, whole: Lake, server: Server, tmp_path: Path) -> None:
    server.answers = [answering()]
    config, lake = settings_file(tmp_path, server), tmp_path / "lake"
    told = ran(scans, lake, config, "--most-calls", "3", code=1)
    assert "the budget of calls is spent: " in told
    assert 3 <= len(server.requests) <= 4, "each worker may have had one under way"
    ran(scans, lake, config, "--budget", "0.02", code=1)
    ran(scans, lake, config)
    assert set(asked(server).values()) == {1}
    assert digests(Lake.open(lake).snapshot()) == digests(whole.snapshot())


@pytest.mark.slow
def test_a_run_is_replayed_without_a_network(scans: Path, whole: Lake, server: Server, tmp_path: Path) -> None:
    config, lake = settings_file(tmp_path, server), tmp_path / "lake"
    ran(scans, lake, config, "--replay", whole.address)
    assert not server.requests
    assert digests(Lake.open(lake).snapshot()) == digests(whole.snapshot())
    shutil.rmtree(lake)
    empty = Lake.open(tmp_path / "empty")
    empty.blobs.put(b"x", "txt")
    assert "has no reply" in ran(scans, lake, config, "--replay", empty.address, code=1)
    assert not server.requests
