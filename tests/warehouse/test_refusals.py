"""What the operating system refuses, and what is missing or damaged in a lake: one line and exit code 2, never a defect of ours."""

from __future__ import annotations

import errno
import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import duckdb
import pytest

from schemas.capture import Instance, Scene
from schemas.errors import InputError
from tests.conftest import REPOSITORY
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake
from warehouse.storage.refusals import Refused, in_words, number_of
from warehouse.upkeep.compaction import compact
from warehouse.upkeep.erasure import erase
from warehouse.upkeep.vacuum import vacuum


def lake_at(folder: Path, scenes: int = 3) -> Lake:
    """A lake of several small files in every table, a commit each."""
    lake = Lake.open(folder)
    blob = lake.blobs.put(b"mesh", "glb")
    for number in range(scenes):
        name = f"a/scene{number}"
        rows = {
            "scenes": [sample(Scene, scene_id=name, mesh_blob=blob)],
            "instances": [sample(Instance, scene_id=name, instance_id=f"{i:04d}", raw_label="x" * i, points_blob=blob) for i in range(400)],
        }
        lake.stage_rows(stage_run(name, "capture", fingerprint(number)), rows)
        lake.commit()
    return lake


def shell(*arguments: str, limit: int | None = None) -> subprocess.CompletedProcess[str]:
    """A command as a process, in which no file may grow past `limit` bytes: as on a full disk, a write fails half-way."""

    def bound() -> None:
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    command = [sys.executable, "-m", "flows.cli", *arguments]
    return subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, preexec_fn=bound)


@pytest.mark.whole
@pytest.mark.usefixtures("own_machine")
@pytest.mark.parametrize("limit", [0, pytest.param(2_000, marks=pytest.mark.whole)])
@pytest.mark.parametrize("words", [("lake", "compact"), ("lake", "erase", "a/scene1", "--yes"), ("release", "create", "v1")])
def test_a_write_that_fails_half_way_is_one_line_and_leaves_the_lake_sound(words: tuple[str, ...], limit: int, tmp_path: Path) -> None:
    lake = lake_at(tmp_path / "lake")
    before = len(lake.snapshot().rows(Instance))
    done = shell(*words, "--lake", lake.address, limit=limit)
    lines = done.stderr.strip().splitlines()
    assert done.returncode == 2, done.stderr
    assert len(lines) == 1, done.stderr
    assert "File too large; raise the limit on the size of files and give the command again" in lines[0]
    assert len(Lake.open(lake.address).snapshot().rows(Instance)) == before
    again = shell(*words, "--lake", lake.address)
    assert again.returncode in (0, 1), again.stderr  # 1: blobs of today stay
    assert not list((tmp_path / "lake" / "tmp").glob("*"))


WORDS: dict[str, Callable[[Lake], object]] = {
    "compact": compact,
    "erase": lambda lake: erase(lake, "a/scene1"),
    "vacuum": lambda lake: vacuum(lake, days=0),
    "read": lambda lake: lake.snapshot().rows(Instance),
}


@pytest.mark.parametrize("name", WORDS)
@pytest.mark.parametrize("damage", ["missing", "empty", "torn"])
def test_a_data_file_that_is_missing_or_damaged_is_named(name: str, damage: str, tmp_path: Path) -> None:
    lake = lake_at(tmp_path / "lake")
    file = next((tmp_path / "lake" / "tables" / "instances").glob("*.parquet"))
    data = file.read_bytes()
    file.unlink()
    if damage != "missing":
        file.write_bytes(data[: len(data) // 2] if damage == "torn" else b"")
    with pytest.raises(Exception) as caught:  # which one is asserted below
        WORDS[name](Lake.open(lake.address))
    said = str(caught.value)
    assert isinstance(caught.value, InputError), said
    assert f"tables/instances/{file.name}: {'is missing' if damage == 'missing' else 'cannot be read'}" in said
    assert "`metascenes doctor lake` says what is damaged" in said


@pytest.mark.whole
@pytest.mark.usefixtures("own_machine")
def test_a_missing_data_file_is_misuse_on_the_command_line(tmp_path: Path) -> None:
    lake = lake_at(tmp_path / "lake")
    next((tmp_path / "lake" / "tables" / "instances").glob("*.parquet")).unlink()
    for words in (("compact",), ("erase", "a/scene1", "--yes")):
        done = shell("lake", *words, "--lake", lake.address)
        assert (done.returncode, len(done.stderr.strip().splitlines())) == (2, 1), done.stderr
        assert "is missing" in done.stderr


class PanicException(BaseException):
    """As Rust's libraries raise it."""


@pytest.mark.parametrize(
    ("error", "number"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), errno.ENOSPC),
        (OSError("Generic LocalFileSystem error\n ↳ No space left on device (os error 28)"), errno.ENOSPC),
        (duckdb.TransactionException("Failed to commit: Could not write file: No space left on device"), errno.ENOSPC),
        (duckdb.IOException('Cannot open file "/x": Permission denied'), errno.EACCES),
        (OSError("Generic LocalFileSystem error: Read-only file system (os error 30)"), errno.EROFS),
        (ValueError("No space left on device, says a scan"), None),
        (KeyError("x"), None),
    ],
)
def test_libraries_say_in_their_own_words_what_the_system_refuses(error: Exception, number: int | None) -> None:
    if isinstance(error, ValueError):
        assert number_of(type("Odd", (ValueError,), {"__module__": "tasks.somewhere"})(*error.args)) is None
        return
    assert number_of(error) == number
    with pytest.raises(Refused if number else type(error)) as caught, in_words("/lake"):
        raise error
    if number:
        assert caught.value.errno == number
        assert str(caught.value).startswith("/lake: ")


@pytest.mark.parametrize(("text", "kind"), [("No space left on device (os error 28)", Refused), ("index out of bounds", RuntimeError)])
def test_a_panic_of_rust_is_an_exception_that_others_can_catch(text: str, kind: type[Exception], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PanicException, "__module__", "pyo3_runtime")
    with pytest.raises(kind), in_words("/lake/tables/scenes"):
        raise PanicException(text)


@pytest.mark.parametrize("words", [("status",), ("lake", "compact"), ("run", "--scans", "{tmp}/scans")])
def test_a_lake_that_is_a_file_is_one_line(words: tuple[str, ...], tmp_path: Path) -> None:
    (tmp_path / "lake").write_text("no lake")
    (tmp_path / "scans").mkdir()
    done = shell(*(word.format(tmp=tmp_path) for word in words), "--lake", str(tmp_path / "lake"))
    assert (done.returncode, len(done.stderr.strip().splitlines())) == (2, 1), done.stderr
