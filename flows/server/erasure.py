"""Erasure from Prefect: the rows of its local database, the files of its home, and the remains on servers elsewhere."""

from __future__ import annotations

import base64
import binascii
import contextlib
import dataclasses
import os
import re
import urllib.parse
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from flows.server.access import prefect_home
from flows.server.database import sqlite_file
from flows.server.records import KEPT_TABLES, PrefectDatabase
from warehouse.questions.quoting import listed, literal
from warehouse.upkeep.erasure import Traces
from warehouse.upkeep.erasure.proof import Hit, Proof, hits_in, paths_below, search_file, unreadable_hits
from warehouse.upkeep.erasure.traces import ERASED

if TYPE_CHECKING:
    from prefect.settings import Settings

RESULT_FOLDERS = ("storage", "dlq")
"""Folders of Prefect's home whose files are records of runs, so that those of the scene are removed."""

_LOOPBACK = {"127.0.0.1", "localhost", "::1"}
_BASE64 = re.compile(rb"[A-Za-z0-9+/]{24,}={0,2}")


@dataclasses.dataclass(frozen=True)
class PrefectErasure:
    """Result of an erasure from Prefect.

    `database`: the local database, None if there is none. `deleted`, `redacted`: rows, or all that tell on a dry run.
    `files`: removed files of its home. `remains`: lines that say where records may remain, and how to remove them.
    """

    database: str | None = None
    deleted: int = 0
    redacted: int = 0
    files: int = 0
    remains: tuple[str, ...] = ()

    @classmethod
    def total(cls, parts: Sequence[PrefectErasure]) -> PrefectErasure:
        """Several erasures of one command as one."""
        return cls(
            database=parts[-1].database if parts else None,
            deleted=sum(part.deleted for part in parts),
            redacted=sum(part.redacted for part in parts),
            files=sum(part.files for part in parts),
            remains=tuple(dict.fromkeys(line for part in parts for line in part.remains)),
        )


def erase_from_prefect(traces: Traces, dry_run: bool = False) -> PrefectErasure:
    """Remove the scene from Prefect's local database and home.

    Raises:
        LakeError: another process holds the database for too long.
    """
    if not _has_prefect():
        return PrefectErasure()
    places = _Places.of_settings()
    deleted = redacted = 0
    if places.database is not None:
        with contextlib.closing(PrefectDatabase(places.database, traces)) as database:
            if dry_run:
                deleted = sum(database.count().values())
            else:
                deleted, redacted = database.erase()
                if deleted or redacted or any(search_file(file, traces) for file in places.database_files):
                    database.shrink()
    result_files = [path for path in places.files() if places.is_record(path) and _tells(path, traces)]
    for path in result_files if not dry_run else ():
        path.unlink(missing_ok=True)
    name = None if places.database is None else str(places.database)
    remains = () if places.has_own_server() else remaining_lines(places.api, places.database_url, traces)
    return PrefectErasure(name, deleted, redacted, len(result_files), remains)


def search_prefect(traces: Traces) -> Proof:
    """Look for the scene in Prefect's local database, row by row and in its bytes, and in the files of its home."""
    if not _has_prefect():
        return Proof(0, 0, 0, ())
    places = _Places.of_settings()
    files = size = rows = 0
    hits: list[Hit] = []
    if places.database is not None:
        with contextlib.closing(PrefectDatabase(places.database, traces)) as database:
            rows = database.rows()
            hits += [Hit(str(places.database), f"table {table}", count, ()) for table, count in database.count().items()]
    for path in places.files():
        try:
            file_hits = search_file(path, traces) if path in places.database_files else _file_hits(path, traces)
            files, size, hits = files + 1, size + path.stat().st_size, [*hits, *file_hits]
        except OSError as error:
            hits += unreadable_hits(path, error)
    return Proof(files, size, rows, tuple(hits))


def _has_prefect() -> bool:
    """True if Prefect was ever used here: it makes its home when it is imported. Importing it takes seconds."""
    return prefect_home().exists() or any(name.startswith("PREFECT_") and name != "PREFECT_HOME" for name in os.environ)


@dataclasses.dataclass(frozen=True)
class _Places:
    """Places in which Prefect keeps records: its home, result storage and database, and the server that its clients ask."""

    home: Path
    storage: Path
    database: Path | None
    database_url: str
    api: str

    @classmethod
    def of_settings(cls) -> _Places:
        """Read environment and profile as Prefect does, again at each call."""
        from prefect.settings import Settings

        settings: Settings = Settings()
        url = settings.server.database.connection_url
        address = url.get_secret_value() if url is not None else ""
        home = Path(settings.home).expanduser()
        storage = Path(settings.results.local_storage_path or home / "storage").expanduser()
        file = sqlite_file(address)
        database = file if file is not None and file.is_file() else None
        return cls(home, storage, database, address, str(settings.api.url or ""))

    @property
    def database_files(self) -> tuple[Path, ...]:
        """The database, its write-ahead log and its journal."""
        file = self.database
        return () if file is None else tuple(file.with_name(file.name + end) for end in ("", "-wal", "-journal"))

    def files(self) -> list[Path]:
        """All files of home, result storage and database."""
        paths = {path for folder in (self.home, self.storage) for path in paths_below(folder)} | set(self.database_files)
        return sorted(path for path in paths if os.path.isfile(path) and not os.path.islink(path))

    def is_record(self, path: Path) -> bool:
        """True if a file is a record of runs that can be removed."""
        return any(path.is_relative_to(folder) for folder in (self.storage, *(self.home / name for name in RESULT_FOLDERS)))

    def has_own_server(self) -> bool:
        """True if all processes that listen at the API's address have this very database open.

        A token file does not prove that: it stays when a tunnel or a container takes the port.
        """
        import psutil

        host, port = _host_and_port(self.api)
        if self.database is None or host not in _LOOPBACK:
            return False
        with contextlib.suppress(psutil.Error, OSError):
            connections = [place for place in psutil.net_connections("tcp") if place.status == psutil.CONN_LISTEN]
            owners = {place.pid for place in connections if place.laddr.port == port}
            return bool(owners) and all(owner and _has_open(owner, self.database) for owner in owners)
        return False


def _has_open(pid: int, file: Path) -> bool:
    """True if a process has a file open."""
    import psutil

    return any(file.samefile(opened.path) for opened in psutil.Process(pid).open_files() if os.path.isfile(opened.path))


def _host_and_port(address: str) -> tuple[str, int]:
    """Host and port of an address; no host if it cannot be read."""
    try:
        place = urllib.parse.urlsplit(_without_login(address))
        return place.hostname or "", place.port or {"https": 443}.get(place.scheme, 80)
    except ValueError:
        return "", 0


def _without_login(address: str) -> str:
    """Scheme, host, port and path of an address. Passwords may hold any character, so all before the last @ goes."""
    scheme, _, rest = address.partition("://")
    return f"{scheme}://{re.split('[?#]', rest.rpartition('@')[2])[0]}"


def remaining_lines(api: str, database_url: str, traces: Traces) -> tuple[str, ...]:
    """Lines about records that this machine may not have removed, with the commands that do.

    Args:
        api: address of the server that clients ask; empty for one that each run starts itself. Its login is not repeated.
        database_url: connection URL of Prefect's database; its user and password are not repeated.
        traces: names of the scene.
    """
    is_sqlite = database_url.startswith("sqlite")
    if not api and is_sqlite:
        return ()
    address = _without_login(api)
    where = f"the Prefect server at {address}" if api else "the Prefect database that is named"
    if not is_sqlite:
        place, _, name = _without_login(database_url).partition("://")[2].partition("/")
        where += f" (database {name} on {place or 'this machine'})"
    # A port of this machine may lead to a container or through a tunnel.
    unless = ", unless it uses the database of this Prefect home" if is_sqlite and _host_and_port(api)[0] in _LOOPBACK else ""
    lines = [
        f"not reached{unless}: {where} keeps names of task runs, logs, events and artifacts of the scene",
        "if it is on SQLite: give this command where that file lies, with PREFECT_API_DATABASE_CONNECTION_URL set",
        f"if it is on PostgreSQL: psql DATABASE -c {_shell_quoted(postgres_statement(traces))}",
    ]
    if api:
        names = " or ".join(traces.cores)
        lines.append(
            f"if you only have its API: list task runs by POST {address}/task_runs/filter "
            f'{{"task_runs": {{"name": {{"like_": "{traces.cores[0]}"}}}}}} and send DELETE {address}/task_runs/ID for each; '
            f"`prefect flow-run delete ID` and `prefect artifact delete KEY` for those that name {names}; "
            "its events go when the server's retention ends"
        )
    return tuple(lines)


def postgres_statement(traces: Traces) -> str:
    """SQL that erases from PostgreSQL as `PrefectDatabase` does from SQLite: all of it, or nothing if a part fails.

    It looks for names. Hashes are left out: those of a large scene exceed the length that a shell allows an argument.
    """
    own, other = (literal(_pattern(names)) for names in (traces.names, traces.spared))
    identifier = literal("(?<![0-9a-f-])[0-9a-f]{8}(?:-[0-9a-f]{4}){3}-[0-9a-f]{12}(?![0-9a-f-])")
    kept = listed(sorted({*KEPT_TABLES, "flow", "flow_run", "block_type", "block_schema"}))
    columns = (
        "SELECT table_name t, column_name f, data_type d FROM information_schema.columns JOIN information_schema.tables "
        "USING (table_schema, table_name) WHERE table_schema = current_schema() AND table_type = 'BASE TABLE' AND data_type IN "
    )
    texts = "('text', 'character varying', 'json', 'jsonb')"
    # Task runs of other scenes stay although they may name one that went as their input.
    is_leaf = (
        "NOT EXISTS (SELECT FROM pg_constraint WHERE contype = 'f' AND confdeltype = 'c' "
        "AND confrelid = format('%I.%I', table_schema, table_name)::regclass)"
    )
    removal = (
        "EXECUTE format('WITH d AS (DELETE FROM %I r WHERE {} RETURNING to_jsonb(r) ->> ''id'' i) SELECT array_agg(i) FROM d', "
        "c.t, c.f) INTO more USING gone; gone := gone || more; END LOOP; "
    )
    change = "EXECUTE format('UPDATE %I SET %I = {}::%s WHERE pg_temp.tells(%I::text)', c.t, c.f, c.f, c.v, c.d, c.f); "
    return (
        # Names of other scenes that hold a name of this one do not count.
        "CREATE FUNCTION pg_temp.tells(v text) RETURNS boolean LANGUAGE sql AS $f$ "
        f"SELECT regexp_replace(v, {other}, '', 'g') ~ {own} $f$; "
        "CREATE FUNCTION pg_temp.named(v text) RETURNS text[] LANGUAGE sql AS $f$ "
        f"SELECT ARRAY(SELECT (regexp_matches(v, {identifier}, 'g'))[1]) $f$; "
        "CREATE FUNCTION pg_temp.redacted(v text) RETURNS text LANGUAGE sql AS $f$ "
        f"SELECT coalesce(string_agg(CASE WHEN pg_temp.tells(l) THEN {literal(ERASED)} ELSE l END, chr(10) ORDER BY n), v) "
        "FROM unnest(string_to_array(v, chr(10))) WITH ORDINALITY u(l, n) $f$; "
        "CREATE FUNCTION pg_temp.redacted(v jsonb) RETURNS jsonb LANGUAGE plpgsql AS $f$ BEGIN RETURN coalesce(CASE jsonb_typeof(v) "
        "WHEN 'object' THEN (SELECT jsonb_object_agg(pg_temp.redacted(k), pg_temp.redacted(x)) FROM jsonb_each(v) e(k, x)) "
        "WHEN 'array' THEN (SELECT jsonb_agg(pg_temp.redacted(x) ORDER BY n) FROM jsonb_array_elements(v) WITH ORDINALITY e(x, n)) "
        "WHEN 'string' THEN to_jsonb(pg_temp.redacted(v #>> '{}')) END, v); END $f$; "
        "DO $$ DECLARE c record; gone text[] := '{}'; more text[]; BEGIN "
        f"FOR c IN {columns} {texts} AND table_name NOT IN ({kept}) LOOP {removal.format('pg_temp.tells(%I::text)')}"
        f"FOR c IN {columns} {texts[:-1]}, 'uuid') AND table_name NOT IN ({kept}) AND {is_leaf} LOOP "
        f"{removal.format('pg_temp.named(%I::text) && $1')}"
        "FOR c IN SELECT *, CASE WHEN d LIKE 'json%' THEN 'jsonb' ELSE 'text' END v FROM "
        f"({columns} {texts} AND table_name IN ({kept})) k LOOP "
        f"BEGIN {change.format('pg_temp.redacted(%I::%s)')}"
        # A name that may be there once only.
        "EXCEPTION WHEN unique_violation THEN "
        f"{change.format('(pg_temp.redacted(%I::%s) || ' + chr(39) * 2 + '-' + chr(39) * 2 + ' || md5(ctid::text))')}"
        "END; END LOOP; END $$"
    )


def _pattern(names: Collection[str]) -> str:
    """A regular expression of PostgreSQL for names that stand alone; one that matches nothing without names."""
    ordered = sorted(names, key=lambda name: (-len(name), name))
    start = r"((?<![A-Za-z0-9])|(?<=\\[bfnrt])|(?<=\\u[0-9A-Fa-f]{4}))"  # as in Traces: an escape of JSON is no letter
    return f"{start}({'|'.join(map(re.escape, ordered))})(?![A-Za-z0-9])" if ordered else "(?!)"


def _tells(path: Path, traces: Traces) -> bool:
    """True if a file tells of the scene; a search names those that cannot be read."""
    with contextlib.suppress(OSError):
        return bool(_file_hits(path, traces))
    return False


def _file_hits(path: Path, traces: Traces) -> list[Hit]:
    """Hits in a file's name and content; results of runs hold their values in base64."""
    data = path.read_bytes()
    hits = hits_in(str(path), data, traces)
    for decoded in _decoded(data):
        hits += hits_in(str(path), decoded, traces, place="base64")
    return hits


def _decoded(data: bytes) -> Iterator[bytes]:
    for match in _BASE64.finditer(data):
        with contextlib.suppress(binascii.Error):
            yield base64.b64decode(match[0] + b"=" * (-len(match[0]) % 4))


def _shell_quoted(text: str) -> str:
    return "'" + text.replace("'", "'\\''") + "'"
