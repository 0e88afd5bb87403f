"""Lists of what is on a support: asked of a server that runs here, read with tolerance for form and none for content, or out of a file."""

from __future__ import annotations

import base64
import io
import json
import random
from pathlib import Path
from typing import Any

import numpy as np
import PIL.Image
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.models.replies import LISTS, corrupted
from schemas.errors import InputError
from tasks.calls.exchange import EndpointAway
from tasks.calls.ledger import Recollection
from tasks.calls.replies import UnreadableReply
from tasks.capture.small_objects.items import AskedItems, ListedItems, SupportItem, ToldItems, asked_items, listed_names, names_of
from tasks.capture.small_objects.items.asked import check, conversation, prompt_of
from tasks.capture.small_objects.items.item import ITEMS, items_of, lemma, merged, united
from tasks.capture.small_objects.items.listed import item_lists, parsed_lists
from tasks.capture.small_objects.items.pictures import box_of, grown, support_picture
from tasks.capture.small_objects.supports import support_kinds
from tasks.stage import Context
from tests.tasks.calls.servers import Server, refuses, says, server

__all__ = ["server"]

DESK = np.zeros((100, 160), dtype=bool)
DESK[50:80, 40:120] = True
PICTURE = np.random.default_rng(0).integers(100, 256, (100, 160, 3), dtype=np.uint8)


def asked(server: Server, pictures: int = 1, ledger: Recollection | None = None, **more: Any) -> ToldItems:
    settings = AskedItems(url=server.url, model="seer-1", pause_seconds=0.0, attempts=2, **more)
    context = Context("demo/a", "capture", 0, {}, ledger=ledger or Recollection())
    return asked_items("desk", "0004", [(np.roll(PICTURE, i, axis=0), DESK) for i in range(pictures)], context, settings)


def listed(*items: dict[str, Any]) -> str:
    return json.dumps({"items": items})


MUG = {"item": "mug", "color": "white", "count": 1}


def test_a_model_is_shown_the_support_and_asked_for_a_strict_list(server: Server) -> None:
    server.answers = [says(listed({"item": "Coffee Mugs", "color": "White", "count": 2}, {"item": "book", "color": None, "count": 1}))]
    ledger = Recollection()
    told = asked(server, ledger=ledger)
    assert told.items == (SupportItem("coffee mug", "white", 2), SupportItem("book", ""))
    assert (told.call_ids, told.problems) == (tuple(ledger.calls), ())
    (call,) = ledger.calls.values()
    assert (call.kind, call.prompt, call.prompt_version) == ("chat", "items_corrected", prompt_of(AskedItems()).version)
    assert (call.instance_id, call.stage) == ("0004", "capture")
    ((_, _, body),) = server.requests
    assert body["response_format"]["json_schema"] == {"name": "reply", "strict": True, "schema": ITEMS}
    text, picture = body["messages"][0]["content"]
    assert "around a desk" in text["text"]
    assert "{" not in text["text"].replace('{"items"', "").replace('{"item"', ""), "every field is filled in"
    shown = PIL.Image.open(io.BytesIO(base64.b64decode(picture["image_url"]["url"].partition(",")[2])))
    assert shown.size == (88, 42), "5 % of 80 px more on each side, and 10 % of the height above"


def sent_text(server: Server) -> str:
    """Text of the last request."""
    return str(server.requests[-1][2]["messages"][0]["content"][0]["text"])


def test_the_paraphrased_prompt_gets_its_bare_list_read(server: Server) -> None:
    server.answers = [says("Here you go:\n```\n[{`item`: `mug`, `color`: `white`}, {`item`: `books`, `color`: `red`}]\n```")]
    told = asked(server, prompt="paraphrased", mask_style="hard")
    assert told.items == (SupportItem("mug", "white"), SupportItem("book", "red"))
    text = sent_text(server)
    assert "JSON array" in text
    assert "[{`item`: `mug`, `color`: `white`}" in text, "braces of the example stay single"
    for part in ("for example: mug", "for example: white", "not those nearby", "an empty list: []"):
        assert part in text, "as Table A1 of the supplementary has it"


def test_a_user_can_supply_the_words_of_a_prompt(server: Server, tmp_path: Path) -> None:
    words = tmp_path / "mine.txt"
    words.write_text('List what stands on the {category}.\r\nAs JSON: {"items": [{"item": "mug"}]}')
    server.answers = [says(listed(MUG))]
    ledger = Recollection()
    told = asked(server, ledger=ledger, prompt_file=str(words))
    assert told.items == (SupportItem("mug", "white"),)
    assert sent_text(server) == 'List what stands on the desk.\nAs JSON: {"items": [{"item": "mug"}]}'
    (call,) = ledger.calls.values()
    assert call.prompt == "mine"
    planned = AskedItems(prompt_file=str(words))
    words.write_text(words.read_text() + "\nBe brief.")
    assert AskedItems(prompt_file=str(words)) != planned, "its words decide whether a scene is captured again"
    with pytest.raises(InputError, match="has changed since the run was planned"):
        conversation("desk", "0004", PICTURE, DESK, planned)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (b"List the items.", "lacks {category}"),
        (b"List what is on the {category}, a {catagory}.", r"has \{catagory\}, which is not a field"),
        (b"On the {category}: \xff", "is not UTF-8 text"),
    ],
)
def test_a_prompt_that_cannot_be_filled_in_is_refused(tmp_path: Path, text: bytes, problem: str) -> None:
    (tmp_path / "mine.txt").write_bytes(text)
    with pytest.raises(InputError, match=problem):
        AskedItems(prompt_file=str(tmp_path / "mine.txt"))
    with pytest.raises(InputError, match=r"away\.txt"):
        AskedItems(prompt_file=str(tmp_path / "away.txt"))


def test_nothing_on_it_is_an_answer(server: Server) -> None:
    server.answers = [says(listed())]
    assert asked(server) == ToldItems((), asked(server).call_ids, ())
    server.answers = [says("[]")]
    assert asked(server).items == ()


def test_what_cannot_be_read_is_asked_for_once_more_with_the_reason(server: Server) -> None:
    server.answers = [says(listed({"item": "mug", "color": "white", "count": 0})), says(listed(MUG))]
    told = asked(server)
    assert (told.items, told.problems) == ((SupportItem("mug", "white"),), ())
    assert "count must be a whole number" in server.requests[1][2]["messages"][-1]["content"]
    server.answers = [says("I see a desk.")]
    server.requests.clear()
    told = asked(server)
    assert (told.items, len(told.problems), len(server.requests)) == ((), 1, 2)
    assert "seer-1 gave no reply that can be used" in told.problems[0]


def test_an_endpoint_that_is_away_is_told_or_left_to_the_next_run(server: Server) -> None:
    server.answers = [refuses(503)]
    told = asked(server, pictures=3)
    assert (told.items, len(told.problems), len(server.requests)) == ((), 1, 2), "nobody asks an endpoint again that does not answer"
    with pytest.raises(EndpointAway):
        asked(server, away="retry")
    server.answers = [refuses(401)]
    with pytest.raises(InputError, match="HTTP 401"):
        asked(server)
    with pytest.raises(InputError, match=r"capture\.small_objects\.provider\.items"):
        check(AskedItems(url=server.url))


def test_what_was_answered_is_not_asked_again_and_pictures_are_united(server: Server) -> None:
    ledger = Recollection()
    server.answers = [says(listed(MUG, {"item": "pen", "color": "", "count": 3})), says(listed({**MUG, "count": 2}))]
    first = asked(server, pictures=2, ledger=ledger)
    assert first.items == (SupportItem("mug", "white", 2), SupportItem("pen", "", 3))
    assert len(first.call_ids) == 2
    server.answers = [refuses(500)]
    assert asked(server, pictures=2, ledger=ledger) == first
    assert len(server.requests) == 2
    assert asked(server, pictures=2, ledger=ledger, mask_style="box").problems, "another picture is another call"


@pytest.mark.parametrize(
    ("name", "singular"),
    [("mugs", "mug"), ("boxes", "box"), ("batteries", "battery"), ("glasses", "glasses"), ("coffee cups", "coffee cup"), ("glass", "glass"),
     ("mice", "mouse"), ("knives", "knife"), ("cactus", "cactus"), ("vase", "vase"), ("cases", "case"), ("dish brushes", "dish brush"),
     ("scissors", "scissors"), ("tomatoes", "tomato"), ("pies", "pie"), ("tv", "tv"), ("bus", "bus"), ("spice", "spice")],
)  # fmt: skip
def test_names_are_counted_in_the_singular(name: str, singular: str) -> None:
    assert lemma(name) == singular
    assert lemma(singular) == singular


ITEM = st.builds(SupportItem, st.sampled_from(["mug", "book", "pen"]), st.sampled_from(["", "red"]), st.integers(1, 5))


@given(st.lists(st.lists(ITEM, max_size=8), max_size=4))
def test_each_name_and_color_is_there_once_and_no_more_than_a_picture_shows(lists: list[list[SupportItem]]) -> None:
    own = [merged(items) for items in lists]
    for items, one in zip(lists, own, strict=True):
        assert sum(item.count for item in one) == sum(item.count for item in items)
        assert len({(item.name, item.color) for item in one}) == len(one)
    everything = united(own)
    assert {(item.name, item.color) for item in everything} == {(i.name, i.color) for items in lists for i in items}
    for item in everything:
        assert item.count == max(i.count for one in own for i in one if (i.name, i.color) == (item.name, item.color))
    assert list(names_of(everything)) == list(dict.fromkeys(i.name for i in everything))


@pytest.mark.parametrize(
    "reply",
    ["", "mug, book", '{"items": 3}', '{"items": [3]}', '{"items": [{"color": "red"}]}', '{"items": [{"item": ""}]}',
     '{"items": [{"item": "mug", "size": 3}]}', '{"items": [{"item": "x" , "count": 101}]}', '{"items": [{"item": "mug", "count": 1.5}]}',
     '{"items": [{"item": "mug"}], "more": [{"item": "pen"}]} {"items": []}', '[{"item": "mug"}] and [{"item": "pen"}]',
     json.dumps({"items": [{"item": "a" * 61}]}), json.dumps({"items": [{"item": "mug"}] * 201}),
     '{"items": [{"item": "mug"}, {"item": "pe'],
)  # fmt: skip
def test_replies_that_are_no_list_are_refused(reply: str) -> None:
    with pytest.raises(UnreadableReply):
        items_of(reply)


@given(st.integers(0, 10**6))
def test_of_corrupted_lists_nothing_is_read_that_was_not_meant(seed: int) -> None:
    draw = random.Random(seed)
    meant = items_of(LISTS[0])
    assert all(items_of(reply) == meant for reply in LISTS)
    for _ in range(25):
        try:
            read = items_of(corrupted(draw.choice(LISTS), draw))
        except UnreadableReply:
            continue
        assert read == meant


def test_a_mask_grows_by_a_share_of_its_box_and_what_is_outside_is_black_dark_or_there() -> None:
    assert box_of(DESK) == (40, 50, 120, 80)
    assert box_of(grown(DESK, 0.05)) == (36, 46, 124, 84)
    wide = grown(DESK, 0.05)[42:84, 36:124]
    own = PICTURE[42:84, 36:124]
    hard, dim, box = (support_picture(PICTURE, DESK, style, 0.05, 0.1, 768) for style in ("hard", "dim", "box"))  # type: ignore[arg-type]
    assert np.array_equal(box, own)
    for shown in (hard, dim):
        assert np.array_equal(shown[wide], own[wide])
    assert not hard[~wide].any()
    assert (dim[~wide] == (own[~wide] * 0.35).astype(np.uint8)).all()
    assert support_picture(PICTURE, DESK, "box", 0.05, 0.1, 44).shape == (21, 44, 3)


@pytest.mark.parametrize("support", sorted(support_kinds()))
def test_the_list_says_what_every_support_carries(support: str) -> None:
    names = listed_names(support, ListedItems())
    assert len(names) == len(set(names)) > 4
    assert support in item_lists()
    assert listed_names(support, ListedItems(names=("mug",))) == ("mug",)


def test_a_support_that_no_row_has_gets_the_first_rows() -> None:
    assert listed_names("spaceship", ListedItems()) == listed_names("table", ListedItems())
    assert listed_names("bedside table", ListedItems()) == listed_names("nightstand", ListedItems())


@pytest.mark.parametrize(
    ("text", "field"),
    [("supports,why\n", "items"), ("supports,items\ndesk,\n", "line 2, items"), ("supports,items\nmug,book\n", "line 2, supports"),
     ("supports,items\ndesk,book\ntable;desk,mug\n", "line 3, supports"), ("supports,items\n", "items"),
     ("supports,items\ndesk,a;;b\n", "line 2")],
)  # fmt: skip
def test_lists_that_say_nothing_are_refused(text: str, field: str) -> None:
    with pytest.raises(InputError) as refused:
        parsed_lists(text, "items.csv")
    assert field in refused.value.field
