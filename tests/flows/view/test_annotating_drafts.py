"""Drafts: durable, of one page in its own order, of several pages as they come; and files that are none of ours."""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
import stat
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from flows.cli import cli
from flows.server.connections import bound
from flows.view import bundle
from flows.view.annotating.drafts import LAYOUT, Drafts, drafts_folder
from flows.view.annotating.hosting import serve_annotation
from flows.view.annotating.keys import KeyFile
from flows.view.annotating.people import roles_of
from flows.view.annotating.settling import Rooms
from schemas.errors import InputError, LakeError
from tests.annotated import SCENES
from tests.flows.view.batches import BATCH, asked_lake, stand_in

A, B = ("demo/a", "0001"), ("demo/a", "0002")

acts = st.lists(
    st.tuples(
        st.sampled_from(["save", "save", "save", "remove", "reopen"]), st.sampled_from([A, B]), st.sampled_from(["ada", "bob"]),
        st.integers(0, 5), st.sampled_from(["", "p", "q"]),
    ),
    max_size=25,
)  # fmt: skip


@given(acts=acts)
@settings(max_examples=60, deadline=None)
def test_the_last_edit_of_a_page_holds_whatever_comes_late(tmp_path_factory: pytest.TempPathFactory, acts: list[Any]) -> None:
    file = tmp_path_factory.mktemp("drafts") / "b1.sqlite"
    drafts = Drafts(file, "b1")
    known: dict[Any, tuple[int | None, int, str]] = {}  # body's number, edit and page, by object and annotator
    for number, (act, key, name, edit, page) in enumerate(acts):
        before = known.get((key, name))
        if act == "reopen":
            drafts.close()
            drafts = Drafts(file, "b1")
        elif act == "remove":
            drafts.remove(key, name, edit, page)
            is_outrun = before is not None and page == before[2] != "" and before[1] > edit  # an answer leaves what came after it
            if before is not None and page == "":
                known[key, name] = (None, max(edit, before[1]), before[2])
            elif is_outrun:
                pass
            elif before is not None or page:
                known[key, name] = (None, edit, page)
        else:
            is_kept, kept = drafts.save(key, name, {"seconds": number}, edit, page)
            is_late = before is not None and page == before[2] != "" and (edit < before[1] or (edit == before[1] and before[0] is None))
            assert is_kept is not is_late
            if not is_late:
                known[key, name] = (number, edit, page)
            body = known[key, name][0]
            assert (kept.body, kept.edit, kept.page) == (None if body is None else {"seconds": body}, *known[key, name][1:])
    for name in ("ada", "bob"):
        live = {key: (body, edit) for (key, who), (body, edit, _) in known.items() if who == name and body is not None}
        assert {key: (row.body["seconds"], row.edit) for key, row in drafts.of(name).items() if row.body} == live
        assert drafts.count().get(name, 0) == len(live)
    drafts.close()


def test_an_answer_leaves_what_its_page_drafted_after_it(tmp_path: Path) -> None:
    drafts = Drafts(tmp_path / "b1.sqlite", "b1")
    drafts.save(A, "ada", {"choice": 1}, 3, "p")
    drafts.save(A, "ada", {"choice": 2}, 4, "p")
    drafts.remove(A, "ada", 3, "p")
    assert drafts.of("ada")[A].body == {"choice": 2}, "acknowledged, and not part of the answer"
    drafts.remove(A, "ada", 4, "p")
    assert drafts.of("ada") == {}
    assert not drafts.save(A, "ada", {"choice": 2}, 4, "p")[0]
    drafts.close()


def test_drafts_of_batches_in_one_file_are_apart_and_for_their_owner_alone(tmp_path: Path) -> None:
    file = tmp_path / "new" / "drafts.sqlite"
    first, second = Drafts(file, "b1"), Drafts(file, "b2")
    first.save(A, "ada", {"choice": 1}, 1, "")
    second.save(A, "ada", {"choice": 2}, 1, "")
    assert [drafts.of("ada")[A].body for drafts in (first, second)] == [{"choice": 1}, {"choice": 2}]
    assert {path.name: stat.S_IMODE(path.stat().st_mode) for path in file.parent.iterdir()} == dict.fromkeys(
        ("drafts.sqlite", "drafts.sqlite-wal", "drafts.sqlite-shm"), 0o600
    )
    first.close()
    second.close()


def test_drafts_are_private_whoever_made_the_file(tmp_path: Path) -> None:
    file, link, second = tmp_path / "open.sqlite", tmp_path / "link.sqlite", tmp_path / "second.sqlite"
    file.touch(0o644)
    file.chmod(0o666)
    for _ in range(2):
        drafts = Drafts(file, "b1")
        drafts.save(A, "ada", {"choice": 1}, 1, "")
        assert {path.name: stat.S_IMODE(path.stat().st_mode) for path in tmp_path.iterdir()} == dict.fromkeys(
            (file.name, f"{file.name}-wal", f"{file.name}-shm"), 0o600
        )
        drafts.close()
        file.chmod(0o644)
    link.symlink_to(file)
    second.hardlink_to(file)
    (tmp_path / "dangling.sqlite").symlink_to(tmp_path / "nowhere.sqlite")
    os.mkfifo(tmp_path / "pipe.sqlite")
    for name, why in (("link", "is a link"), ("dangling", "is a link"), ("second", "no file of your own"), ("pipe", "no file of your own")):
        with pytest.raises(InputError, match=why):
            Drafts(tmp_path / f"{name}.sqlite", "b1")
    assert not (tmp_path / "nowhere.sqlite").exists()


def test_a_second_server_leaves_the_port_of_the_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bundle, "BUILT", stand_in(tmp_path / "built"))
    monkeypatch.setattr(Rooms, "warm", lambda rooms, ending: None)
    lake = asked_lake(tmp_path)
    ports: list[int] = []

    def serve(port: int = 0) -> int:
        """The port that it gives out before it is ended."""

        def end(addresses: dict[str, dict[str, Any]]) -> None:
            ports.append(httpx.URL(addresses["ada"]["address"]).port or 0)
            raise EndedError

        with pytest.raises(EndedError):
            serve_annotation(lake, BATCH, [], None, "127.0.0.1", port, end)
        return ports[-1]

    first = serve()
    with bound("127.0.0.1", first) as other:
        other.listen()
        assert serve() != first
    assert serve() == first, "as before"
    asked = serve(port=free_port())
    assert asked != first
    assert serve() == asked, "where a port was asked for it is the one that is kept"


def free_port() -> int:
    with bound("127.0.0.1", 0) as listening:
        return int(listening.getsockname()[1])


class EndedError(Exception):
    """Ends a server before it answers anybody."""


def test_files_of_other_versions_and_other_things_are_refused_in_one_line(tmp_path: Path) -> None:
    def made(name: str, *statements: str) -> Path:
        with sqlite3.connect(tmp_path / name) as connection:
            for statement in statements:
                connection.execute(statement)
        return tmp_path / name

    older = made("older.sqlite", "CREATE TABLE drafts (key TEXT, body TEXT)", f"PRAGMA user_version = {LAYOUT + 1}")
    strange = made("strange.sqlite", "CREATE TABLE songs (title TEXT)")
    false = made("false.sqlite", "CREATE TABLE drafts (key TEXT)", f"PRAGMA user_version = {LAYOUT}")
    text = tmp_path / "text.sqlite"
    text.write_text("no database " * 200)
    (tmp_path / "folder").mkdir()
    for file, why in ((older, "has layout 2"), (strange, "has layout 0"), (false, "has layout 1"), (text, "is no file of drafts"),
                      (tmp_path / "folder", "cannot be opened"), (text / "below", "cannot be opened")):  # fmt: skip
        before = file.read_bytes() if file.is_file() else b""
        with pytest.raises(InputError, match=why) as caught:
            Drafts(file, "b1")
        assert (caught.value.field, "\n" in str(caught.value)) == ("--drafts", False)
        assert (file.read_bytes() if file.is_file() else b"") == before


def test_a_draft_that_cannot_be_written_is_not_acknowledged(tmp_path: Path) -> None:
    drafts = Drafts(tmp_path / "b1.sqlite", "b1")
    drafts.save(A, "ada", {"choice": 1}, 1, "p")
    pages = drafts._connection.execute("PRAGMA page_count").fetchone()[0]
    drafts._connection.execute(f"PRAGMA max_page_count = {pages}")  # as a full disk
    with pytest.raises(LakeError, match="nothing changed"):
        drafts.save(B, "ada", {"choice": "x" * 100_000}, 2, "p")
    assert set(drafts.of("ada")) == {A}
    drafts._connection.execute(f"PRAGMA max_page_count = {pages + 1000}")
    assert drafts.save(B, "ada", {"choice": "x" * 100_000}, 2, "p")[0]
    drafts.close()


def test_a_person_who_answers_and_reviews_is_one() -> None:
    assert roles_of(["ada", "bob"], ["rita", "ADA", "Rita"]) == {
        "ada": ("annotator", "reviewer"), "bob": ("annotator",), "rita": ("reviewer",),
    }  # fmt: skip
    for name in ("", " rita", "a\nb", "x" * 101):
        with pytest.raises(InputError, match="is no name"):
            roles_of(["ada"], [name])


@pytest.mark.usefixtures("own_machine")
def test_an_erased_scene_leaves_nothing_in_the_drafts(tmp_path: Path) -> None:
    lake = asked_lake(tmp_path)
    folder = drafts_folder(lake)
    assert folder is not None
    drafts = Drafts(folder / f"{BATCH}.sqlite", BATCH)
    for index, scene in enumerate(SCENES * 20):
        drafts.save((scene, f"{index:04d}"), "ada", {"choice": 1, "ranking": [1], "seconds": index}, 1, "")
    drafts.remove((SCENES[0], "0000"), "ada")
    erase = ["lake", "erase", SCENES[0], "--lake", lake.address]
    assert json.loads(CliRunner().invoke(cli, [*erase, "--dry-run", "--json"]).output)["drafts"] == 19
    assert "19 drafts of annotators would go\n" in CliRunner().invoke(cli, [*erase, "--dry-run"]).output
    assert len(drafts.of("ada")) == 39
    result = CliRunner().invoke(cli, [*erase, "--yes", "--json"])
    erased = json.loads(result.output)
    assert (erased["drafts"], erased["proof"]["hits"]) == (19, []), result.output
    assert {key[0] for key in drafts.of("ada")} == {SCENES[1]}
    assert len(drafts.of("ada")) == 20
    drafts.close()
    assert all(SCENES[0].encode() not in path.read_bytes() for path in folder.iterdir())


def test_the_lake_is_sound_with_drafts(tmp_path: Path) -> None:
    lake = asked_lake(tmp_path)
    folder = drafts_folder(lake)
    assert folder is not None
    with contextlib.closing(Drafts(folder / f"{BATCH}.sqlite", BATCH)) as drafts:
        drafts.save(A, "ada", {"choice": 1}, 1, "")
        KeyFile(folder / f"{BATCH}.sqlite.tokens").serve({"ada": ("annotator",)}, 8765, "http://127.0.0.1:8765")
        answered = CliRunner().invoke(cli, ["doctor", "lake", "--lake", lake.address, "--json"])
    assert json.loads(answered.output) == {"errors": [], "warnings": []}


def test_what_a_page_sent_comes_back_as_it_was(tmp_path: Path) -> None:
    drafts = Drafts(tmp_path / "b1.sqlite", "b1")
    body = {"choice": "\ud83d\ude00", "transform": {"position": [0.1, -1e-9, 1e6], "yaw_degrees": 1 / 3, "scale": [1, 1, 1]}, "ranking": []}
    drafts.save(A, "ada", body, 2**53, "p")
    row = drafts.of("ada")[A]
    assert (json.loads(json.dumps(row.body)), row.edit) == (json.loads(json.dumps(body)), 2**53)
    drafts.close()
