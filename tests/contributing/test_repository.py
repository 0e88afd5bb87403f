"""What the repository holds, and what it must not."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[2]


def test_nothing_that_git_ignores_is_in_the_repository() -> None:
    """What is built, fetched or measured is made anew by whoever needs it; three.js among it."""
    if shutil.which("git") is None or not (REPOSITORY / ".git").exists():
        pytest.skip("no git repository here: the sources were unpacked from an archive")
    command = ["git", "-C", str(REPOSITORY), "ls-files", "--cached", "--ignored", "--exclude-standard"]
    assert subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines() == []
