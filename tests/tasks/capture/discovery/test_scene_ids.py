"""Scene ids: whatever folders are called, each scan has an id of its own that tables and every file system take."""

from __future__ import annotations

import random
import re
import unicodedata
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from schemas.record import SCENE_PATTERN
from tasks.capture.scan import Scan
from tasks.capture.scene_ids import with_distinct_ids
from tasks.exports.bodies import stem
from tasks.words import MAX_WORD_LETTERS, plain_word

ROOT = Path("/scans")
RESERVED = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)

NAMES = st.one_of(
    st.text(st.characters(exclude_categories=["Cs"], exclude_characters="/\0"), min_size=1, max_size=120),
    st.sampled_from(
        ["Living Room", "living room", "living_room", "LIVING_ROOM", "CON", "con.ply", "NUL.", "room.", "room", "Room",
         "room ", "-room", ".room", "école", "e\u0301cole", "É\u0301", "🏠", "🏡", "x" * 240, "X" * 240, "x" * 239 + "y",
         "scan", "...", "___", "a\\b", "ß", "ẞ"]
    ),
)  # fmt: skip


def ids(names: set[str]) -> dict[str, str]:
    """Scene id of each folder."""
    scans = [Scan("scannet", ROOT / name, "d", name) for name in names if name not in (".", "..")]
    random.Random(len(scans)).shuffle(scans)
    return {scan.scan: scan.scene_id for scan in with_distinct_ids(scans, ROOT)}


def folded(text: str) -> str:
    return unicodedata.normalize("NFC", text).casefold()


@given(st.sets(NAMES, max_size=12))
@example({"Living Room", "living room"})
@example({"école", "e\u0301cole"})
@example({"x" * 240, "X" * 240, "x" * 241})
@example({"my room", "my+room", "my_room"})
def test_any_folders_have_sound_and_distinct_ids(names: set[str]) -> None:
    scenes = ids(names)
    assert len(scenes) == len(names - {".", ".."})
    assert len({folded(scene) for scene in scenes.values()}) == len(scenes)
    assert len({stem(scene).casefold() for scene in scenes.values()}) == len(scenes)
    for scene in scenes.values():
        word = scene.partition("/")[2]
        assert re.fullmatch(SCENE_PATTERN, scene)
        assert len(word) <= MAX_WORD_LETTERS
        assert not RESERVED.fullmatch(word)
        assert not word.endswith(".")


@given(st.sets(NAMES, min_size=1, max_size=8), NAMES)
def test_a_scan_renames_only_those_that_would_share_its_id(names: set[str], added: str) -> None:
    before, after = ids(names), ids(names | {added})
    for name, scene in before.items():
        assert after[name] == scene or plain_word(name).casefold() == plain_word(added).casefold()


@given(st.sets(st.from_regex(r"[a-z0-9][a-z0-9_-]{0,80}", fullmatch=True).filter(lambda name: not RESERVED.fullmatch(name)), max_size=8))
@example({"scene0001_00", "hall", "con-1"})
def test_sound_names_are_their_ids(names: set[str]) -> None:
    assert ids(names) == {name: f"d/{name}" for name in names}


def test_the_plainest_name_keeps_the_id() -> None:
    scenes = ids({"my room", "my+room", "my_room"})
    assert scenes["my_room"] == "d/my_room"
    assert all(re.fullmatch(r"d/my_room-[0-9a-f]{8}", scenes[name]) for name in ("my room", "my+room"))


@pytest.mark.parametrize(
    ("name", "word"),
    [("CON", r"scan_CON-[0-9a-f]{8}"), ("nul.ply", r"scan_nul\.ply-[0-9a-f]{8}"), ("room.", r"room-[0-9a-f]{8}"),
     ("Living Room", "Living_Room"), ("x" * 97, r"x{64}-[0-9a-f]{8}"), ("x" * 96, "x{96}"), ("console", "console"), ("com10", "com10")],
)  # fmt: skip
def test_names_that_some_system_does_not_take_are_changed(name: str, word: str) -> None:
    assert re.fullmatch(word, plain_word(name))


def test_a_folder_named_as_an_id_is_not_taken_for_another() -> None:
    first = ids({"my room", "my_room"})["my room"].partition("/")[2]
    scenes = ids({"my room", "my_room", first})
    assert scenes[first] == f"d/{first}"
    assert len(set(scenes.values())) == 3
