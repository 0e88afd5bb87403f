"""Generators of others: what they are asked, what becomes of what they answer, and whatever else they do."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import sys
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
import trimesh

from schemas.candidates import Asset, Candidate
from schemas.errors import InputError
from schemas.record import check
from tasks.calls.command import filled, words_of
from tasks.calls.exchange import EndpointAway
from tasks.calls.ledger import NoFurtherCall, Recollection
from tasks.candidates import CandidatesConfig, SlotConfig, run
from tasks.candidates.commanded import PLACES, WHERE, Commanded
from tasks.candidates.generation.generated import GeneratorSettings, fitted, standing
from tasks.candidates.procedural import Procedural
from tasks.candidates.served import Served
from tasks.candidates.shap_e import ShapE
from tasks.geometry.meshes import dump_glb, load_glb, surface_of
from tasks.stage import Context, Outcome
from tests.conftest import made_once
from tests.samples import lasting
from tests.tasks.calls.hanging import assert_all_end
from tests.tasks.calls.servers import Server, refuses, server
from tests.tasks.candidates.generation.pipelines import write_pipelines
from tests.tasks.selection.rooms import RED, SCENE, Room, chair, photographed_chair

__all__ = ["server"]


@pytest.fixture(scope="module")
def room() -> Room:
    return photographed_chair()


def offered(room: Room, provider: Any, ledger: Recollection | None = None, fallback: Procedural | None = None) -> tuple[Candidate, Outcome]:
    """What fills one slot."""
    context = Context(SCENE, "candidates", 0, room.blobs, ledger=ledger or Recollection())
    outcome = run(
        instances=room.instances, frames=room.frames, masks=room.masks, captions=[], library=None, scan=None, context=context,
        config=CandidatesConfig(slots=(SlotConfig(provider, fallback),)),
    )  # fmt: skip
    check(outcome.rows["candidates"], Candidate)
    check(outcome.rows["assets"], Asset)
    (row,) = outcome.rows["candidates"]
    return row, outcome


def model_glb(scale: float = 0.01) -> bytes:
    """A chair as generators write them: of any size, +Y up."""
    parts = [part.copy() for part in chair(RED)]
    for part in parts:
        part.apply_scale(scale)
    return dump_glb(parts)


def sends(data: bytes) -> Any:
    return lambda body: (200, data, {})


def served(server: Server, **more: Any) -> Served:
    settings = {
        "url": server.url,
        "model": "maker",
        "license": "MIT",
        "pause_seconds": 0.0,
        "attempts": 2,
        "poll_seconds": 0.0,
        "pixels": 64,
    }
    return Served(**{**settings, **more})


def test_a_served_model_becomes_an_asset_of_the_instances_size(room: Room, server: Server) -> None:
    server.answers = [sends(model_glb())]
    ledger = Recollection()
    row, outcome = offered(room, served(server, author="somebody", source_url="https://example.org/maker", seed=7), ledger)
    assert (row.outcome, row.provider, row.is_fallback, row.seed) == ("filled", "served:maker", False, 7)
    (asset,) = outcome.rows["assets"]
    assert (asset.license, asset.author, asset.source, asset.provider) == ("MIT", "somebody", "https://example.org/maker", "served")
    box = np.sort(room.instances[0].box_size)
    assert np.prod(asset.extents) == pytest.approx(np.prod(box), rel=0.05)
    turned = surface_of(chair(RED)).bounds
    shape = np.ptp(turned, axis=0)
    assert np.array(asset.extents) / asset.extents[2] == pytest.approx(shape / shape[2], rel=1e-4), "upright, and of its own proportions"
    ((path, _, body),) = server.requests
    assert path == "/v1/generate"
    assert (body["seed"], body["texture"]) == (7, True)
    with PIL.Image.open(io.BytesIO(base64.b64decode(body["image"]))) as picture:
        assert picture.size == (64, 64)
        corners = np.asarray(picture.convert("RGB"))[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert (corners == 255).all(), "cut out, on white"
    assert list(ledger.calls) == [row.call_id]
    (call,) = ledger.calls.values()
    assert (call.kind, call.model, call.outcome, call.instance_id) == ("asset", "maker", "answered", "0000")


def test_the_same_is_not_made_twice_and_the_same_bytes_are_one_asset(room: Room, server: Server) -> None:
    server.answers = [sends(model_glb())]
    ledger = Recollection()
    first, made = offered(room, served(server), ledger)
    again, remade = offered(room, served(server, url="http://127.0.0.1:9/"), ledger)
    assert lasting(first) == lasting(again)
    assert made.rows["assets"] == remade.rows["assets"]
    assert len(server.requests) == 1
    other, _ = offered(room, served(server, seed=1), ledger)
    assert other.call_id != first.call_id
    assert len(server.requests) == 2


def test_one_that_is_asked_after_is_asked_until_it_is_done(room: Room, server: Server) -> None:
    done = {"status": "completed", "model_base64": base64.b64encode(model_glb()).decode()}
    working = {"status": "processing"}
    server.answers = [lambda body: (200, {"uid": "ab-1"}, {})]

    def looked(self: Any) -> None:
        answer = working if len(seen) < 2 else done
        seen.append(self.path)
        data = json.dumps(answer).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    seen: list[str] = []
    server._server.RequestHandlerClass.do_GET = looked  # type: ignore[attr-defined]
    row, _ = offered(room, served(server, way="send", by="text"))
    assert row.outcome == "filled"
    assert seen == ["/v1/status/ab-1"] * 3
    assert server.requests[0][2]["text"] == "A photo of a chair."


BAD = {
    "no GLB": b"<html>busy</html>", "cut off": model_glb()[:200], "empty": b"", "a lie": b"glTF" + b"\x02\x00\x00\x00" + b"\xff" * 60,
}  # fmt: skip


@pytest.mark.parametrize("data", BAD.values(), ids=list(BAD))
def test_what_is_no_model_leaves_the_slot_to_its_fallback_or_says_why(room: Room, server: Server, data: bytes) -> None:
    server.answers = [sends(data)]
    row, outcome = offered(room, served(server), fallback=Procedural(1))
    assert (row.outcome, row.is_fallback, row.provider) == ("filled", True, "procedural")
    assert data.startswith(b"glTF") != ("no answer after 2 tries" in str(row.reason))
    assert row.reason
    alone, outcome = offered(room, served(server))
    assert (alone.outcome, bool(outcome.degradations)) == (("failed", True) if data.startswith(b"glTF") else ("empty", False))


def test_a_server_that_is_away_costs_a_slot_or_waits_for_the_next_run(room: Room, server: Server) -> None:
    server.answers = [refuses(503)]
    row, _ = offered(room, served(server))
    assert (row.outcome, row.asset_id) == ("empty", None)
    with pytest.raises(EndpointAway):
        offered(room, served(server, away="retry"))
    server.answers = [refuses(401)]
    row, _ = offered(room, served(server))
    assert row.outcome == "failed"
    assert "HTTP 401" in str(row.reason)


def test_a_budget_that_is_spent_stops_the_scene(room: Room, server: Server) -> None:
    class Spent(Recollection):
        def asking(self, call_id: str, scene_id: str) -> Any:
            raise NoFurtherCall("no more")

    with pytest.raises(NoFurtherCall):
        offered(room, served(server), Spent())
    assert not server.requests


@pytest.mark.parametrize("error", [ConnectionError("store"), TimeoutError("store")])
def test_a_store_that_is_away_fails_no_slot(room: Room, server: Server, error: OSError) -> None:
    class Away(Recollection):
        def record(self, call: Any, request: bytes, reply: bytes | None) -> bytes | None:
            raise error

    server.answers = [sends(model_glb())]
    with pytest.raises(type(error), match="store"):
        offered(room, served(server), Away(), Procedural(1))


def test_a_license_must_be_stated(room: Room, server: Server) -> None:
    row, _ = offered(room, served(server, license=""))
    assert row.outcome == "failed"
    assert "license" in str(row.reason)
    assert not server.requests


def tool(folder: Path, body: str) -> str:
    """A program of others that a command line calls."""
    path = folder / "tool.py"
    path.write_text("import sys, os, time, pathlib, shutil\nimage, prompt, out, seed = sys.argv[1:5]\n" + textwrap.dedent(body))
    (folder / "model.glb").write_bytes(model_glb())
    return f'"{sys.executable}" {path} {{image}} "{{prompt}}" {{out}} {{seed}}'


def test_a_command_is_given_picture_prompt_place_and_seed(room: Room, tmp_path: Path) -> None:
    command = tool(
        tmp_path,
        f"""
        assert pathlib.Path(image).read_bytes()[:4] == b"\\x89PNG"
        assert prompt == "A photo of a chair.", prompt
        assert seed == "3"
        assert os.getcwd() == str(pathlib.Path(out).parent)
        shutil.copy({str(tmp_path / "model.glb")!r}, out)
        """,
    )
    row, outcome = offered(room, Commanded(command=command, model="toy", license="MIT", seed=3))
    assert (row.outcome, row.provider, row.seed) == ("filled", "commanded:toy", 3), row.reason
    assert outcome.rows["assets"][0].license == "MIT"


def test_a_command_may_choose_the_name_of_its_file(room: Room, tmp_path: Path) -> None:
    command = tool(tmp_path, f"os.makedirs('output/0'); shutil.copy({str(tmp_path / 'model.glb')!r}, 'output/0/mesh.glb')")
    row, _ = offered(room, Commanded(command=command, license="MIT", output="output/*/mesh.glb"))
    assert row.outcome == "filled", row.reason


FAILING = {
    "raise ValueError('no card')": "ended with code 1: ValueError: no card",
    "os.kill(os.getpid(), 9)": "was ended by signal 9",
    "pass": "wrote no GLB",
    "open(out, 'wb').write(b'PK')": "",
    "os.mkfifo(out)": "",
    "os.symlink('/etc/passwd', out)": "",
}


@pytest.mark.parametrize(("body", "said"), FAILING.items())
def test_a_command_that_does_not_do_its_work_is_a_failed_slot(room: Room, tmp_path: Path, body: str, said: str) -> None:
    row, outcome = offered(room, Commanded(command=tool(tmp_path, body), license="MIT"))
    assert row.outcome == "failed"
    assert said in str(row.reason)
    assert len(outcome.degradations) == 1


def test_a_command_that_hangs_is_ended_with_all_that_it_began(room: Room, tmp_path: Path) -> None:
    def end(body: str, seconds: float) -> None:
        row, _ = offered(room, Commanded(command=tool(tmp_path, body), license="MIT", timeout_seconds=seconds))
        assert f"took longer than {seconds:.0f} s" in str(row.reason)

    assert_all_end(tmp_path, end)


def test_keys_are_not_told_to_programs_of_others(room: Room, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SEER_API_KEY", "secret")
    monkeypatch.setenv("HF_HOME", "/models")
    body = (
        f"assert 'SEER_API_KEY' not in os.environ and os.environ['HF_HOME'] == '/models'; shutil.copy({str(tmp_path / 'model.glb')!r}, out)"
    )
    row, _ = offered(room, Commanded(command=tool(tmp_path, body), license="MIT"))
    assert row.outcome == "filled", row.reason


@pytest.mark.parametrize("text", ["{out}; rm -rf /", "$(touch x)", "a {seed} b", "it's", '"'])
def test_a_text_is_one_word_whatever_it_holds(text: str) -> None:
    values = {"image": "i.png", "prompt": text, "out": "o.glb", "seed": "1", "folder": "f"}
    assert filled(words_of("make {prompt} --to={out}", PLACES, WHERE), values) == ["make", text, "--to=o.glb"]


@pytest.mark.parametrize("command", ["", "  ", "make {what}", "make {out", 'make "{out}'])
def test_command_lines_that_mean_nothing_are_refused(command: str) -> None:
    with pytest.raises(InputError, match="command"):
        words_of(command, PLACES, WHERE)


@pytest.mark.parametrize("front", ["+x", "-x", "+y", "-y"])
@pytest.mark.parametrize("up", ["y", "z"])
def test_files_stand_upright_and_look_along_x(up: str, front: str) -> None:
    """Whatever a generator calls up and front: an arrow that points to its front, with a hat on, in its file's own axes."""
    x, y = {"+x": (1, 0), "-x": (-1, 0), "+y": (0, 1), "-y": (0, -1)}[front]
    nose, hat = trimesh.creation.box((0.1, 0.1, 0.1)), trimesh.creation.box((0.1, 0.1, 0.1))
    nose.apply_translation((x, y, 0))
    hat.apply_translation((0, 0, 1))
    body = trimesh.creation.box((0.3, 0.3, 0.3))
    parts = [body, nose, hat]
    if up == "z":  # the file has +Z where glTF has +Y: dumped as it is
        for part in parts:
            part.apply_transform(np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], dtype=float))
    read = standing(load_glb(dump_glb(parts)), GeneratorSettings(up=up, front=front))  # type: ignore[arg-type]
    centers = sorted((tuple(np.round(part.bounds.mean(axis=0), 6) + 0.0) for part in read), key=lambda c: (c[2], c[0]))
    assert centers[0] == (0.0, 0.0, 0.0)
    assert (1.0, 0.0, 0.0) in centers
    assert (0.0, 0.0, 1.0) in centers


def test_flat_things_are_fitted_and_nothing_is_not() -> None:
    plate = trimesh.creation.box((2.0, 1.0, 0.001))
    assert np.ptp(surface_of(fitted([plate], (0.4, 0.2, 0.02))).bounds, axis=0)[2] > 0
    line = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False)
    with pytest.raises(ValueError, match="no extents"):
        fitted([line], (1, 1, 1))


@pytest.fixture(scope="session")
def pipelines(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folders of tiny pipelines."""
    pytest.importorskip("torch")
    pytest.importorskip("diffusers")
    return made_once(tmp_path_factory, "tiny_shap_e", write_pipelines)


@pytest.mark.whole
@pytest.mark.parametrize("by", ["text", "image"])
def test_shap_e_makes_the_same_asset_of_the_same_seed(room: Room, pipelines: Path, by: Any) -> None:
    config = ShapE(weights=str(pipelines / by), by=by, steps=2, grid=16, device="cpu", pixels=64)
    row, outcome = offered(room, config)
    assert row.outcome == "filled", row.reason
    (asset,) = outcome.rows["assets"]
    assert (asset.provider, asset.license, asset.author, asset.is_watertight) == ("shap_e", "MIT", "OpenAI", True)
    again, _ = offered(room, config)
    assert lasting(again) == lasting(row), "from scratch, with another ledger"
    other, _ = offered(room, dataclasses.replace(config, seed=1))
    assert other.call_id != row.call_id


@pytest.mark.whole
def test_shap_e_says_what_is_wrong_with_its_folder(room: Room, pipelines: Path, tmp_path: Path) -> None:
    (tmp_path / "model.safetensors").write_bytes(b"x")
    for weights, by, said in (("", "text", "names no folder"), (str(tmp_path), "text", "holds no ShapEPipeline"),
                              (str(tmp_path / "no"), "text", "holds no"), (str(pipelines / "text"), "image", "")):  # fmt: skip
        row, _ = offered(room, ShapE(weights=weights, by=by, steps=2, grid=16, device="cpu"))  # type: ignore[arg-type]
        assert row.outcome == "failed", row
        assert said in str(row.reason)
