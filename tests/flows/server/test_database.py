"""The database of a new Prefect home, copied from a migrated one."""

from __future__ import annotations

import contextlib
import os
import sqlite3
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from flows.server import database
from flows.server.database import place_database, sqlite_file


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A new Prefect home, and an installation whose migrated database is a text."""
    for name in list(os.environ):
        if name.startswith("PREFECT_"):
            monkeypatch.delenv(name)
    monkeypatch.setenv("PREFECT_HOME", str(tmp_path / "home"))
    template = tmp_path / "template.db"
    template.write_text("migrated")
    monkeypatch.setattr(database, "_template", lambda: template)
    return tmp_path / "home"


def test_a_new_home_has_a_copy_that_only_its_user_reads(home: Path) -> None:
    assert place_database() == home / "prefect.db"
    assert [path.name for path in home.glob("*prefect*")] == ["prefect.db"]
    assert (home / "prefect.db").read_text() == "migrated"
    assert stat.S_IMODE((home / "prefect.db").stat().st_mode) == 0o600


def test_a_database_that_exists_stays(home: Path) -> None:
    home.mkdir(exist_ok=True)
    (home / "prefect.db").write_text("mine")
    assert place_database() is None
    assert [path.read_text() for path in home.glob("*prefect*")] == ["mine"]


def test_a_database_that_another_server_makes_meanwhile_stays(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    template = database._template()

    def made_meanwhile() -> Path:
        home.mkdir(exist_ok=True)
        (home / "prefect.db").write_text("theirs")
        return template

    monkeypatch.setattr(database, "_template", made_meanwhile)
    assert place_database() is None
    assert [path.read_text() for path in home.glob("*prefect*")] == ["theirs"]


@pytest.mark.parametrize(
    ("url", "file"),
    [
        ("sqlite+aiosqlite:////a/b%20c.db", "/a/b c.db"),
        ("sqlite+aiosqlite:///file:/a/b.db?timeout=3", "/a/b.db"),
        ("sqlite+aiosqlite:///file::memory:?cache=shared", None),
        ("sqlite+aiosqlite:///:memory:", None),
        ("sqlite+aiosqlite://", None),
        ("postgresql+asyncpg://u:p@host/name", None),
        ("", None),
    ],
)
def test_only_a_file_of_sqlite_is_one(url: str, file: str | None) -> None:
    assert sqlite_file(url) == (None if file is None else Path(file))


def test_a_named_database_is_placed_where_it_is_named(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    named = home.parent / "elsewhere" / "of ours.db"
    monkeypatch.setenv("PREFECT_API_DATABASE_CONNECTION_URL", f"sqlite+aiosqlite:///{named}")
    assert place_database() == named
    assert not (home / "prefect.db").exists()
    monkeypatch.setenv("PREFECT_API_DATABASE_CONNECTION_URL", "postgresql+asyncpg://u:p@host/name")
    assert place_database() is None


def test_without_a_place_for_the_migrated_database_prefect_migrates_itself(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused() -> Path:
        raise PermissionError("read-only")

    monkeypatch.setattr(database, "_template", refused)
    assert place_database() is None
    assert not (home / "prefect.db").exists()


def rows_and_schema(file: Path) -> tuple[list[object], dict[str, int]]:
    with contextlib.closing(sqlite3.connect(file)) as connection:
        rows = connection.execute("SELECT type, name, tbl_name, sql FROM sqlite_schema ORDER BY 1, 2, 3").fetchall()
        # The order of a table's constraints differs from one migration to the next.
        schema = [(*names, sorted(line.strip().rstrip(",") for line in (sql or "").splitlines())) for *names, sql in rows]
        tables = [name for kind, name, _, _ in rows if kind == "table"]
        return list(schema), {name: connection.execute(f'SELECT count(*) FROM "{name}"').fetchone()[0] for name in tables}


@pytest.mark.slow
@pytest.mark.whole
def test_the_migrated_database_is_what_prefect_makes(tmp_path: Path) -> None:
    """Its tables, indexes and rows are those of Prefect's own command on an empty home."""
    database._migrate(tmp_path / "ours.db")
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")}
    subprocess.run(
        [sys.executable, "-m", "prefect", "server", "database", "upgrade", "-y"],
        env={**kept, "PREFECT_HOME": str(tmp_path / "home"), "DO_NOT_TRACK": "1"}, check=True, capture_output=True, timeout=300,
    )  # fmt: skip
    schema, counts = rows_and_schema(tmp_path / "ours.db")
    assert (schema, counts) == rows_and_schema(tmp_path / "home" / "prefect.db")
    assert counts.pop("alembic_version") == 1
    assert set(counts.values()) == {0}, "nothing of one home reaches another"
    assert [path.name for path in tmp_path.glob("ours*")] == ["ours.db"]


def test_a_log_without_its_database_is_no_new_home(home: Path) -> None:
    home.mkdir(exist_ok=True)
    (home / "prefect.db-wal").write_text("of a database that is gone")
    assert place_database() is None
    assert [path.name for path in home.glob("*prefect*")] == ["prefect.db-wal"]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An installation that nobody may write, and a user's cache folder."""
    monkeypatch.setattr(database, "__file__", str(tmp_path / "file" / "database.py"))
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setattr(database, "cache_folder", lambda: tmp_path / "cache")
    return tmp_path / "cache"


def test_a_damaged_copy_of_the_migrated_database_is_made_again(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Path] = []

    def migrate(file: Path) -> None:
        made.append(file)
        with contextlib.closing(sqlite3.connect(file)) as connection, connection:
            connection.execute("CREATE TABLE alembic_version (version_num TEXT)")
            connection.execute("INSERT INTO alembic_version VALUES ('head')")

    monkeypatch.setattr(database, "_migrate", migrate)
    place = database._template()
    assert place.parent == cache
    assert database._template() == place
    assert len(made) == 1
    for damage in (b"", place.read_bytes()[:4096], b"no database" * 100):
        place.write_bytes(damage)
        assert database._template() == place
        assert database._is_sound(place)
    assert len(made) == 4


def test_migrations_that_fail_are_left_to_prefect(home: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from sqlalchemy.exc import OperationalError

    def fails(file: Path) -> None:
        raise OperationalError("CREATE TABLE flow", None, sqlite3.OperationalError("disk I/O error"))

    monkeypatch.undo()
    for name in list(os.environ):
        if name.startswith("PREFECT_"):
            monkeypatch.delenv(name)
    monkeypatch.setenv("PREFECT_HOME", str(home))
    monkeypatch.setattr(database, "__file__", str(home.parent / "file" / "database.py"))
    monkeypatch.setattr(database, "cache_folder", lambda: cache)
    monkeypatch.setattr(database, "_migrate", fails)
    assert place_database() is None
    assert not (home / "prefect.db").exists()
    assert list(cache.iterdir()) == []
