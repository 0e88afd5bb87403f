"""Opening what others wrote: nothing but regular files of an agreed size, and nothing that waits."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from schemas.errors import InputError
from schemas.files import AnyPath, HeldPath, check_file, is_there, open_file, read_file
from tasks.exports.files import write_folder


def pipe(path: Path) -> None:
    os.mkfifo(path)


def plug(path: Path) -> None:
    here = os.open(path.parent, os.O_RDONLY)
    try:
        with socket.socket(socket.AF_UNIX) as made:
            made.bind(f"/proc/self/fd/{here}/{path.name}")
    finally:
        os.close(here)


def device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def terminal(path: Path) -> None:
    path.symlink_to("/dev/tty")


def folder(path: Path) -> None:
    path.mkdir()


def sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(2**40)


SPECIAL = {"pipe": pipe, "socket": plug, "device": device, "terminal": terminal, "folder": folder, "sparse": sparse}


@pytest.mark.parametrize("make", SPECIAL.values(), ids=SPECIAL)
@pytest.mark.parametrize("read", [read_file, open_file, check_file])
def test_what_is_no_regular_file_of_sane_size_is_refused_and_not_opened(
    tmp_path: Path, make: Callable[[Path], None], read: Callable[[Path, str, int], object]
) -> None:
    path = tmp_path / "file"
    make(path)
    with pytest.raises(InputError, match=r"scan/file: (file: is a|size: is 1099511627776 bytes, at most 1000)") as raised:
        read(path, "scan/file", 1000)
    assert raised.value.remedy


def test_a_file_of_just_the_agreed_size_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x" * 1000)
    assert read_file(path, "file", 1000) == b"x" * 1000
    with open_file(path, "file", 1000) as file:
        assert file.read() == b"x" * 1000
    with pytest.raises(InputError, match="is 1000 bytes, at most 999 are read"):
        read_file(path, "file", 999)


def test_what_says_that_it_is_empty_and_is_not_is_read_to_the_limit_and_no_further() -> None:
    path = Path("/proc/self/status")
    assert not path.stat().st_size
    assert read_file(path, "status", 2**20).startswith(b"Name:")
    with pytest.raises(InputError, match="status: size: is more than 10 bytes"):
        read_file(path, "status", 10)


def test_what_took_the_place_of_a_file_is_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"x")
    opening = os.open

    def swapped(name: Path, flags: int) -> int:
        path.unlink()
        os.mkfifo(path)
        return opening(name, flags)

    monkeypatch.setattr(os, "open", swapped)
    with pytest.raises(InputError, match="is a pipe"):
        open_file(path, "file", 10)


def test_a_missing_file_is_told_with_its_remedy(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^a: file: cannot be read \(No such file or directory\); copy it again$"):
        read_file(tmp_path / "a", "a", 10, "copy it again")
    with pytest.raises(FileNotFoundError):
        open_file(tmp_path / "a", "a", 10)


def test_settings_that_are_endless_are_refused_by_the_command_line(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "flows.cli", "run", "--scans", str(tmp_path), "--lake", str(tmp_path / "lake"), "--config"]
    ended = subprocess.run([*command, "/dev/zero"], capture_output=True, text=True)
    assert ended.returncode == 2
    assert "zero: file: is a device, not a regular file" in ended.stderr


HELD = {"a.obj": b"v 1", "meshes/b.obj": b"v 22", "meshes/deep/c.obj": b""}
NAMES = (*HELD, "./a.obj", "b.obj", "meshes", "", "meshes/../a.obj", "../a.obj", "/a.obj", "no.obj", "x" * 300, "a\0b")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("start", ["", "meshes"])
def test_files_in_memory_are_found_read_and_refused_as_those_on_disk(tmp_path: Path, name: str, start: str) -> None:
    write_folder(tmp_path, HELD)
    folder, held = tmp_path / start, HeldPath.folder(HELD) / start
    assert is_there(held / name) == is_there(folder / name)
    for most in (3, 4):
        on_disk, in_memory = (told(path, most) for path in (folder / name, held / name))
        assert on_disk == in_memory or not is_there(folder / name)
        assert is_there(folder / name) or in_memory.startswith("file: file: cannot be read (No such file")
    assert {path.name for path in held.glob("*.obj")} == {path.name for path in folder.glob("*.obj")}
    assert held.is_dir()
    assert not (held / "a.obj").is_dir()


def told(path: AnyPath, most_bytes: int) -> str:
    """What reading a file comes to."""
    try:
        return str(read_file(path, "file", most_bytes, magic=b"v"))
    except (InputError, ValueError) as error:
        return str(error)


def test_a_file_in_memory_has_the_name_ending_and_folder_of_one_on_disk() -> None:
    held = HeldPath.folder(HELD) / "meshes/deep/c.obj"
    assert (held.name, held.suffix, held.parent.name, held.parent.parent.parent.name) == ("c.obj", ".obj", "deep", "")
    assert held == HeldPath.folder(HELD) / "meshes" / "deep" / "c.obj"
    assert held != held.parent


@pytest.mark.parametrize("contents", [{"x" * 256: b""}, {"a": b"", "a/b": b""}, {"a": b"", "a/b/c": b""}])
def test_files_in_memory_that_no_folder_could_hold_are_refused(tmp_path: Path, contents: dict[str, bytes]) -> None:
    with pytest.raises(OSError, match=r"too long|Not a directory"):
        HeldPath.folder(contents)
    with pytest.raises(OSError, match=r"too long|Not a directory|exists"):
        write_folder(tmp_path, contents)
