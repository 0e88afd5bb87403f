"""Checkpoints of the network's training are those of its code."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from bench.models.trained import checkpoints as module
from bench.models.trained.checkpoints import MODULES, checkpoints

FOLDER = Path(module.__file__).parent
PACKAGE = "bench.models.trained."


def test_what_is_kept_is_there_for_the_same_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path))
    checkpoints()["parting-1.pt"] = b"weights"
    assert dict(checkpoints()) == {"parting-1.pt": b"weights"}
    monkeypatch.setattr(module, "code_fingerprint", lambda name: f"another {name}")
    assert not dict(checkpoints())


def test_every_module_is_named_that_the_training_is_made_of() -> None:
    wanted, queue = set(), ["fitting"]
    while queue:
        name = queue.pop()
        wanted.add(name)
        for node in ast.walk(ast.parse((FOLDER / f"{name}.py").read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(PACKAGE):
                other = str(node.module).removeprefix(PACKAGE).replace(".", "/")
                queue += [other] if other not in wanted else []
    assert wanted == set(MODULES)
