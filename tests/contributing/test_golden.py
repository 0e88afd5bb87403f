"""`make golden`: everything that is generated is on disk as it would be written, and evidence of others is left alone."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY
from tests.contributing import golden_files


@pytest.fixture(scope="module")
def generated() -> dict[Path, str]:
    return golden_files.golden_files()


def test_nothing_is_left_to_be_written(generated: dict[Path, str]) -> None:
    stale = [path.relative_to(REPOSITORY).as_posix() for path, text in generated.items() if path.read_text() != text]
    assert stale == [], "write them with: make golden"


def test_what_other_programs_and_earlier_versions_made_is_not_written(generated: dict[Path, str]) -> None:
    golden = REPOSITORY / "tests" / "golden"
    kept = {path for path in golden.rglob("*") if path.is_file()} - generated.keys()
    assert {path.relative_to(golden).parts[0] for path in kept} == {"navmesh", "deployments.json"}
    assert not any(path.is_relative_to(REPOSITORY / "tests" / "earlier") for path in generated)


def test_files_that_changed_are_written_and_those_of_nothing_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("schemas", "catalog"):
        folder = tmp_path / name
        folder.mkdir()
        monkeypatch.setattr(getattr(golden_files, name), "GOLDEN", folder)
    made = {tmp_path / "schemas" / "a.json": "a", tmp_path / "catalog" / "b.json": "b"}
    monkeypatch.setattr(golden_files, "golden_files", lambda: made)
    gone = tmp_path / "catalog" / "old.json"
    gone.write_text("old")
    next(iter(made)).write_text("a")
    assert golden_files.write_golden_files() == [tmp_path / "catalog" / "b.json", gone]
    assert {path: path.read_text() for path in tmp_path.rglob("*.json")} == made
    assert golden_files.write_golden_files() == []


def test_a_view_that_changed_wants_its_version_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    described = golden_files.catalog.described
    monkeypatch.setattr(golden_files.catalog, "described", lambda lake, asked: described(lake, asked) | {"columns": {}})
    with pytest.raises(SystemExit, match="raise the version in its file, then make golden"):
        golden_files.golden_files()


def test_every_test_of_what_is_generated_names_the_command() -> None:
    """A comparison with a golden file or a generated page says how it is written."""
    for path in ("tests/schemas/test_schemas.py", "tests/warehouse/questions/test_catalog.py", "tests/flows/run/test_configuration.py",
                 "tests/flows/run/test_settings.py", "tests/flows/documentation/test_commands_page.py",
                 "tests/warehouse/questions/test_reads.py"):  # fmt: skip
        text = (REPOSITORY / path).read_text()
        assert "make golden" in text, path
        assert not re.findall(r"python -m tests\.|make docs|make pages", text), path
