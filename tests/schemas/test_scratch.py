"""Temporary folders of killed processes are found and removed, and no others."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from schemas.machine import scratch
from schemas.machine.processes import boot_name, host_name, short_hash, start_of
from schemas.machine.scratch import abandoned_folders, sweep_temporary_folders, temporary_folder, temporary_folders
from tests.conftest import REPOSITORY

HOLDER = """
from schemas.machine.scratch import temporary_folder
with temporary_folder() as folder:
    (folder / "below").mkdir()
    (folder / "below" / "scan.ply").write_text("private")
    (folder / "below").chmod(0o500)
    print(folder, flush=True)
    input()
"""


@pytest.fixture(autouse=True)
def root(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of temporary files for this test alone."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    return tmp_path


def begin() -> tuple[subprocess.Popen[str], Path]:
    """A process that holds a temporary folder."""
    process = subprocess.Popen([sys.executable, "-c", HOLDER], cwd=REPOSITORY, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


def test_a_folder_is_for_its_owner_alone_and_ends_with_its_use() -> None:
    with temporary_folder() as folder:
        assert folder.stat().st_mode & 0o777 == 0o700
        assert temporary_folders() == [folder]
        assert abandoned_folders() == sweep_temporary_folders() == []
        assert folder.is_dir()
    assert temporary_folders() == []


@pytest.mark.parametrize("start", ["a first folder", "a command"])
def test_the_next_start_removes_the_folder_of_a_killed_process(root: Path, start: str) -> None:
    living, held = begin()
    killed, left = begin()
    assert temporary_folders() == sorted([held, left])
    assert abandoned_folders() == []
    killed.send_signal(signal.SIGKILL)
    killed.communicate()
    assert abandoned_folders() == [left]
    if start == "a command":
        subprocess.run([sys.executable, "-m", "flows.cli", "--version"], cwd=REPOSITORY, check=True, stdout=subprocess.DEVNULL)
    else:
        other, its_own = begin()
        other.communicate("\n")
        assert not its_own.exists()
    assert list(root.iterdir()) == [held]
    living.communicate("\n")
    assert living.returncode == 0
    assert list(root.iterdir()) == []


def test_no_module_makes_temporary_files_that_nothing_sweeps() -> None:
    """Files without a name (`TemporaryFile`) end with their process, and are permitted."""
    found = {
        path.relative_to(REPOSITORY).as_posix()
        for room in ("schemas", "tasks", "warehouse", "flows")
        for path in (REPOSITORY / room).rglob("*.py")
        if re.search(r"\b(TemporaryDirectory|NamedTemporaryFile|SpooledTemporaryFile|mkdtemp|mkstemp|mktemp)\b", path.read_text())
    }
    assert found == {"schemas/machine/scratch.py"}


def test_only_what_is_known_to_be_abandoned_is_removed(root: Path) -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    here, boot, start = host_name(), short_hash(boot_name()), start_of(1) or "1"
    kept = [
        f"metascenes-{here}-{boot}-1-{start}-alive",
        f"metascenes-{here}-{boot}-{ended.pid}-0-unknown",
        f"metascenes-{short_hash('another host')}-{boot}-{ended.pid}-12-elsewhere",
        f"metascenes-{here}-{boot}-{ended.pid}-12",
        f"metascenes-{ended.pid}-12-mine",
        "metascenes-notes",
        "metascenes",
        "model-1234",
    ]
    removed = [
        f"metascenes-{here}-{boot}-{ended.pid}-12-dead",
        f"metascenes-{here}-{boot}-1-{start}9-reused",
        f"metascenes-{here}-{short_hash('an earlier start')}-1-{start}-restarted",
    ]
    for name in (*kept, *removed):
        (root / name).mkdir()
    dead = f"metascenes-{here}-{boot}-{ended.pid}-12"
    (root / f"{dead}-file").write_text("a file")
    (root / f"{dead}-link").symlink_to(root / "metascenes-notes")
    (root / removed[0] / "link").symlink_to(root / "metascenes-notes")
    assert sweep_temporary_folders() == sorted(root / name for name in removed)
    assert {path.name for path in root.iterdir()} == {*kept, f"{dead}-file", f"{dead}-link"}


def test_folders_of_other_users_stay(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = root / f"metascenes-{host_name()}-{short_hash('earlier')}-1-1-theirs"
    folder.mkdir()
    owner = folder.stat().st_uid
    monkeypatch.setattr(scratch.os, "geteuid", lambda: owner + 1)
    assert temporary_folders() == sweep_temporary_folders() == []
    assert folder.is_dir()


def test_without_a_folder_of_temporary_files_there_is_nothing_to_sweep(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(root / "missing"))
    assert sweep_temporary_folders() == []
