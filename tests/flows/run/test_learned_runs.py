"""Runs in which every provider is a model of others: tiny networks in folders, local servers and programs; killed, and started again."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from bench.models.drawn_networks import write_networks
from schemas.calls import ModelCall
from schemas.candidates import Candidate
from schemas.captions import Caption
from schemas.capture import Instance
from tasks.furniture import generate
from tasks.geometry.meshes import dump_glb
from tests.capture_scans import OBJECTS, box_room, write_scannet
from tests.conftest import REPOSITORY, made_once
from tests.tasks.calls.servers import Server
from tests.tasks.candidates.generation.pipelines import write_pipelines
from tests.tasks.library.siglip import write_siglip
from warehouse.lake import Lake
from warehouse.tables.digest import digests

pytest.importorskip("torch")
pytest.importorskip("diffusers")

WORKERS = 2

LOOKS = {"category": "box", "colors": ["brown"], "materials": ["wood"], "texture": "flat", "shape": "plain", "sentence": "A brown box."}
BEHAVES = {"physics_attributes": {"category": "Rigid Body", "mass": 4.0, "friction": 0.4, "bounciness": 0}}
ITEMS = {"items": [{"item": "mug", "color": "red", "count": 1}, {"item": "book", "color": None, "count": 2}]}


def cube() -> bytes:
    """What the server and the program make of everything."""
    made = trimesh.creation.box((0.3, 0.4, 0.5))
    made.visual.vertex_colors = np.full((8, 4), 120, dtype=np.uint8)
    return dump_glb([made])


class Seer(Server):
    """A vision-language model and a generator at one address, which say the same of everything, and count who asks."""

    def __init__(self) -> None:
        super().__init__()
        self.pause = 0.0
        model = cube()

        def answer(body: dict[str, Any]) -> tuple[int, Any, dict[str, str]]:
            time.sleep(self.pause)
            if "messages" not in body:
                return 200, model, {}
            schema = json.dumps(body["response_format"])
            says = ITEMS if '"items"' in schema and "count" in schema else BEHAVES if "physics_attributes" in schema else LOOKS
            message = {"message": {"role": "assistant", "content": json.dumps(says)}}
            return 200, {"choices": [message], "usage": {"prompt_tokens": 100, "completion_tokens": 10}}, {}

        self.answers = [answer]

    @property
    def asked(self) -> Counter[str]:
        """How often each request came, by its content."""
        return Counter(json.dumps([path, body], sort_keys=True) for path, _, body in self.requests)


@pytest.fixture(scope="module")
def seer() -> Iterator[Seer]:
    """One for all runs: settings name its address, and runs of other settings are other runs."""
    made = Seer()
    yield made
    made.close()


def write_scans(folder: Path, count: int) -> None:
    """Rooms with a table, and every other one with a box on it or a chair beside it; no two have an object of one size, about which workers
    would ask the same at once."""
    for number in range(count):
        grown = 1 + 0.02 * number
        made = []
        for label, (x, y, _), (length, width, height), yaw in (OBJECTS[0], OBJECTS[3] if number % 2 else OBJECTS[1]):
            bottom = OBJECTS[0][2][2] * grown if label == "box" else 0.0
            made.append((label, (x, y, bottom + 0.5 * height * grown), (length, width, height * grown), yaw))
        room = box_room(made, cameras=4)
        write_scannet(folder / f"scene{number:04d}_00", room, labels=room.labels[: 7 if number % 2 else 8])


def write_weights(folder: Path) -> None:
    """Tiny networks, a library of three pieces of furniture, and a program that copies a model."""
    for name, write in (("seeing", write_networks), ("shap_e", write_pipelines), ("siglip", write_siglip)):
        (folder / name).mkdir()
        write(folder / name)
    library = folder / "library"
    library.mkdir()
    for number, category in enumerate(("table", "chair", "box")):
        (library / f"{category}.glb").write_bytes(dump_glb(generate(category, None, np.random.default_rng(number)).parts))
    (folder / "model.glb").write_bytes(cube())
    (folder / "makes.py").write_text("import shutil, sys\nshutil.copy(sys.argv[1], sys.argv[2])\n")


@pytest.fixture(scope="session")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_once(tmp_path_factory, "learned_weights", write_weights)


def settings_file(folder: Path, seer: Seer, weights: Path) -> Path:
    """Settings by which everything that a model can do is done by one."""
    endpoint = f'url = "{seer.url}", model = "seer-1", pause_seconds = 0.0, attempts = 3'
    maker = 'model = "maker", license = "MIT", pixels = 64'
    shap_e = "steps = 2, grid = 16, pixels = 64, device = 'cpu'"
    command = f"'\\'{sys.executable}\\' {weights}/makes.py {weights}/model.glb {{out}}'".replace("\\'", '"')
    slots = [
        f'{{kind = "shap_e", by = "text", weights = "{weights}/shap_e/text", {shap_e}}}',
        f'{{kind = "shap_e", by = "image", weights = "{weights}/shap_e/image", {shap_e}}}',
        f'{{kind = "served", url = "{seer.url}", pause_seconds = 0.0, attempts = 3, {maker}}}',
        f'{{kind = "commanded", command = {command}, {maker}}}',
        '{kind = "textured", of = 3}', '{kind = "library", k = 1}', '{kind = "procedural"}',
    ]  # fmt: skip
    lines = [
        "[capture.small_objects.provider]", 'kind = "learned"', "least_fit = 0.0", "inside_share = 0.0",
        f'segmenter = {{kind = "sam2", weights = "{weights}/seeing/sam2", device = "cpu"}}',
        f'detector = {{kind = "grounding_dino", weights = "{weights}/seeing/grounding_dino", device = "cpu", threshold = 0.2,'
        " text_threshold = 0.0, shortest_px = 96, longest_px = 160}",
        f'items = {{kind = "asked", {endpoint}}}',
        "[captions.provider]", 'kind = "vision_language"', *endpoint.split(", "),
        "[candidates]", f'encoder = "{weights}/siglip"', "slots = [", *(f"  {{provider = {slot}}}," for slot in slots), "]",
    ]  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "settings.toml"
    path.write_text("\n".join(lines) + "\n")
    return path


def started(scans: Path, lake: Path, config: Path, weights: Path) -> subprocess.Popen[str]:
    words = ["run", "--scans", str(scans), "--lake", str(lake), "--config", str(config), "--library", str(weights / "library")]
    return subprocess.Popen(
        [sys.executable, "-m", "flows.cli", *words, "--workers", str(WORKERS)], cwd=REPOSITORY, text=True, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, start_new_session=True,
    )  # fmt: skip


def ran(scans: Path, lake: Path, config: Path, weights: Path) -> Lake:
    process = started(scans, lake, config, weights)
    out, err = process.communicate()
    assert process.returncode == 0, out + err
    return Lake.open(lake)


@pytest.mark.parametrize(
    ("scenes", "kills"),
    [pytest.param(2, 2, marks=pytest.mark.slow), pytest.param(20, 10, marks=[pytest.mark.slow, pytest.mark.timeout(7200)])],
)
def test_a_run_of_models_alone_that_is_killed_comes_to_the_same_lake(
    tmp_path: Path, seer: Seer, weights: Path, scenes: int, kills: int
) -> None:
    scans = tmp_path / "scans"
    write_scans(scans, scenes)
    config = settings_file(tmp_path, seer, weights)
    seer.requests.clear()
    seer.pause = 0.0
    whole = ran(scans, tmp_path / "whole", config, weights)
    undisturbed = seer.asked
    assert set(undisturbed.values()) == {1}
    captions, candidates = whole.snapshot().rows(Caption), whole.snapshot().rows(Candidate)
    named = {(row.scene_id, row.instance_id) for row in whole.snapshot().rows(Instance) if row.found_by == "file"}
    told = [row for row in captions if (row.scene_id, row.instance_id) in named]
    assert told
    assert not any(row.is_fallback for row in told), "what networks of random weights find may be too small to have that mass"
    outcomes = Counter((row.provider, row.outcome) for row in candidates)
    for provider in ("shap_e", "served", "commanded", "textured", "library"):
        assert any(name.startswith(provider) and outcome == "filled" for name, outcome in outcomes), (provider, outcomes)
    calls = whole.snapshot().rows(ModelCall)
    assert {row.prompt for row in calls} >= {"appearance", "physics_corrected", "items_corrected"}

    seer.requests.clear()
    seer.pause = 0.2
    lake, done = tmp_path / "disturbed", 0
    for wanted in np.linspace(1, 0.9 * len(undisturbed), kills).astype(int):
        process = started(scans, lake, config, weights)
        while len(seer.asked) < wanted and process.poll() is None:
            time.sleep(0.02)
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            done += 1
        process.communicate()
    assert done == kills
    seer.pause = 0.0
    made = ran(scans, lake, config, weights)
    assert digests(made.snapshot()) == digests(whole.snapshot())
    assert set(seer.asked) == set(undisturbed)
    repeated = sum(count - 1 for count in seer.asked.values())
    print(f"{scenes} scenes, {len(calls)} calls, {kills} kills: {repeated} calls were under way and asked again")
    assert repeated <= WORKERS * kills, "one for each worker and kill"
    rows = made.snapshot().rows(ModelCall)
    assert {row.call_id for row in rows} == {row.call_id for row in calls}
    assert sum(row.lost for row in rows) >= repeated, "and each is counted"
