"""The catalog of a release: a DuckDB file of views over its Parquet files, which any DuckDB can attach.

    ATTACH 'releases/v1/v1.duckdb' AS v1 (READ_ONLY);
    SELECT * FROM v1.headline;

A view must say where its files are. It says where they were when the catalog was made, unless the variable
`<name>_folder` is set: ``SET VARIABLE v1_folder = '/where/it/is/now'``. So a folder that was moved or copied stays of use.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from schemas.tables import TABLES
from warehouse import views
from warehouse.documentation import comment_statements, quoted
from warehouse.macros import literal

if TYPE_CHECKING:
    import duckdb

# The oldest that DuckDB can write: every DuckDB from 1.0 on reads it.
_STORAGE_VERSION = "v1.0.0"


def variable_of(name: str) -> str:
    """The DuckDB variable that says where the files of a release are now: `v1_folder`."""
    return re.sub(r"[^A-Za-z0-9_]", "_", name) + "_folder"


def write_catalog(file: Path, name: str, address: str, present: Path | str | None = None) -> None:
    """Write the catalog of release `name`, whose Parquet files are at `address`, a folder or `s3://...`.

    `present` is where the files are while it is written, if that is elsewhere: DuckDB looks at them.
    """
    import duckdb

    file.unlink(missing_ok=True)
    with duckdb.connect(":memory:") as connection:
        connection.execute(f"ATTACH {literal(str(file))} AS made (STORAGE_VERSION '{_STORAGE_VERSION}')")
        connection.execute("USE made")
        connection.execute(f"SET VARIABLE {quoted(variable_of(name))} = {literal(str(present or address))}")
        folder = f"coalesce(getvariable({literal(variable_of(name))}), {literal(address)})"
        for table in TABLES.values():
            source = f"read_parquet({folder} || {literal(f'/{table.name}.parquet')})"
            connection.execute(f"CREATE VIEW {quoted(table.name)} AS SELECT * FROM {source}")
            connection.execute(";\n".join(comment_statements(table)))
        views.install(connection)
        connection.execute("USE memory")
        connection.execute("DETACH made")


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
