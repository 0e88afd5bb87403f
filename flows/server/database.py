"""The SQLite database of a new Prefect home: a copy of one that was migrated once for all homes of an installation.

Prefect carries out more than a hundred migrations on an empty database, which costs a first start most of its time.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import shutil
import sqlite3
import urllib.parse
from importlib.metadata import version
from pathlib import Path

from flows.run.fingerprints import cache_folder
from schemas.files import making
from schemas.machine.scratch import temporary_folder


def place_database() -> Path | None:
    """Copy the migrated database to where the settings name a SQLite file that does not exist.

    Returns:
        The new file. None if one exists, or the database is of another kind, or no copy could be made: Prefect then
        migrates as it does everywhere.
    """
    from prefect.settings import Settings

    url = Settings().server.database.connection_url
    file = sqlite_file(url.get_secret_value() if url is not None else "")
    if file is None or any(file.with_name(file.name + end).exists() for end in ("", "-wal", "-shm", "-journal")):
        return None  # a log without its database would be replayed into the copy
    with contextlib.suppress(OSError, sqlite3.Error):
        template = _template()
        file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        copy = file.with_name(f".{file.name}.{secrets.token_hex(6)}.making")
        try:
            shutil.copyfile(template, copy)
            copy.chmod(0o600)
            os.link(copy, file)  # fails if another server made one meanwhile
        finally:
            copy.unlink(missing_ok=True)
        return file
    return None


def sqlite_file(url: str) -> Path | None:
    """File that a connection URL names, whether it exists or not; None for other databases and for one in memory."""
    kind, _, name = url.partition(":///")
    file = Path(urllib.parse.unquote(name.removeprefix("file:").partition("?")[0]))
    return file if kind.startswith("sqlite") and name and ":memory:" not in name else None


def _template() -> Path:
    """The migrated database of the installed version of Prefect: among the compiled modules, else in the user's cache.

    Raises:
        OSError: neither folder can be written, or the migrations failed.
    """
    name = f"prefect-{version('prefect')}.db"
    places = (Path(__file__).with_name("__pycache__") / name, cache_folder() / name)
    for place in places:
        if _is_sound(place):
            return place
    writable = [place for place in places if _can_be_written(place.parent)]
    if not writable:
        raise OSError(f"{places[-1]} cannot be written")
    with temporary_folder() as folder:
        migrated = folder / name
        try:
            _migrate(migrated)
        except Exception as error:  # of alembic or SQLAlchemy: Prefect tells of it where it migrates the home's own database
            raise OSError(f"{migrated}: cannot be migrated") from error
        for place in writable:
            with contextlib.suppress(OSError), making(place) as unfinished:
                shutil.copyfile(migrated, unfinished)
                return place
    raise OSError(f"{places[-1]} cannot be written")


def _is_sound(file: Path) -> bool:
    """True for a whole database that was migrated."""
    if not file.is_file():
        return False
    with (
        contextlib.suppress(sqlite3.Error),
        contextlib.closing(sqlite3.connect(f"{file.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as known,
    ):
        whole = known.execute("PRAGMA quick_check").fetchall() == [("ok",)]
        return whole and bool(known.execute("SELECT * FROM alembic_version").fetchall())
    return False


def _can_be_written(folder: Path) -> bool:
    """True if files can be made in a folder, which is made."""
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        return os.access(folder, os.W_OK)
    return False


def _migrate(file: Path) -> None:
    """Carry out Prefect's migrations on a new file, and leave all of its content in that one file."""
    from prefect.server.database import provide_database_interface
    from prefect.server.database.configurations import AioSqliteConfiguration
    from prefect.server.database.dependencies import temporary_database_config

    with temporary_database_config(AioSqliteConfiguration(f"sqlite+aiosqlite:///{file}")):
        asyncio.run(provide_database_interface().create_db())
    with contextlib.closing(sqlite3.connect(file, isolation_level=None)) as connection:
        (busy, *_) = connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
        if busy:
            raise OSError(f"{file}: its log is in use")
