"""What tests share: where real data lies, and how a skip says why."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent

os.environ.setdefault("DO_NOT_TRACK", "1")
os.environ.setdefault("MPLBACKEND", "Agg")


@pytest.fixture
def realdata() -> Callable[[str], Path]:
    """Path of a folder of real data by others, or a skip that says why.

    The data is never in the repository. METASCENES_REALDATA names its folder; without it,
    `shared/realdata` beside the repository is looked at.
    """
    root = Path(os.environ.get("METASCENES_REALDATA") or REPOSITORY.parent / "shared" / "realdata")

    def find(name: str) -> Path:
        path = root / name
        if not path.exists():
            pytest.skip(f"real data {name!r} is not in {root}; set METASCENES_REALDATA to the folder that holds it")
        return path

    return find
