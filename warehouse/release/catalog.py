"""The catalog of a release: a DuckDB file of views over its Parquet files, which any DuckDB can attach.

    ATTACH 'releases/v1/v1.duckdb' AS v1 (READ_ONLY);
    SELECT * FROM v1.headline;

A view must say where its files are. It says where they were when the catalog was made, unless the variable
`<name>_folder` is set: ``SET VARIABLE v1_folder = '/where/it/is/now'``. So a folder that was moved or copied stays of use.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from schemas.errors import InputError
from schemas.files import making, read_file
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.questions import views
from warehouse.questions.documentation import comment_statements
from warehouse.questions.quoting import literal, quoted
from warehouse.questions.renames import move_into, with_former
from warehouse.tables.released import RECORD, folder_of, parse_release, released
from warehouse.tables.snapshot import relation

if TYPE_CHECKING:
    import duckdb

# The oldest that DuckDB can write: every DuckDB from 1.0 on reads it.
_STORAGE_VERSION = "v1.0.0"


_RECORD_BYTES = 2**24  # a release that ten thousand erasures touched stays below it


def variable_of(name: str) -> str:
    """The DuckDB variable that says where the files of a release are now: `v1_folder`."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name) + "_folder"


def write_catalog(
    file: Path, name: str, address: str, present: Path | str | None = None, *, tables: Collection[str] | None = None,
    register: Callable[[Any], None] = lambda connection: None,
) -> None:  # fmt: skip
    """Write the catalog of release `name`, whose Parquet files are at `address`, a folder or `s3://...`.

    `present` is where the files are while it is written, if that is elsewhere: DuckDB looks at them. `tables` are those
    that have a file, all by default: an older release lacks younger tables and columns, which are made empty.
    `register` teaches a connection to read the address.
    """
    import duckdb

    file.unlink(missing_ok=True)
    with duckdb.connect(":memory:") as connection:
        register(connection)
        connection.execute(f"ATTACH {literal(str(file))} AS made (STORAGE_VERSION '{_STORAGE_VERSION}')")
        connection.execute("USE made")
        connection.execute(f"SET VARIABLE {quoted(variable_of(name))} = {literal(str(present or address))}")
        folder = f"coalesce(getvariable({literal(variable_of(name))}), {literal(address)})"
        for table in TABLES.values():
            source, former, move = None, None, move_into(table.name)
            if tables is None or table.name in tables:
                source = f"SELECT * FROM read_parquet({folder} || {literal(f'/{table.name}.parquet')})"
                columns = [row[0] for row in connection.execute(f"DESCRIBE {source}").fetchall()]
                if columns != [column.name for column in table.columns]:
                    source = relation(table, source)
            elif move is not None and move.before in (tables or ()):
                former = f"SELECT * FROM read_parquet({folder} || {literal(f'/{move.before}.parquet')})"
            connection.execute(f"CREATE VIEW {quoted(table.name)} AS {with_former(table.name, source or relation(table, None, former))}")
            connection.execute(";\n".join(comment_statements(table)))
        views.install(connection)
        connection.execute("USE memory")
        connection.execute("DETACH made")


def attach_release(lake: Lake, name: str, file: Path) -> None:
    """Write the catalog of a release for where its folder is now. `name` is a release of the lake, or a folder that holds one.

    Raises:
        InputError: there is no such release, or its folder lacks its tables.
    """
    if Path(name, RECORD).is_file():
        folder = Path(os.path.abspath(name))
        release = parse_release(str(folder / RECORD), read_file(folder / RECORD, str(folder / RECORD), _RECORD_BYTES))
        _write_whole(file, release.name, str(folder), [path.name for path in folder.iterdir()], lambda connection: None)
        return
    known = [release.name for release in released(lake.storage)]
    if name not in known:
        remedy = f"there are: {', '.join(known) or 'none'}; or name a release's folder"
        raise InputError(lake.address, "release", f"no release {name!r}", remedy)
    files = lake.storage.names(folder_of(name))
    _write_whole(file, name, lake.storage.duckdb_path(folder_of(name)), files, lake.storage.register)


def _write_whole(file: Path, name: str, address: str, files: Sequence[str], register: Callable[[Any], None]) -> None:
    """Write a catalog whole or not at all."""
    tables = {table for table in TABLES if f"{table}.parquet" in files}
    if not tables:
        raise InputError(address, "release", "has no tables", "restore the folder")
    with making(file) as unfinished:
        write_catalog(unfinished, name, address, tables=tables, register=register)


@contextmanager
def open_catalog(
    file: Path, name: str, folder: Path, settings: Mapping[str, str | int] | None = None
) -> Iterator[duckdb.DuckDBPyConnection]:
    """A connection to the catalog of release `name`, whose Parquet files are in `folder`."""
    import duckdb

    with duckdb.connect(":memory:", config=dict(settings or {})) as connection:
        connection.execute("SET TimeZone = 'UTC'")
        connection.execute(f"SET VARIABLE {quoted(variable_of(name))} = {literal(str(folder))}")
        connection.execute(f"ATTACH {literal(str(file))} AS release (READ_ONLY)")
        connection.execute("USE release")
        yield connection
