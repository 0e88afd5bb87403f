"""Readers of text that may come from elsewhere: JSON is read within the budget, and nesting is refused by a reader's own error."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from flows.run.fingerprints import FileHashes
from flows.scans.storeys import STOREYS_RECORD, _record
from schemas.errors import InputError
from schemas.parsing import json_value
from tasks.lineage.places import places
from tasks.models import ModelFolder
from tests.conftest import REPOSITORY
from warehouse.lake import Lake
from warehouse.sharing.held import parsed
from warehouse.tables.released import parse_release

ROOMS = ("schemas", "tasks", "warehouse", "flows")
PLAIN_JSON = {
    "schemas/parsing/__init__.py": "the bounded reader itself",
    "tasks/batches.py": "the schema of a batch, a file of the package",
    "tasks/kernels/ahead.py": "the list of kernels, a file of the package",
    "tasks/capture/poses/open3d_script.py": "runs without the package, on settings that the package wrote",
    "warehouse/questions/reads.py": "DuckDB's syntax tree: DuckDB bounds its depth, which may exceed that of documents",
    "warehouse/questions/sql.py": "DuckDB's syntax tree: DuckDB bounds its depth, which may exceed that of documents",
}
"""Modules that may call the standard library's JSON reader, and why."""

DEEP = b"[" * 100_000 + b"]" * 100_000


def readers(tree: ast.AST) -> Iterator[int]:
    """Lines that read JSON by the standard library."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module == "json" and {"load", "loads"} & {name.name for name in node.names}:
            yield node.lineno
        if isinstance(node, ast.Attribute) and node.attr in ("load", "loads", "JSONDecoder") and isinstance(node.value, ast.Name):
            yield from [node.lineno] * (node.value.id in ("json", "orjson", "simplejson", "ujson"))


@pytest.mark.parametrize("room", ROOMS)
def test_json_is_read_within_the_budget(room: str) -> None:
    files = {file.relative_to(REPOSITORY).as_posix(): file for file in (REPOSITORY / room).rglob("*.py")}
    assert not [name for name in PLAIN_JSON if name in files and not list(readers(ast.parse(files[name].read_text())))]
    found = [f"{name}:{line}" for name, file in files.items() if name not in PLAIN_JSON for line in readers(ast.parse(file.read_text()))]
    assert not found, "use schemas.parsing.json_value or tasks.batches.parse_json, which refuse deep nesting"


@pytest.mark.parametrize("text", [DEEP, b'{"a":' * 100_000 + b"1" + b"}" * 100_000, b"[" * 300 + b"]" * 300, b"[" * 100_000])
def test_nesting_is_a_value_error(text: bytes) -> None:
    for each in (text, text.decode()):
        with pytest.raises(ValueError, match=r"nested deeper than 256 values|line 1 column"):
            json_value(each)


def test_records_on_disk_that_are_nested_are_refused_or_left_out(tmp_path: Path) -> None:
    (tmp_path / STOREYS_RECORD).write_bytes(DEEP)
    with pytest.raises(InputError, match=f"{STOREYS_RECORD}: content: is not a record of storeys; remove the folder"):
        _record(tmp_path)
    (tmp_path / "hashes.json").write_bytes(DEEP)
    assert FileHashes(tmp_path / "hashes.json")._known == {}, "a damaged cache is written again"
    (tmp_path / "model.json").write_bytes(DEEP)
    with pytest.raises(InputError, match=r"model\.json: is nested deeper than 256 values"):
        _ = ModelFolder(tmp_path).document
    with pytest.raises(InputError):
        parse_release("release.json", DEEP)
    assert parsed(DEEP) is None
    lake = tmp_path / "lake"
    lake.mkdir()
    (lake / "lake.json").write_bytes(DEEP)
    with pytest.raises(InputError, match=r"lake\.json: format: cannot be read; restore the file"):
        Lake.open(lake)._read_marker()


GLB_HEAD = b"glTF\2\0\0\0" + bytes(4) + len(DEEP).to_bytes(4, "little") + b"JSON"
SCENE_FILES = [("nav2", DEEP), ("habitat", DEEP), ("urdf", DEEP), ("glb", GLB_HEAD + DEEP),
               ("mjcf", b"<mujoco><text name='a' data='{" + b'"a":[' * 5000 + b"'/></mujoco>")]  # fmt: skip


@pytest.mark.parametrize(("format", "data"), SCENE_FILES)
def test_scene_files_that_are_nested_are_refused_in_one_line(format: str, data: bytes) -> None:
    with pytest.raises(InputError, match="cannot be read") as refused:
        places(format, "scene", data)
    assert "\n" not in str(refused.value)
