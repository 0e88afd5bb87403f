"""Pictures that were drawn before: the same rows draw nothing, other rows draw anew, and an erasure leaves none."""

from __future__ import annotations

import io
import sys
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest

from flows.progress import Progress
from flows.scans import erasure
from flows.stats import pictures
from flows.stats.pictures import NotDrawnYet, only_remembered, remembered
from flows.stats.scenes import Job, carried_out
from tasks.films.drives import DriveStill
from tasks.stats.scenes import PictureConfig, ScenePictures
from tasks.stats.style import Picture
from tasks.stats.thumbnails import CandidateStrip, CandidateTile
from warehouse.upkeep.erasure import Traces

CURVE = Picture("loss", "Loss", "it falls", "<svg/>", b"png")
TILE = CandidateTile(0, "scan", 0.5, True, False, True, "", b"jpeg")
DRAWN: list[Any] = [
    ScenePictures(b"a", b"b\xff", b"c", b"d", b"e", None, CURVE, b"f"),
    CandidateStrip("a/b", "0001", "chair", None, "rank", (TILE, TILE)),
    CURVE,
    DriveStill("p", "r", "s", "arrived", "a/b", "0001", "chair", "after 3 s", b"jpeg"),
    (b"a", b"b"),
    None,
]


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path))
    return tmp_path


def kept(folder: Path) -> list[Path]:
    return [path for path in folder.glob("modules/pictures-*/*") if path.is_file()]


class Draw:
    def __init__(self, what: Any) -> None:
        self.what, self.calls = what, 0

    def __call__(self) -> Any:
        self.calls += 1
        return self.what


@pytest.mark.parametrize("what", DRAWN, ids=lambda what: type(what).__name__)
def test_the_same_facts_draw_once_and_give_the_same(what: Any) -> None:
    draw = Draw(what)
    facts = ["scene", PictureConfig(), pa.table({"a": [1, 2], "b": ["x", None]}), [("asset", "blob")]]
    assert [remembered(facts, draw), remembered(facts, draw)] == [what, what]
    assert draw.calls == 1


def test_where_nothing_may_be_drawn_only_what_is_known_is_given() -> None:
    draw = Draw(CURVE)
    with only_remembered(), pytest.raises(NotDrawnYet):
        remembered(["a"], draw)
    assert draw.calls == 0
    assert remembered(["a"], draw) == CURVE
    with only_remembered():
        assert remembered(["a"], draw) == CURVE
    assert draw.calls == 1


@pytest.mark.parametrize(
    "other",
    [
        ["scene", PictureConfig(), pa.table({"a": [1, 3]}), 1.0],
        ["scene", PictureConfig(), pa.table({"b": [1, 2]}), 1.0],
        ["scene", PictureConfig(width=801), pa.table({"a": [1, 2]}), 1.0],
        ["strip", PictureConfig(), pa.table({"a": [1, 2]}), 1.0],
        ["scene", PictureConfig(), pa.table({"a": [1, 2]}), 1.0000000000000002],
        ["scene", PictureConfig(), pa.table({"a": pa.array([1, 2], pa.int32())}), 1.0],
    ],
)
def test_other_facts_draw_anew(other: list[Any]) -> None:
    remembered(["scene", PictureConfig(), pa.table({"a": [1, 2]}), 1.0], Draw(b"old"))
    assert remembered(other, Draw(b"new")) == b"new"


def test_other_code_draws_anew_and_what_the_old_one_drew_goes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    remembered(["a"], Draw(b"old"))
    monkeypatch.setattr(pictures, "_code", lambda: "another" * 10)
    assert remembered(["a"], Draw(b"new")) == b"new"
    assert len(kept(folder)) == 2
    pictures.forget_old()
    assert [path.parent.name for path in kept(folder)] == ["pictures-anotheranotheran"]


@pytest.mark.parametrize("damage", [b"", b"{", b'{"bytes": 1}', b'{"Nothing": {}}', b'{"bytes": "%%"}', b"\xff"])
def test_a_damaged_picture_is_drawn_again(damage: bytes, folder: Path) -> None:
    remembered(["a"], Draw(b"picture"))
    kept(folder)[0].write_bytes(damage)
    draw = Draw(b"picture")
    assert remembered(["a"], draw) == b"picture"
    assert draw.calls == 1


def test_an_erasure_leaves_no_picture_even_of_a_scene_without_blobs(folder: Path) -> None:
    remembered(["a/secret"], Draw(CURVE))
    assert kept(folder)
    erasure.erase_from_caches(Traces(frozenset(["a/secret"])), frozenset())
    assert kept(folder) == []


def test_progress_is_told_in_lines_where_there_is_no_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with Progress("pictures", 3, lines=True) as progress:
        for name in ("a/b", "a/c", "a/d"):
            progress.advance(name)
    lines = sys.stderr.getvalue().splitlines()  # type: ignore[attr-defined]
    assert lines[0] == "pictures: 0 of 3"
    assert lines[-1] == "pictures: 3 of 3, a/d"
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with Progress("pictures", 3) as progress:
        progress.advance("a/b")
    assert sys.stderr.getvalue() == ""  # type: ignore[attr-defined]


def drawn_once(file: Path, name: str) -> str:
    with file.open("a") as lines:
        lines.write(f"{name}\n")
    return name


def test_what_is_never_remembered_is_left_to_workers(tmp_path: Path) -> None:
    """A page of a scene takes seconds: it is not made where what is remembered is looked up."""
    file, told = tmp_path / "drawn", list[str]()
    known: Job = (remembered, (["known"], Draw(CURVE)))
    assert known[0](*known[1]) == CURVE
    anew: dict[str, Job] = {"page": (drawn_once, (file, "page")), "bad": (drawn_once, (tmp_path / "no" / "folder", "bad"))}
    made = carried_out({"known": known}, 1, told.append, meanwhile=lambda: drawn_once(file, "meanwhile") and None, anew=anew)
    assert (made["known"], made["page"], list(made)) == (CURVE, "page", ["known", "page", "bad"])
    assert "No such file" in made["bad"]
    assert file.read_text().splitlines() == ["meanwhile", "page"], "once, after what goes on beside it has begun"
    assert sorted(told) == ["bad", "known", "page"]
