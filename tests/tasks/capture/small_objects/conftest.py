"""Networks that several tests take."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.models.drawn_networks import write_networks
from tests.conftest import made_once


@pytest.fixture(scope="session")
def networks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with folders of tiny networks of random weights."""
    pytest.importorskip("torch")
    pytest.importorskip("transformers")
    return made_once(tmp_path_factory, "tiny_networks", write_networks)
