"""Names in any script: scene ids keep them apart and readable, and they go through run, export, SQL and explain."""

from __future__ import annotations

import json
import os
import re
import unicodedata
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from flows.scans.choice import chosen
from schemas.errors import InputError
from schemas.record import SCENE_PATTERN
from tasks.capture.formats import find_scans
from tasks.capture.scan import Scan
from tasks.exports.bodies import identifier, stem
from tasks.words import MAX_WORD_LETTERS, latin, plain_word
from tests.scans import OBJECTS, write_scan
from tests.test_pipeline import home as home  # a fixture
from tests.test_pipeline import metascenes, run

NAMES = ["会议室", "مطبخ", "🏠 kitchen", "e\u0301cole", "Küche", "küche"]
FOLDERS = st.text(st.characters(exclude_categories=["Cs"], exclude_characters="/\0"), min_size=1, max_size=80)


def id_before(text: str) -> str:
    """What a name was in scene ids before names in other letters were told apart."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "_", text).lstrip("_.-") or "scan"


@given(st.text(st.characters(max_codepoint=127, exclude_characters="/\0")))
@example("scene0001_00")
@example("+++")
def test_ascii_names_keep_their_ids(name: str) -> None:
    before = id_before(name)
    is_reserved = re.match(r"(?i)(con|prn|aux|nul|com\d|lpt\d)(\.|$)", before)
    is_sound = len(before) <= MAX_WORD_LETTERS and not before.endswith(".") and not is_reserved
    assert (plain_word(name) == before) == is_sound


@given(st.sets(FOLDERS.filter(lambda name: not name.isascii()), min_size=2, max_size=6))
@example({"会议室", "會議室", "会议室2"})
@example({"Küche", "küche", "Kuche\u0308n"})
@example({"🏠", "🏡"})
@example({"ﬁ", "fi\u200d"})
def test_names_that_differ_have_ids_that_differ_and_that_everything_takes(names: set[str]) -> None:
    texts = {unicodedata.normalize("NFC", name) for name in names}
    ids = {Scan("glb", Path("a"), "glb", name).scene_id for name in texts}
    assert len(ids) == len([text for text in texts if not text.isascii()]) + len({plain_word(text) for text in texts if text.isascii()})
    assert all(re.fullmatch(SCENE_PATTERN, scene) and len(scene) < 100 for scene in ids)
    assert len({stem(scene).lower() for scene in ids}) == len({scene.lower() for scene in ids}) == len(ids)


@given(FOLDERS)
def test_an_id_does_not_hang_on_how_letters_are_composed(name: str) -> None:
    forms = {unicodedata.normalize(form, name) for form in ("NFC", "NFD")}
    assert len({plain_word(form) for form in forms if not form.isascii()}) <= 1


@given(FOLDERS, FOLDERS)
def test_a_dataset_in_any_letters_is_one_that_tables_take(dataset: str, scan: str) -> None:
    assert re.fullmatch(SCENE_PATTERN, Scan("glb", Path("a"), dataset, scan).scene_id)


def test_ids_can_be_read() -> None:
    assert [plain_word(name) for name in NAMES] == [
        "Hui_Yi_Shi-423bba6b", "mTbkh-5eed6989", "kitchen-a68120c4", "ecole-f0f772e1", "Kuche-a9ec872e", "kuche-d4b04d03"
    ]  # fmt: skip
    assert latin("Küche") == "Kuche"
    assert [identifier(label) for label in ("椅子", "стол", "coffee table", "🏠")] == ["Yi_Zi", "stol", "coffee_table", "thing"]


def test_folders_that_would_be_one_scene_are_scenes_of_their_own(tmp_path: Path) -> None:
    names = ["my room", "my+room", "e\u0301cole", "\u00e9cole", "会议室"]
    for name in names:
        write_scan(tmp_path, name, objects=OBJECTS[:1])
    found, errors = find_scans(tmp_path)
    assert errors == []
    assert sorted(scan.scan for scan in found) == sorted(names)
    assert len({scan.scene_id.casefold() for scan in found}) == len(names)


def test_a_name_that_is_no_text_is_refused_by_itself(tmp_path: Path) -> None:
    write_scan(tmp_path, "scene0001_00", objects=OBJECTS[:1])
    write_scan(tmp_path, os.fsdecode(b"room\xff"), objects=OBJECTS[:1])
    found, (error,) = find_scans(tmp_path)
    assert [scan.scan for scan in found] == ["scene0001_00"]
    assert str(error) == r"room\udcff: name: is no UTF-8; rename the folder or file"


def test_scenes_are_chosen_by_the_names_that_their_folders_have() -> None:
    scans = [Scan("glb", Path(name), "glb", name) for name in NAMES]
    for name, scan in zip(NAMES, scans, strict=True):
        for asked in (name, unicodedata.normalize("NFD", name), unicodedata.normalize("NFC", name), scan.scene_id, plain_word(name)):
            assert chosen(scans, scenes=[asked]) == [scan]
    assert chosen(scans, scenes=["*kitchen", "会*"]) == [scans[0], scans[2]]
    assert chosen(scans, scenes=["glb/*uche-*"]) == scans[4:]
    with pytest.raises(InputError, match="no scan matches"):
        chosen(scans, scenes=["会议"])


@pytest.mark.slow
def test_names_in_any_script_go_through_everything(home: dict[str, str], tmp_path: Path) -> None:
    scans, lake, out = tmp_path / "сканы", tmp_path / "озеро", tmp_path / "出力"
    for number, name in enumerate(NAMES):
        write_scan(scans, name, size=(4.0 + 0.1 * number, 3.2, 2.5), objects=OBJECTS[1:2])
    done = run(home, scans, lake, "--dataset", "Büro", "--workers", 2)
    assert done.returncode == 0, done.stdout + done.stderr
    ids = sorted(f"{plain_word('Büro').lower()}/{plain_word(name)}" for name in NAMES)
    told = metascenes(home, "sql", "SELECT scene_id, scan_path FROM scenes ORDER BY scene_id", "--output", "json", "--lake", lake)
    assert told.returncode == 0, told.stderr
    rows = json.loads(told.stdout)
    assert [row["scene_id"] for row in rows] == ids
    assert sorted(Path(row["scan_path"]).name for row in rows) == sorted(NAMES)
    again = run(home, scans, lake, "--dataset", "Büro", "--scene", "会议室")
    assert (again.returncode, again.stdout) == (0, "nothing to do: 1 scene is up to date\n"), again.stderr
    exported = metascenes(home, "export", "--lake", lake, "--out", out)
    assert exported.returncode == 0, exported.stdout + exported.stderr
    for scene in ids:
        assert list(out.rglob(f"*{stem(scene)}*")), scene
        for what in (scene, f"{scene}/0005"):
            explained = metascenes(home, "explain", what, "--lake", lake)
            assert explained.returncode == 0, explained.stdout + explained.stderr
