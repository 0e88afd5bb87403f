"""A vision-language model's pick, asked of a server that runs here: what is sent, what is read, what is tried again."""

from __future__ import annotations

import base64
import io
import json
import random
from typing import Any

import numpy as np
import PIL.Image
import pytest

from schemas.errors import InputError
from tasks.calls.endpoint import Endpoint
from tasks.calls.exchange import EndpointAway
from tasks.calls.replies import UnreadableReply
from tasks.geometry.transforms import yaw_pose
from tasks.selection import SelectionConfig
from tasks.selection.methods.ranking import ranking_of
from tasks.selection.methods.vision_language import SCHEMA, VisionLanguage
from tasks.stage import Context
from tests.tasks.calls.servers import Server, asking, refuses, says, server
from tests.tasks.selection.rooms import RED, SCENE, Room, cabinet, chair, photographed, scan, shelf, table

__all__ = ["server"]


@pytest.fixture(scope="module")
def room() -> Room:
    made, pose = Room(), yaw_pose(0.4)
    points, colors = scan(chair(RED), pose, (1, 1, 1), np.random.default_rng(0))
    instance = made.instance(points, colors, 0.4, category="chair")
    for slot, parts in enumerate((table(), chair(RED), cabinet(), shelf()), start=1):
        made.candidate(instance, slot, made.asset(parts, f"model {slot}"))
    photographed(made, instance, chair(RED), pose, (2.4, 1.3, 1.6))
    return made


def config(server: Server, **more: Any) -> SelectionConfig:
    return SelectionConfig(provider=VisionLanguage(**{"url": server.url, "model": "seer-1", "pause_seconds": 0.0, "pixels": 48, **more}))


def test_the_models_order_comes_first_and_geometry_orders_the_rest(room: Room, server: Server) -> None:
    server.answers = [says('{"choice": 3, "ranking": [3, 1]}')]
    rows, degradations = room.select(config(server))
    assert degradations == ()
    assert [row.slot for row in rows[:2]] == [3, 1]
    rest = [row.slot for row in room.select()[0] if row.slot in (2, 4)]
    assert [row.slot for row in rows[2:]] == rest
    assert {(row.provider, row.provider_version) for row in rows} == {("vision_language", "1:seer-1")}
    assert all(0 <= row.score <= 1 for row in rows)


def test_it_is_shown_the_crop_and_every_candidate_with_its_number(room: Room, server: Server) -> None:
    server.answers = [says('{"choice": 1, "ranking": [1]}')]
    room.select(config(server))
    ((path, headers, body),) = server.requests
    assert path == "/v1/chat/completions"
    assert "Authorization" not in headers
    assert (body["model"], body["temperature"]) == ("seer-1", 0)
    assert body["response_format"] == {"type": "json_schema", "json_schema": {"name": "reply", "strict": True, "schema": SCHEMA}}
    (message,) = body["messages"]
    texts = [part["text"] for part in message["content"] if part["type"] == "text"]
    pictures = [part["image_url"]["url"] for part in message["content"] if part["type"] == "image_url"]
    assert len(pictures) == 5
    assert [text.split(",")[0] for text in texts[1:5]] == [f"Candidate {n}" for n in (1, 2, 3, 4)]
    assert "chair" in texts[0]
    decoded = [PIL.Image.open(io.BytesIO(base64.b64decode(url.removeprefix("data:image/png;base64,")))) for url in pictures]
    assert [picture.size for picture in decoded] == [(48, 48)] + 4 * [(96, 48)]


def test_the_key_comes_from_the_environment_and_goes_nowhere_else(room: Room, server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SEER_KEY", "secret-123")
    server.answers = [refuses(401)]
    told = config(server, key_variable="SEER_KEY")
    with pytest.raises(InputError) as refused:
        room.select(told)
    assert server.requests[0][1]["Authorization"] == "Bearer secret-123"
    assert "secret" not in str(refused.value) + repr(told) + repr(asking(server, key="secret-123"))
    assert "HTTP 401" in str(refused.value)
    monkeypatch.delenv("SEER_KEY")
    with pytest.raises(InputError, match="SEER_KEY holds no key"):
        room.select(told)
    with pytest.raises(InputError, match="credentials"):
        Endpoint("http://user:pass@127.0.0.1:9/v1", "seer-1").ask([], SCHEMA)


def test_a_reply_that_cannot_be_used_is_asked_for_again_with_the_reason(room: Room, server: Server) -> None:
    server.answers = [says("I like the second."), says('{"choice": 9, "ranking": []}'), says('{"choice": 2, "ranking": [2]}')]
    rows, degradations = room.select(config(server))
    assert (rows[0].slot, degradations) == (2, ())
    sent = [[message["role"] for message in body["messages"]] for _, _, body in server.requests]
    assert sent == [["user"], ["user", "assistant", "user"], ["user", "assistant", "user", "assistant", "user"]]
    assert "there is no candidate 9" in server.requests[2][2]["messages"][-1]["content"]


def test_when_no_reply_can_be_used_geometry_stands_in_and_the_row_says_so(room: Room, server: Server) -> None:
    server.answers = [says("no idea")]
    rows, degradations = room.select(config(server, replies=2))
    assert rows == room.select()[0]
    assert len(server.requests) == 2
    (text,) = degradations
    assert text.startswith("0000: vision_language: seer-1 gave 2 replies that cannot be used: it holds no JSON object")
    assert text.endswith("scored by geometric")


def test_the_same_request_is_sent_once(room: Room, server: Server) -> None:
    server.answers = [says('{"choice": 4, "ranking": [4]}')]
    context = Context(SCENE, "selection", 0, room.blobs)
    first, _ = room.select(config(server), context=context)
    again, _ = room.select(config(server), context=context)
    assert first == again
    assert len(server.requests) == 1
    room.select(config(server, model="seer-2"), context=context)
    assert len(server.requests) == 2


def test_an_endpoint_that_stays_away_fails_the_scene(room: Room, server: Server) -> None:
    server.answers = [refuses(503)]
    with pytest.raises(EndpointAway, match=r"no answer after 3 tries: HTTP 503"):
        room.select(config(server, attempts=3))
    assert len(server.requests) == 3
    assert issubclass(EndpointAway, ConnectionError), "such errors are tried again in the next run"


@pytest.mark.parametrize("told", [{"url": "file:///etc/passwd"}, {"url": ""}, {"model": ""}, {"url": "http://a:secret@127.0.0.1/v1"}])
def test_addresses_that_are_none_are_refused_before_anything_is_done(told: dict[str, str]) -> None:
    with pytest.raises(InputError, match=next(iter(told))) as refused:
        Room().select(SelectionConfig(provider=VisionLanguage(**{"url": "http://127.0.0.1/v1", "model": "seer-1", **told})))
    assert "secret" not in str(refused.value)


READ = [
    ('{"choice": 2, "ranking": [2, 5, 1]}', (2, 5, 1)),
    ('```json\n{"choice": 2, "ranking": [2, 5, 1]}\n```', (2, 5, 1)),
    ('I would take {this} one:\n{"choice": "2", "ranking": ["Candidate 2", 5.0]} because it fits', (2, 5)),
    ("{'choice': 2, 'ranking': [2, 5,],}", (2, 5)),
    ("{“choice”: 2, “ranking”: [2]}", (2,)),
    ('{"Choice": 2, "reason": "a } in a text", "ranking": null}', (2,)),
    ('{"choice": 2, "ranking": [2, 5', (2, 5)),
    ('{"choice": [2], "ranking": [{"candidate": 2}, {"candidate": 3}]}', (2, 3)),
    ('{"ranking": [4, 1]}', (4, 1)),
    ('{"choice": 2, "ranking": [5, 1]}', (2, 5, 1)),
    ('{"choice": 3, // the best\n "ranking": [3]}', (3,)),
]


@pytest.mark.parametrize(("reply", "order"), READ)
def test_replies_are_read_whatever_their_form(reply: str, order: tuple[int, ...]) -> None:
    assert ranking_of(reply, 5) == order


REFUSED = [
    "", "the second", "{}", "[1, 2]", '{"choice": 6, "ranking": []}', '{"choice": 0, "ranking": []}', '{"choice": true, "ranking": []}',
    '{"choice": 2, "ranking": [2, 2]}', '{"choice": 2, "ranking": [3, 3]}', '{"choice": 2, "ranking": [1, 2]}', '{"choice": 2.5}',
    '{"choice": "2 or 3"}', '{"choice": "-2"}', '{"choice": NaN}', '{"choice": 1e400}', "{" * 5000, '{"choice": ' * 500,
    '{"choice": __import__("os").getpid()}',
]  # fmt: skip


@pytest.mark.parametrize("reply", REFUSED)
def test_replies_that_say_something_else_are_refused(reply: str) -> None:
    with pytest.raises(UnreadableReply):
        ranking_of(reply, 5)


def test_two_hundred_corruptions_are_read_rightly_or_refused() -> None:
    """A bracket, quote or comma deleted, inserted or doubled, fences and words around: never another order than what was meant."""
    draw = random.Random(0)
    plain = json.dumps({"choice": 7, "ranking": [7, 2, 10, 4, 1]})
    read = 0
    for _ in range(200):
        text, place = plain, draw.randrange(len(plain))
        marks = [i for i, letter in enumerate(plain) if letter in '{}[]",:']
        match draw.randrange(5):
            case 0:
                at = draw.choice(marks)
                text = plain[:at] + plain[at + 1 :]
            case 1:
                at = draw.choice(marks)
                text = plain[:at] + plain[at] + plain[at:]
            case 2:
                text = plain[:place] + draw.choice(' \n"') + plain[place:]
            case 3:
                text = f"Sure!\n```\n{plain}\n```\nHope it helps {{:)"
            case _:
                text = plain[: len(plain) - draw.randrange(3)]
        try:
            order = ranking_of(text, 10)
        except UnreadableReply:
            continue
        if order == (7, 2, 10, 4, 1):
            read += 1
        else:
            lost = [n for n in (7, 2, 10, 4, 1) if n in order]
            assert list(order) == lost, (text, order)
            assert order[0] == 7, (text, order)
    assert read >= 100
