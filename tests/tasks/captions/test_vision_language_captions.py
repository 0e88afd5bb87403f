"""Captions by a vision-language model, asked of a server that runs here: what it is told, what is believed, who stands in."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest

from bench.models.replies import BEHAVES, LOOKS, SIZE, looks_figures, physics_figures
from schemas.captions import Caption
from schemas.errors import InputError
from schemas.record import check
from tasks import captions
from tasks.calls.exchange import EndpointAway
from tasks.calls.ledger import Recollection
from tasks.calls.prompts import bundled_prompt
from tasks.calls.replies import UnreadableReply
from tasks.captions import CaptionsConfig, VisionLanguageCaptions, run
from tasks.captions.wording import APPEARANCE, PHYSICS, Appearance, appearance_of, attributes_of
from tasks.stage import Context, Outcome
from tests.tasks.calls.servers import Server, refuses, says, server
from tests.tasks.selection.rooms import SCENE, Room, photographed_chair

__all__ = ["server"]

PROMPTS = Path(captions.__file__).parent


@pytest.fixture(scope="module")
def room() -> Room:
    return photographed_chair()


def captioned(room: Room, server: Server, ledger: Recollection | None = None, **more: Any) -> tuple[Caption, Outcome]:
    settings = {"url": server.url, "model": "seer-1", "pause_seconds": 0.0, "attempts": 2, "pixels": 48, **more}
    context = Context(SCENE, "captions", 0, room.blobs, ledger=ledger or Recollection())
    config = CaptionsConfig(provider=VisionLanguageCaptions(**settings))
    outcome = run(instances=room.instances, frames=room.frames, masks=room.masks, context=context, config=config)
    check(outcome.rows["captions"], Caption)
    (row,) = outcome.rows["captions"]
    return row, outcome


def classical(room: Room) -> Caption:
    context = Context(SCENE, "captions", 0, room.blobs)
    (row,) = run(instances=room.instances, frames=[], masks=[], context=context, config=CaptionsConfig()).rows["captions"]
    assert isinstance(row, Caption)
    return row


def test_a_caption_is_what_the_model_says_in_the_words_of_the_project(room: Room, server: Server) -> None:
    server.answers = [says(json.dumps(LOOKS)), says(json.dumps(BEHAVES))]
    ledger = Recollection()
    row, outcome = captioned(room, server, ledger)
    assert outcome.degradations == ()
    assert row.sentence == "A dark red wooden chair with one arm."
    assert (row.colors, row.materials) == (("dark red", "gray"), ("wood", "fabric"))
    assert (row.body_type, row.mass_kg, row.friction, row.restitution) == ("rigid", 6.5, 0.45, 0.05)
    assert (row.provider, row.provider_version, row.is_fallback) == ("vision_language", "1:seer-1", False)
    assert row.attribute_source == "model:seer-1"
    assert row.density_kg_m3 is not None
    assert row.solid_fraction is not None
    box = room.instances[0].box_size
    assert row.density_kg_m3 * row.solid_fraction * np.prod(box) == pytest.approx(6.5)
    assert {row.appearance_call_id, row.physics_call_id} == set(ledger.calls)
    assert [call.prompt for call in ledger.calls.values()] == ["appearance", "physics_corrected"]


def test_it_is_shown_the_crop_and_told_label_and_size(room: Room, server: Server) -> None:
    server.answers = [says(json.dumps(LOOKS)), says(json.dumps(BEHAVES))]
    captioned(room, server)
    looks, behaves = (body for _, _, body in server.requests)
    text, picture = looks["messages"][0]["content"]
    sides = " x ".join(f"{side:.2f}" for side in room.instances[0].box_size)
    assert '"chair"' in text["text"]
    assert sides in text["text"]
    shown = PIL.Image.open(io.BytesIO(base64.b64decode(picture["image_url"]["url"].partition(",")[2])))
    assert shown.size == (48, 48)
    assert looks["response_format"]["json_schema"]["schema"] == APPEARANCE
    asked = behaves["messages"][0]["content"]
    assert sides in asked
    assert "A dark red wooden chair with one arm." in asked
    assert behaves["response_format"]["json_schema"]["schema"] == PHYSICS


def test_what_cannot_be_is_asked_once_more_with_the_reason(room: Room, server: Server) -> None:
    heavy = {"physics_attributes": {**BEHAVES["physics_attributes"], "mass": 1500}}
    server.answers = [says(json.dumps(LOOKS)), says(json.dumps(heavy)), says(json.dumps(BEHAVES))]
    row, outcome = captioned(room, server)
    assert (row.mass_kg, outcome.degradations) == (6.5, ())
    assert "kg/m3" in server.requests[2][2]["messages"][-1]["content"]


def test_where_no_reply_is_of_use_the_classical_caption_stands_in_and_says_so(room: Room, server: Server) -> None:
    server.answers = [says("I cannot tell.")]
    row, outcome = captioned(room, server)
    plain = classical(room)
    assert row == dataclasses.replace(plain, is_fallback=True)
    assert len(server.requests) == 4, "each was asked twice"
    assert len(outcome.degradations) == 2
    assert all("gave no reply that can be used" in line and line.endswith("the classical one stands in") for line in outcome.degradations)


def test_half_of_it_may_be_the_models(room: Room, server: Server) -> None:
    server.answers = [says(json.dumps(LOOKS)), says("no"), says("no")]
    row, outcome = captioned(room, server)
    plain = classical(room)
    assert row.sentence.startswith("A dark red")
    assert (row.mass_kg, row.attribute_source) == (plain.mass_kg, plain.attribute_source)
    assert row.is_fallback
    assert row.physics_call_id is None
    assert row.appearance_call_id is not None
    assert len(outcome.degradations) == 1


def test_an_endpoint_that_is_away_stops_the_scene_only_where_that_is_wanted(room: Room, server: Server) -> None:
    server.answers = [refuses(503)]
    row, outcome = captioned(room, server)
    assert row.is_fallback
    assert "no answer after 2 tries" in outcome.degradations[0]
    with pytest.raises(EndpointAway):
        captioned(room, server, away="retry")
    server.answers = [refuses(401)]
    with pytest.raises(InputError, match="HTTP 401"):
        captioned(room, server)


def test_every_call_is_recorded_with_what_came_of_it(room: Room, server: Server) -> None:
    ledger = Recollection()
    usage = {"prompt_tokens": 500, "completion_tokens": 50}
    told = {"choices": [{"message": {"content": json.dumps(LOOKS)}}], "usage": usage}
    server.answers = [refuses(500), lambda body: (200, told, {}), refuses(503)]
    captioned(room, server, ledger, prompt_usd_per_million=1.0, reply_usd_per_million=4.0)
    looks, behaves = ledger.calls.values()
    assert (looks.outcome, looks.attempts, looks.prompt_tokens, looks.reply_tokens) == ("answered", 2, 500, 50)
    assert looks.cost_usd == pytest.approx(0.0007)
    assert (behaves.outcome, behaves.attempts, behaves.cost_usd) == ("away", 2, 0.0)
    assert behaves.problem is not None
    assert "HTTP 503" in behaves.problem
    assert looks.prompt_version == bundled_prompt(PROMPTS / "appearance.txt").version


def test_what_was_answered_is_not_asked_again_and_what_was_not_is(room: Room, server: Server) -> None:
    ledger = Recollection()
    server.answers = [says(json.dumps(LOOKS)), refuses(503)]
    first, _ = captioned(room, server, ledger)
    assert first.is_fallback
    server.requests.clear()
    server.answers = [says(json.dumps(BEHAVES))]
    second, _ = captioned(room, server, ledger)
    assert len(server.requests) == 1
    assert not second.is_fallback
    server.requests.clear()
    third, _ = captioned(room, server, ledger, url="http://127.0.0.1:9/v1")
    assert third == second, "an address may move"
    assert not server.requests


def test_a_call_is_known_by_what_its_picture_shows_not_by_how_it_is_packed(
    room: Room, server: Server, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.answers = [says(json.dumps(LOOKS)), says(json.dumps(BEHAVES))]
    ledger = Recollection()
    first, _ = captioned(room, server, ledger)
    save = PIL.Image.Image.save
    monkeypatch.setattr(PIL.Image.Image, "save", lambda self, file, kind: save(self, file, kind, compress_level=0))
    server.requests.clear()
    again, _ = captioned(room, server, ledger)
    assert again == first
    assert not server.requests
    captioned(room, server, ledger, pixels=49)
    assert server.requests


def test_prompts_are_addressed_to_a_model() -> None:
    """Not to whoever reads the code: no name of it stands in them."""
    for name in ("appearance", "physics_corrected", "physics_paraphrased"):
        text = bundled_prompt(PROMPTS / f"{name}.txt").text
        assert re.search(r"\bAnswer (with|in)\b", text)
        assert not re.search(r"\b[a-z]+[A-Z]|\b[A-Z][a-z]+[A-Z]|_[a-z]+_", re.sub(r"\{\w+[^}]*\}", "", text)), text


def test_a_number_without_end_is_none() -> None:
    """It is in the ledger: what cannot be read must be refused, not fail the scene for ever."""
    reply = '{"physics_attributes": {"category": "Rigid Body", "mass": 5' + 400 * "0" + ', "friction": 0.4, "bounciness": 0}}'
    with pytest.raises(UnreadableReply):
        attributes_of(reply, SIZE)


@pytest.mark.parametrize("twice", ['"Mass": 12.5', '"mass ": 12.5', '"mass": 12.5'])
def test_a_field_that_is_there_twice_is_refused_however_it_is_spelled(twice: str) -> None:
    reply = '{"category": "Rigid Body", "mass": 6.5, ' + twice + ', "friction": 0.4, "bounciness": 0}'
    with pytest.raises(UnreadableReply, match="twice"):
        attributes_of(reply, SIZE)


@pytest.mark.parametrize("told", [{"url": "ftp://x"}, {"model": ""}])
def test_settings_that_name_no_endpoint_are_refused(room: Room, server: Server, told: dict[str, str]) -> None:
    with pytest.raises(InputError, match=r"^captions\.provider"):
        captioned(room, server, **told)


FORMS = [
    (json.dumps(BEHAVES), 6.5),
    (f"```json\n{json.dumps(BEHAVES)}\n```", 6.5),
    ("{'physics_attributes': {'category': 'rigid', 'mass': '6.5 kg', 'friction': '0.45', 'bounciness': False,},}", 6.5),
    ('{"physics_attributes": [{"Category": "Rigid_Body", "Mass": [6500], "friction": 0.45, "bounciness": "0"}]}', None),
    ('{"physics_attributes": {"category": "rigid body", "mass": "6500 g", "friction": 0.45, "bounciness": 0}}', 6.5),
    ('{"category": "Rigid Body", "mass": 6.5, "friction": 0.45, "bounciness": 0}', 6.5),
    ("{“physics_attributes”: {“category”: “Rigid Body”, “mass”: 6.5, “friction”: 0.45, “bounciness”: 0}}", 6.5),
    ('Sure! {"physics_attributes": {"category": "Rigid Body", "mass": 6.5, "friction": 0.45, "bounciness": 0}', None),
    ('Sure! {"physics_attributes": {"category": "Rigid Body", "friction": 0.45, "bounciness": 0, "mass": 6', None),
]


@pytest.mark.parametrize(("reply", "mass"), FORMS)
def test_replies_are_read_whatever_their_form(reply: str, mass: float | None) -> None:
    if mass is None:
        with pytest.raises(UnreadableReply):
            attributes_of(reply, SIZE)
        return
    told = attributes_of(reply, SIZE)
    assert (told.body_type, told.mass_kg, told.friction, told.is_bouncy) == ("rigid", mass, 0.45, False)


REFUSED = [
    {"mass": "6.5 lb"}, {"mass": "1,200"}, {"mass": float("nan")}, {"mass": float("inf")}, {"mass": -1}, {"mass": 0}, {"mass": 1e6},
    {"mass": True}, {"mass": None}, {"mass": [1, 2]}, {"friction": 1.4}, {"friction": -0.1}, {"friction": "0.4 kg"},
    {"bounciness": 0.5}, {"bounciness": 7}, {"category": "Liquid"}, {"category": ""}, {"bounciness": 1, "mass": 80}, {"mass": 0.02},
]  # fmt: skip


@pytest.mark.parametrize("change", REFUSED, ids=str)
def test_what_no_object_is_like_is_refused(change: dict[str, Any]) -> None:
    reply = json.dumps({"physics_attributes": {**BEHAVES["physics_attributes"], **change}})
    with pytest.raises(UnreadableReply):
        attributes_of(reply, SIZE)


def test_a_user_can_supply_the_words_that_ask_for_physical_attributes(room: Room, server: Server, tmp_path: Path) -> None:
    words = tmp_path / "mine.txt"
    words.write_text("Mass of a {category} of {length} x {width} x {height} m?{about}")
    server.answers = [says(json.dumps(LOOKS)), says(json.dumps(BEHAVES))]
    ledger = Recollection()
    captioned(room, server, ledger, physics_prompt_file=str(words))
    text = server.requests[-1][2]["messages"][0]["content"]
    assert re.fullmatch(r'Mass of a chair of \d\.\d\d x \d\.\d\d x \d\.\d\d m\? It was described so: ".+"', text)
    assert [call.prompt for call in ledger.calls.values()] == ["appearance", "mine"]


def test_the_paraphrased_prompt_has_friction_above_one() -> None:
    reply = json.dumps({"physics_attributes": {**BEHAVES["physics_attributes"], "friction": 1.4}})
    assert attributes_of(reply, SIZE, most_friction=2.0).friction == 1.4


@pytest.mark.parametrize("seed", range(5))
def test_two_hundred_corruptions_are_read_rightly_or_refused(seed: int) -> None:
    physics, looks = physics_figures(200, seed), looks_figures(200, seed)
    assert physics.wrong == looks.wrong == 0
    assert physics.read >= 30
    assert looks.read >= 50


@pytest.mark.parametrize(
    ("colors", "known"),
    [(["light grey"], ("light gray",)), (["oak brown", "brown"], ("brown",)), (["mint"], ()), ("red and white", ("red", "white")),
     (["red", "blue", "green", "black"], ("red", "blue", "green"))],
)  # fmt: skip
def test_colors_are_those_that_the_project_has_words_for(colors: Any, known: tuple[str, ...]) -> None:
    told = appearance_of(json.dumps({**LOOKS, "colors": colors}))
    assert isinstance(told, Appearance)
    assert told.colors == known
