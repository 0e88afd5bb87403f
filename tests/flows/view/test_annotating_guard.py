"""Who may ask what of the annotation page, route by route; and forged requests, which change nothing and run nothing."""

from __future__ import annotations

import asyncio
import itertools
import json
import math
import random
import re
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi import Request
from hypothesis import given
from hypothesis import strategies as st

from flows.inputs.annotation import save_answers
from flows.view import bundle
from flows.view.annotating import requests
from flows.view.annotating.drafts import Drafts
from flows.view.annotating.people import ANNOTATOR, REVIEWER
from flows.view.annotating.photos import photo_camera
from flows.view.annotating.work import ServedBatch
from schemas.capture import Frame, Instance
from schemas.errors import InputError
from tasks.capture.instances.views import view_of
from tasks.geometry.transforms import flat, inverse, look_at, transform_points, translation
from tasks.geometry.windows import view_window
from tests.annotated import SCENES, answer
from tests.flows.view import asked
from tests.flows.view.batches import BATCH, ORIGIN, PORT, Desk, asked_lake, digests, stand_in
from tests.samples import sample

OBJECT = "{dataset}/{scan}/{instance}"
OPEN = {
    "/", "/client/{name}", "/blobs/{name}", "/thumbnails/{name}", "/points/{name}", "/photos/{name}", "/api/me", "/api/progress",
    f"/api/photos/{OBJECT}/{{frame}}",
    "/api/scenes", "/api/scenes/{dataset}/{scan}", "/api/scenes/{dataset}/{scan}/objects/{instance}",
    "/api/scenes/{dataset}/{scan}/frames/{frame}", "/api/scenes/{dataset}/{scan}/frames/{frame}/picture",
}  # fmt: skip
ROLES = dict.fromkeys(OPEN, "") | {
    "/api/work": ANNOTATOR, f"/api/drafts/{OBJECT}": ANNOTATOR, f"/api/answers/{OBJECT}": ANNOTATOR, f"/api/figures/{OBJECT}": ANNOTATOR,
    f"/api/settle/{OBJECT}": ANNOTATOR, "/api/submit": ANNOTATOR, "/api/sample": REVIEWER, "/api/reviews": REVIEWER,
    f"/api/verdicts/{OBJECT}/{{annotator:path}}": REVIEWER, "/api/conclude": REVIEWER,
}  # fmt: skip
"""Who may ask each route: everybody of the batch, or one role alone."""


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Desk]:
    folder = tmp_path_factory.mktemp("desk")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bundle, "BUILT", stand_in(folder / "built"))
        yield Desk(folder)


def filled(path: str, key: str) -> str:
    """A route's path with an object in it."""
    dataset, scan, instance = key.split("/")
    names = {"dataset": dataset, "scan": scan, "instance": instance, "annotator:path": "ada", "frame": "000000", "name": "view.js"}
    return re.sub(r"\{([^}]+)\}", lambda match: names[match[1]], path)


def test_every_route_has_a_role(desk: Desk) -> None:
    assert {path for _, path in desk.routes()} == set(ROLES)


def test_without_a_token_nothing_is_seen_or_changed(desk: Desk) -> None:
    before = digests(desk.folder / "lake")
    for method, path in desk.routes():
        place, other = filled(path, desk.own("ada")), {"origin": ORIGIN}
        for headers, params in ((other, {}), (other, {"token": "guess"}), (other | {"cookie": f"metascenes_{PORT}=guess"}, {}),
                                (other | {"authorization": f"Bearer {desk.tokens['ada']}"}, {})):  # fmt: skip
            refused = desk.stranger().request(method, place, headers=headers, params=params, json={"choice": 1, "edit": 1})
            assert refused.status_code == 401, (method, path)
            assert "room_a" not in refused.text
            assert "set-cookie" not in refused.headers
    assert digests(desk.folder / "lake") == before


def test_pages_of_others_are_refused_with_a_token_too(desk: Desk) -> None:
    ada = desk.client("ada")
    for method, path in desk.routes():
        answered = ada.request(method, filled(path, desk.own("ada")), headers={"origin": "https://evil.example"}, json={})
        assert answered.status_code == 403, (method, path)


def test_roles_are_held_route_by_route(desk: Desk) -> None:
    before, key = digests(desk.folder / "lake"), desk.own("ada")
    for method, path in desk.routes():
        for name, held in desk.work.roles.items():
            if ROLES[path] and ROLES[path] not in held:
                refused = desk.client(name).request(method, filled(path, key), json={"choice": 1, "edit": 1})
                assert refused.status_code == 403, (method, path, name)
                assert refused.json() == {"error": f"{name} is no {ROLES[path]} of this batch"}
    assert digests(desk.folder / "lake") == before


@pytest.mark.slow
@pytest.mark.whole
def test_a_thousand_forged_requests_change_nothing_and_run_nothing(desk: Desk) -> None:
    """From people of the batch: paths that climb, ids of nothing, objects and answers of others, wrong values, odd bodies, scripts."""
    clients = {name: desk.client(name) for name in desk.work.roles}
    desk.drafts.save(tuple(desk.own("ada").rsplit("/", 1)), "ada", {"choice": 1}, 7, "p")  # type: ignore[arg-type]
    before, snapshot = digests(desk.folder), desk.lake.snapshot().snapshot_id
    started: list[str] = []
    watching = [True]
    names = {"subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.fork"}
    sys.addaudithook(lambda event, _: started.append(event) if watching[0] and event in names else None)
    codes = set()
    for name, method, path, content, kind in itertools.islice(_forged(random.Random(0), desk), 1000):
        answered = clients[name].request(method, path, content=content, headers={"content-type": kind})
        codes.add(answered.status_code)
        assert answered.status_code in (400, 403, 404, 405, 409, 413), (
            name,
            method,
            path,
            content[:200],
            answered.status_code,
            answered.text,
        )
        assert answered.headers["content-type"].startswith("application/json")
        assert b"Traceback" not in answered.content
        assert b"\n" not in answered.content
    watching[0] = False
    assert codes == {400, 403, 404, 405, 409, 413}
    assert started == []
    assert desk.lake.snapshot().snapshot_id == snapshot
    assert digests(desk.folder) == before, "byte for byte"


SOUND: dict[str, Any] = {"choice": 1, "transform": None, "ranking": [1, 2], "seconds": 3.5}
WRONG: list[dict[str, Any]] = [
    {"choice": 0}, {"choice": 11}, {"choice": "<script>"}, {"choice": True}, {"choice": [1]}, {"choice": "A" * 64}, {"choice": 1.5},
    {"ranking": [1, 1]}, {"ranking": "1"}, {"ranking": [None]}, {"ranking": [[1]]}, {"seconds": -1}, {"seconds": 1e9}, {"seconds": "1"},
    {"transform": []}, {"transform": {}}, {"transform": {"position": [0, 0, 0], "scale": [1, 1, 1]}},
    {"transform": {"position": [0, 0], "yaw_degrees": 0, "scale": [1, 1, 1]}},
    {"transform": {"position": [0, 0, 1e7], "yaw_degrees": 0, "scale": [1, 1, 1]}},
    {"transform": {"position": [0, 0, 0], "yaw_degrees": 0, "scale": [1, 0, 1]}},
    {"transform": {"position": [0, 0, 0], "yaw_degrees": 0, "rotation_wxyz": [1, 0, 0, 0], "scale": [1, 1, 1]}},
    {"transform": {"position": [0, 0, 0], "rotation_wxyz": [2, 0, 0, 0], "scale": [1, 1, 1]}},
    {"choice": None, "transform": {"position": [0, 0, 0], "yaw_degrees": 0, "scale": [1, 1, 1]}},
    {"annotator": "bob"}, {"scene_id": "demo/room_b"}, {"answered_at": "2020-01-01T00:00:00Z"}, {"batch_id": "b2"}, {"simulated": False},
    {"tool": "x"}, {"__proto__": {}}, {"edit": -1}, {"edit": 1.5}, {"edit": True}, {"edit": 2**60}, {"edit": "1"}, {"page": "a b"},
    {"page": 1}, {"page": "x" * 65}, {"\u202e": 1}, {"x" * 5000: 1},
]  # fmt: skip
"""What no request may set, beside what is sound."""


def _forged(draw: random.Random, desk: Desk) -> Iterator[tuple[str, str, str, bytes, str]]:
    """Who asks, method, path, body and its kind: each is wrong in one way at least."""
    words = ["..%2f" * 6 + "etc%2fpasswd", "%2e%2e%2flake.json", "%00", "%3Cscript%3E", "%27%3B%20DROP%20TABLE%20drafts--", "b1.sqlite",
             "9" * 300, "-1", "%F0%9F%92%A3" * 3, "9999", "x" * 2000]  # fmt: skip
    writing = [("PUT", "/api/drafts/"), ("POST", "/api/answers/"), ("POST", "/api/figures/"), ("POST", "/api/settle/")]
    scene, secret = SCENES[0], desk.lake.snapshot().rows(Instance)[0].points_blob
    sound = json.dumps(SOUND | {"edit": 1, "page": "q"}).encode()
    while True:
        method, base = draw.choice(writing)
        own, strange, kind = desk.own("ada"), desk.own("bob"), "application/json"
        match draw.randrange(9):
            case 0:  # ids of nothing
                place = draw.choice(
                    [f"{scene}/{draw.choice(words)}", f"demo/{draw.choice(words)}/0001", f"{draw.choice(words)}/room_a/0001"]
                )
                yield "ada", method, base + place, sound, kind
            case 1:  # objects of others
                yield "ada", method, base + strange, sound, kind
            case 2:  # wrong values
                yield "ada", method, base + own, json.dumps({"edit": 9} | SOUND | draw.choice(WRONG)).encode(), kind
            case 3:  # odd bodies
                odd = [b"", b"[]", b"null", b"{", b"\xff\xfe", b'{"choice": NaN, "edit": 9}', b'{"seconds": 1e999, "choice": 1, "edit": 9}',
                       b'{"choice": 1, "choice": 2, "edit": 9}', b"[" * 20_000, b'{"choice": ' + b"9" * 6000 + b"}",
                       b'{"ranking": "' + b"x" * requests.MOST_BYTES + b'"}']  # fmt: skip
                yield "ada", method, base + own, draw.choice(odd), kind
            case 4:  # other kinds, as forms of other sites send them
                kinds = ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x", ""]
                yield "ada", method, base + own, sound, draw.choice(kinds)
            case 5:  # acts that are not theirs, or not now
                acts = [
                    ("ada", "POST", "/api/sample", b"{}"),
                    ("ada", "POST", "/api/conclude", b"{}"),
                    ("rita", "POST", "/api/submit", b"{}"),
                    ("rita", "POST", "/api/conclude", b"{}"),
                    ("rita", "POST", "/api/sample", b"{}"),
                    ("ada", "POST", "/api/submit", b"{}"),
                    ("ada", "POST", "/api/submit", b'{"by": "bob"}'),
                    ("ada", "POST", "/api/submit", b'{"partial": "yes"}'),
                    ("rita", "GET", "/api/work", b""),
                    ("ada", "GET", "/api/reviews", b""),
                    ("rita", "DELETE", f"/api/drafts/{own}", b""),
                    ("ada", "DELETE", f"/api/drafts/{strange}", b""),
                    ("ada", "POST", f"/api/answers/{own}", b'{"withdrawn": true}'),
                ]
                yield *draw.choice(acts), kind
            case 6:  # verdicts on what was not drawn, by nobody, as others
                verdicts: list[Any] = [{"passes": True}, {"passes": 1}, {"passes": False}, {"passes": True, "by": "x"}, {"remark": "x"},
                                       {"passes": False, "remark": "x" * 3000}]  # fmt: skip
                who = draw.choice(["ada", "bob", "rita", *words])
                body = json.dumps(draw.choice(verdicts)).encode()
                yield draw.choice(["rita", "bob"]), "PUT", f"/api/verdicts/{draw.choice([own, strange])}/{who}", body, kind
            case 7:  # files that the batch does not show
                files = [*words, secret.replace(".ply", ".glb"), "0" * 64 + ".glb", "0" * 64 + ".jpg", "lake.json", "b1.sqlite.tokens"]
                folder = draw.choice(["/blobs/", "/thumbnails/", "/photos/", "/client/", "/api/scenes/", "/api/scenes/demo/"])
                yield draw.choice(["ada", "rita"]), "GET", folder + draw.choice(files), b"", kind
            case 8:  # methods that there are not
                other = draw.choice(["PATCH", "OPTIONS", "TRACE"])
                yield "ada", other, base + own, sound, kind


def test_who_sends_no_more_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requests, "MOST_SECONDS", 0.01)

    async def stalled() -> Any:
        await asyncio.Event().wait()

    scope = {"type": "http", "method": "PUT", "headers": [(b"content-type", b"application/json")]}
    with pytest.raises(requests.Refusal) as caught:
        asyncio.run(requests.json_body(Request(scope, stalled)))
    assert caught.value.status == 408


@given(
    box=st.tuples(st.integers(0, 600), st.integers(0, 400), st.integers(1, 40), st.integers(1, 80)),
    eye=st.tuples(st.floats(-3, 3), st.floats(-3, 3), st.floats(0.5, 2)),
)  # fmt: skip
def test_a_camera_sees_what_the_photo_shows(box: tuple[int, ...], eye: tuple[float, ...]) -> None:
    """Its middle is the photo's, and its angle spans the photo's height."""
    x0, y0, x1, y1 = box[0], box[1], box[0] + box[2], box[1] + box[3]
    pose = look_at(eye, (0.1, 0.2, 0.4))
    frame = sample(Frame, width=640, height=480, intrinsics=(500.0, 510.0, 320.0, 240.0), pose=flat(pose))
    instance = sample(Instance, box_pose=flat(translation((0.0, 0.0, 0.4))))
    camera = photo_camera(frame, view_window((x0, y0, x1, y1), 640, 480), instance)
    shown = view_of(np.dstack([*np.meshgrid(np.arange(640), np.arange(480)), np.zeros((480, 640))]).astype(np.int64), (x0, y0, x1, y1))
    (left, top), (right, bottom) = shown[0, 0, :2], shown[-1, -1, :2] + 1
    x, y, z = transform_points([camera["target"]], inverse(pose))[0]
    assert (500 * x / z + 320, 510 * y / z + 240) == pytest.approx(((left + right) / 2, (top + bottom) / 2), abs=1e-6)
    rays = [math.degrees(math.atan((edge - 240) / 510)) for edge in (top, bottom)]
    assert camera["fov_degrees"] == pytest.approx(rays[1] - rays[0])
    assert camera["position"] == pytest.approx(eye)


def test_points_are_served_as_points_alone(desk: Desk) -> None:
    ada = desk.client("ada")
    blob = desk.lake.snapshot().rows(Instance)[0].points_blob
    assert ada.get(f"/points/{blob}").content == desk.lake.blobs[blob]
    for folder in ("blobs", "photos", "thumbnails"):
        assert ada.get(f"/{folder}/{blob}").status_code == 404


def test_many_ask_for_the_same_pictures_at_once(desk: Desk) -> None:
    """Each is drawn once, by whoever asks first."""
    names = [f"/thumbnails/{name}.jpg" for name in desk.work.assets]
    clients = [desk.client(name) for name in desk.work.roles] * 2
    with ThreadPoolExecutor(len(clients)) as pool:
        answers = list(pool.map(lambda client: [client.get(name) for name in names], clients))
    assert {answered.status_code for row in answers for answered in row} == {200}
    assert all(len({row[index].content for row in answers}) == 1 for index in range(len(names)))


@pytest.mark.parametrize("name", ["nobody", "elsewhere"])
def test_what_cannot_be_served_is_named(tmp_path: Path, name: str) -> None:
    lake = asked_lake(tmp_path)
    save_answers(lake, {"batch_id": "elsewhere", "annotations": [answer(SCENES[0], "0001", "eve", 1)]})
    drafts = Drafts(tmp_path / "drafts.sqlite", name)
    with pytest.raises(InputError, match="is not in the lake" if name == "nobody" else "was made elsewhere"):
        ServedBatch(lake, name, drafts, [])
    drafts.close()


def test_a_batch_shows_its_own_scenes_alone(tmp_path: Path) -> None:
    lake = asked_lake(tmp_path, scenes=(SCENES[0],))
    drafts = Drafts(tmp_path / "drafts.sqlite", BATCH)
    scenes = ServedBatch(lake, BATCH, drafts, []).scenes
    assert [row["id"] for row in scenes.listed()["scenes"]] == [SCENES[0]] == [scenes.first()]
    assert scenes.shown(SCENES[0]).document["id"] == SCENES[0]
    for ask in (scenes.shown, scenes.scan_path, lambda scene: scenes.masks(scene, "000000")):
        with pytest.raises(InputError, match="is no scene of this batch"):
            ask(SCENES[1])
    drafts.close()


def test_a_batch_shows_other_photos_of_its_objects(tmp_path: Path) -> None:
    lake = asked.asked_lake(tmp_path, scenes=asked.SCENES[:1])
    drafts = Drafts(tmp_path / "drafts.sqlite", asked.BATCH)
    photos = [row["photos"] for row in ServedBatch(lake, asked.BATCH, drafts, [])._objects.values()]
    assert max(map(len, photos)) > 1, "beside the best one"
    drafts.close()
