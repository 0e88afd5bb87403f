"""Notes of runs for a terminal: few lines for each scan, none on expected conditions, and no note is lost."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.wording.notes import MAX_NOTES_PER_SCENE, condensed, is_expected

SCENE = "scannet/scene0000_00"


def note(stage: str, text: str, scene: str = SCENE) -> str:
    return f"{scene}: {stage}: {text}"


def test_notes_of_one_kind_are_one_line() -> None:
    lines = [note("captions", f"{k:04d} chair: mass {k}.5 kg is above the range of chair (3 to 12 kg); 12 kg taken") for k in range(8)]
    (line,) = condensed(lines)
    assert line.startswith(f"{SCENE}: captions: 8 objects (0000 chair, 0001 chair, 0002 chair and 5 more), the first: mass 0.5 kg is above")
    assert condensed(lines[:1]) == lines[:1]
    (pair,) = condensed(lines[:2])
    assert "2 objects (0000 chair, 0001 chair), the first: mass 0.5 kg" in pair
    assert condensed([note("capture", f"{k:04d}: too small") for k in range(2)]) == [f"{SCENE}: capture: 2 objects (0000, 0001): too small"]


def test_other_notes_of_one_kind_are_counted() -> None:
    lines = [note("capture", f"room.json: '{word}' is not in the label map, nyu40 class 0") for word in ("lampa", "stul", "stol")]
    assert condensed(lines) == [f"{lines[0]} (and 2 more of this kind)"]


def test_stages_and_scenes_stay_apart() -> None:
    lines = [note("capture", "0001: too small"), note("candidates", "0001: too small"), note("capture", "0001: too small", "demo/a")]
    assert condensed(lines) == lines


def test_a_scan_has_at_most_ten_lines_and_urgent_ones_come_first() -> None:
    words = ["alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu"]
    units = note("capture", "the scan measures 0.40 x 0.30 x 0.20 m, a room 0.6 to 30 m: are its coordinates in meters?")
    lines = [*(note("capture", f"{word} was left as it is") for word in words), units]
    shown = condensed(lines)
    assert len(shown) == MAX_NOTES_PER_SCENE
    assert shown[0] == units
    assert shown[-1] == f"{SCENE}: and 4 more kinds of notes in stage_runs.degradations"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("no frames in the scan: no views, no masks", True),
        ("no mesh and no frames in the scan: objects are boxes, walls rectangles; no views, no masks", True),
        ("room/CapturedRoom.json: not used: doors.confidence, floors.confidence", True),
        ("scan mesh thinned from 540539 to 400000 faces", True),
        ("room/CapturedRoom.json: walls[3].story: not used", False),
        ("not a room: nothing upright in it is as large as a wall", False),
        ("2 of 111 frames without a pose (-inf): 000030, 000109", False),
        ("no library given: its slots are filled by the furniture generator and flagged as fallback", False),
    ],
)
def test_expected_conditions_are_no_degradations(text: str, expected: bool) -> None:
    assert is_expected(note("capture", text)) == expected


TEXTS = st.text(st.characters(codec="ascii", exclude_categories=["Cc"]), min_size=1, max_size=30)


@given(st.lists(st.tuples(st.sampled_from(["demo/a", "demo/b"]), st.sampled_from(["capture", "candidates"]), TEXTS), max_size=60))
def test_no_scene_is_silenced(rows: list[tuple[str, str, str]]) -> None:
    lines = [note(stage, text, scene) for scene, stage, text in rows]
    shown = condensed(lines)
    for scene in {scene for scene, _, _ in rows}:
        own = [line for line in shown if line.startswith(f"{scene}: ")]
        assert 1 <= len(own) <= MAX_NOTES_PER_SCENE
    assert all(re.match(r"demo/[ab]: ", line) for line in shown)


def test_lines_without_a_scene_stay() -> None:
    lines = ["left out: a link that leads nowhere", "room.ply: is a copy of another scan"]
    assert condensed(lines) == lines
