"""Erasure from Prefect: rows of its database and files of its home go, those of others stay, servers elsewhere are named."""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import json
import os
import socket
import sqlite3
import subprocess
import sys
import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from flows.server.erasure import erase_from_prefect, postgres_statement, remaining_lines, search_prefect
from flows.server.records import PrefectDatabase, redacted_text
from schemas.errors import LakeError
from tests.conftest import REPOSITORY
from tests.services import postgres_server
from warehouse.upkeep.erasure.traces import Traces, traces_of

HOME, OTHER = "demo/scene0001_00", "demo/scene0002_00"
TRACES = traces_of(HOME, [HOME], [OTHER, "demo/scene0001_00_b"])
LABEL = "grandmother's wardrobe"

TABLES = """
CREATE TABLE flow (id TEXT PRIMARY KEY, name TEXT UNIQUE);
CREATE TABLE artifact (id TEXT PRIMARY KEY, key TEXT, data JSON, task_run_id TEXT);
CREATE TABLE flow_run (id TEXT PRIMARY KEY, flow_id TEXT NOT NULL REFERENCES flow(id) ON DELETE CASCADE, name TEXT, parameters JSON,
    parent_task_run_id TEXT REFERENCES task_run(id) ON DELETE SET NULL);
CREATE TABLE flow_run_state (id TEXT PRIMARY KEY, flow_run_id TEXT NOT NULL REFERENCES flow_run(id) ON DELETE CASCADE, message TEXT);
CREATE TABLE task_run (id TEXT PRIMARY KEY, flow_run_id TEXT REFERENCES flow_run(id) ON DELETE CASCADE, name TEXT, task_inputs JSON);
CREATE TABLE task_run_state (id TEXT PRIMARY KEY, task_run_id TEXT NOT NULL REFERENCES task_run(id) ON DELETE CASCADE, message TEXT,
    result_artifact_id TEXT REFERENCES artifact(id) ON DELETE SET NULL);
CREATE TABLE log (id TEXT PRIMARY KEY, task_run_id TEXT, message TEXT);
CREATE TABLE event_resources (resource JSON, event_id TEXT);
CREATE TABLE deployment (id TEXT PRIMARY KEY, parameters JSON);
CREATE TABLE variable (name TEXT UNIQUE, value JSON);
CREATE TABLE novelty (place TEXT, moment INTEGER, payload BLOB, PRIMARY KEY (place, moment)) WITHOUT ROWID;
"""
"""As in Prefect as far as it matters here; the last one is of a version to come."""


def number() -> str:
    return str(uuid.uuid4())


@pytest.fixture
def database(own_machine: Path) -> Iterator[sqlite3.Connection]:
    """A database in a fresh home, open as a running server has it: a run over two scenes, with all that Prefect keeps."""
    home = own_machine / "prefect"
    home.mkdir()
    with contextlib.closing(sqlite3.connect(home / "prefect.db", isolation_level=None, timeout=0)) as connection:
        connection.execute("PRAGMA journal_mode = WAL")
        connection.executescript(TABLES)
        flow, run, other_run = number(), number(), number()

        def add(table: str, *values: Any) -> None:
            connection.execute(f"INSERT INTO {table} VALUES ({', '.join('?' * len(values))})", values)

        add("flow", flow, "replicate")
        add("flow_run", run, flow, "demo -> lake, 2 scenes", json.dumps({"scans": "/scans", "scenes": [HOME, OTHER]}), None)
        add("flow_run", other_run, flow, "demo -> lake, 1 scene", json.dumps({"scans": "/scans", "scenes": []}), None)
        add("flow_run_state", number(), run, f"2 failed:\n{HOME}: captions: {LABEL} is too small\n{OTHER}: no floor")
        for scene in (HOME, OTHER):
            task, artifact = number(), number()
            add("task_run", task, run, f"{scene} captions", json.dumps({"above": []}))
            add("artifact", artifact, "objects", json.dumps([{"label": LABEL if scene == HOME else "desk"}]), task)
            add("task_run_state", number(), task, "Running", artifact)
            add("log", number(), task, f"described {LABEL if scene == HOME else 'desk'}")
            add(
                "event_resources",
                json.dumps({"prefect.resource.id": f"prefect.task-run.{task}", "labels": scene == HOME and LABEL}),
                number(),
            )
            add("novelty", "any", scene == HOME, f"of {scene}: {LABEL if scene == HOME else 'desk'}".encode())
        (first,) = connection.execute("SELECT id FROM task_run WHERE name LIKE ?", (f"{HOME}%",)).fetchone()
        last = number()
        add("task_run", last, run, f"{OTHER} exports", json.dumps({"above": [{"input_type": "task_run", "id": first}]}))
        add("task_run_state", number(), last, f"{HOME} took the slot; {LABEL}", None)
        add("artifact", number(), "run", json.dumps(json.dumps([{"Scene": HOME, "Why": LABEL}, {"Scene": OTHER}])), None)
        add("log", number(), None, f"{HOME}/ with a slash escaped: " + json.dumps(HOME).replace("/", "\\/"))
        add("log", number(), None, "of demo/scene0001_00_b, another scene")
        add("deployment", number(), json.dumps({"scenes": [HOME, OTHER], "workers": 2}))
        for name in ("scene0001_00", "demo_scene0001_00"):
            add("variable", name, json.dumps(1))
        yield connection


def held(connection: sqlite3.Connection, table: str, columns: str = "*") -> list[Any]:
    return connection.execute(f"SELECT {columns} FROM {table} ORDER BY 1").fetchall()


def file_bytes(folder: Path) -> bytes:
    return b"\n".join(path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file())


def test_the_scene_goes_from_every_table_and_others_keep_their_rows(database: sqlite3.Connection, own_machine: Path) -> None:
    home = own_machine / "prefect"
    assert HOME.encode() in file_bytes(home)
    assert {hit.place for hit in search_prefect(TRACES).hits} > {"table task_run", "table novelty", "table deployment", "contents"}
    foreseen = erase_from_prefect(TRACES, dry_run=True)
    assert foreseen.deleted == 10
    assert HOME.encode() in file_bytes(home)
    done = erase_from_prefect(TRACES)
    assert (done.database, done.redacted, done.remains) == (str(home / "prefect.db"), 6, ())
    assert search_prefect(TRACES).hits == ()
    found = file_bytes(home)
    assert (b"scene0001_00" in found.replace(b"scene0001_00_b", b""), LABEL.encode() in found) == (False, False)
    assert [row[0] for row in held(database, "task_run", "name")] == [f"{OTHER} captions", f"{OTHER} exports"]
    assert len(held(database, "task_run_state")) == 2
    assert {row[0] for row in held(database, "log", "message")} == {"described desk", "of demo/scene0001_00_b, another scene"}
    assert [json.loads(row[0]) for row in held(database, "artifact", "data")] == [[{"label": "desk"}]]
    assert held(database, "novelty") == [("any", 0, f"of {OTHER}: desk".encode())]
    assert len(held(database, "event_resources")) == 1
    parameters = [json.loads(row[0])["scenes"] for row in held(database, "flow_run", "parameters")]
    assert sorted(parameters) == [[], ["erased", OTHER]], "an empty list would mean all scenes"
    assert held(database, "flow_run_state", "message") == [(f"2 failed:\nerased\n{OTHER}: no floor",)]
    assert json.loads(held(database, "deployment", "parameters")[0][0]) == {"scenes": ["erased", OTHER], "workers": 2}
    assert [row[0].split("-")[0] for row in held(database, "variable")] == ["erased", "erased"]
    assert database.execute("PRAGMA foreign_key_check").fetchall() == []
    assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    again = erase_from_prefect(TRACES)
    assert (again.deleted, again.redacted, again.files) == (0, 0, 0)


def test_bytes_of_rows_that_were_deleted_before_go_too(database: sqlite3.Connection, own_machine: Path) -> None:
    database.execute("PRAGMA secure_delete = OFF")
    for (table,) in database.execute("SELECT name FROM sqlite_schema WHERE type = 'table'").fetchall():
        database.execute(f"DELETE FROM {table}")
    assert HOME.encode() in file_bytes(own_machine / "prefect")
    assert {hit.place for hit in search_prefect(TRACES).hits} == {"contents"}
    assert erase_from_prefect(TRACES).deleted == 0
    assert search_prefect(TRACES).hits == ()


def test_a_database_in_use_is_one_line_and_stays_as_it_was(
    database: sqlite3.Connection, own_machine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("flows.server.records.WAIT_SECONDS", 0.0)
    before = "\n".join(database.iterdump())
    database.execute("BEGIN IMMEDIATE")
    with pytest.raises(LakeError, match=r"prefect.db: .*locked.*; stop Prefect's server and give the same command again"):
        erase_from_prefect(TRACES)
    database.execute("COMMIT")
    assert "\n".join(database.iterdump()) == before
    assert erase_from_prefect(TRACES).deleted > 0


def test_a_failure_half_way_changes_nothing(database: sqlite3.Connection, own_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = "\n".join(database.iterdump())

    def fail(*arguments: Any) -> int:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(PrefectDatabase, "_redact", fail)
        with pytest.raises(KeyboardInterrupt):
            erase_from_prefect(TRACES)
    assert "\n".join(database.iterdump()) == before


def test_results_and_queues_of_the_home_go_and_other_files_are_found(own_machine: Path) -> None:
    home = own_machine / "prefect"
    packed = base64.b64encode(f"\x80\x05 a pickle of {HOME}".encode()).decode()
    for name, text in {
        "storage/a": json.dumps({"metadata": {}, "result": packed}),
        "storage/b": json.dumps({"result": base64.b64encode(f"a pickle of {OTHER}".encode()).decode()}),
        "dlq/c": f"dropped: {HOME}",
        "server.log": f"about {HOME}",
    }.items():
        (home / name).parent.mkdir(parents=True, exist_ok=True)
        (home / name).write_text(text)
    done = erase_from_prefect(TRACES)
    assert (done.files, done.database) == (2, None)
    assert {path.name for path in home.rglob("*") if path.is_file()} >= {"b", "server.log"}
    assert [Path(hit.path).name for hit in search_prefect(TRACES).hits] == ["server.log"]


@pytest.mark.parametrize(
    ("api", "database_url", "named"),
    [
        ("", "sqlite+aiosqlite:////home/prefect.db", []),
        ("http://127.0.0.1:4200/api", "sqlite+aiosqlite:////home/prefect.db", ["unless it uses", "127.0.0.1:4200/api/task_runs", "psql"]),
        ("http://joe:s3cret@far:4200/api", "sqlite+aiosqlite:////home/prefect.db", ["POST http://far:4200/api/task_runs/filter"]),
        ("http://joe:p/s3cret@[::1]:4200/api?key=s3cret", "sqlite+aiosqlite:////home/prefect.db", ["http://[::1]:4200/api/task_runs/ID"]),
        ("", "postgresql+asyncpg://ann:a/s3cret@db.example/prefect?password=s3cret", ["database prefect on db.example)"]),
        ("https://prefect.example/api", "sqlite+aiosqlite:////home/prefect.db", ["https://prefect.example/api/task_runs/filter", "psql"]),
        ("", "postgresql+asyncpg://ann:s3cret@db.example:5432/prefect", ["db.example", "psql"]),
        ("http://127.0.0.1:4200/api", "postgresql+asyncpg://ann:s3cret@db.example/prefect", ["db.example", "psql"]),
    ],
)
def test_what_this_machine_cannot_reach_is_named(api: str, database_url: str, named: list[str]) -> None:
    lines = "\n".join(remaining_lines(api, database_url, TRACES))
    assert bool(lines) == bool(named)
    assert all(word in lines for word in [*named, *(["scene0001_00"] if named else [])])
    assert "s3cret" not in lines
    assert "joe" not in lines


def test_a_port_of_this_machine_is_trusted_only_if_its_process_has_the_database_open(
    database: sqlite3.Connection, own_machine: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A token file stays when a tunnel or a container takes the port, so that it proves nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        (own_machine / "prefect" / f"metascenes-{port}.token").write_text("token")
        monkeypatch.setenv("PREFECT_API_URL", f"http://127.0.0.1:{port}/api")
        assert erase_from_prefect(TRACES, dry_run=True).remains == ()
        database.close()
        assert erase_from_prefect(TRACES, dry_run=True).remains != ()
    assert erase_from_prefect(TRACES, dry_run=True).remains != ()


def test_rows_and_files_that_hold_only_a_removed_hash_go(database: sqlite3.Connection, own_machine: Path) -> None:
    gone, other = "ab" * 32, "cd" * 32
    database.execute("INSERT INTO log VALUES (?, NULL, ?), (?, NULL, ?)", (number(), f"wrote {gone}", number(), f"wrote {other}"))
    (own_machine / "prefect" / "storage").mkdir()
    (own_machine / "prefect" / "storage" / "result").write_text(gone)
    traces = dataclasses.replace(TRACES, hashes=frozenset([gone]))
    erase_from_prefect(traces)
    assert search_prefect(traces).hits == ()
    assert gone.encode() not in file_bytes(own_machine / "prefect")
    assert (f"wrote {other}",) in held(database, "log", "message")


def test_files_that_vanish_or_have_strange_names_stop_no_search(own_machine: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = own_machine / "prefect"
    strange = Path(os.fsdecode(os.fsencode(home / "storage") + b"/scene0001_00_\xff"))
    for path in (home / "storage" / "brief", home / "locked", strange):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("short")
    real = Path.read_bytes

    def read_bytes(path: Path) -> bytes:
        if path.name == "locked":
            raise PermissionError(path)
        if path.name == "brief":
            path.unlink(missing_ok=True)
        return real(path)

    monkeypatch.setattr(Path, "read_bytes", read_bytes)
    hits = search_prefect(TRACES).hits
    assert {(hit.path, hit.place) for hit in hits} == {
        (str(home / "locked"), "cannot be read"), (f"{home}/storage/scene0001_00_\\xff", "name")
    }  # fmt: skip
    (home / "storage" / "brief").write_text("short")
    assert erase_from_prefect(TRACES).files == 1
    assert not strange.exists()


def test_the_statement_for_postgres_names_every_spelling() -> None:
    statement = postgres_statement(TRACES)
    assert all(name.replace("\\", "\\\\").replace("~", "\\~") in statement for name in TRACES.names)


VALUES = st.recursive(
    st.sampled_from([HOME, f"/scans/{HOME}/color", OTHER, "demo/scene0001_00_b", "a line\nscene0001_00\nanother", ""])
    | st.integers()
    | st.none(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["a", "scene0001_00", OTHER]), inner, max_size=3),
    max_leaves=8,
)


@given(value=VALUES)
def test_a_redacted_value_is_json_still_and_tells_nothing(value: Any) -> None:
    text = json.dumps(value)
    redacted = redacted_text(text, TRACES)
    assert not TRACES.in_text(redacted)
    if isinstance(value, dict | list):
        assert type(json.loads(redacted)) is type(value)
    if not TRACES.in_text(text):
        assert redacted == text or json.loads(redacted) == value


DRIVEN = """
import sys
from flows.server.process import prefect_server
with prefect_server():
    from prefect import flow, task
    from prefect.artifacts import create_table_artifact
    from prefect.logging import get_run_logger

    @task(task_run_name="{name}")
    def capture(name):
        label = "grandmother's wardrobe" if "0001" in name else "desk"
        get_run_logger().info(f"described {label}")
        create_table_artifact([{"Label": label}], key="objects")
        return name

    @flow(name="replicate", flow_run_name="{scenes}", persist_result=True)
    def replicate(scenes):
        return [capture(name) for name in scenes]

    replicate(["demo/scene0001_00", "demo/scene0002_00"])
    print("ready", flush=True)
    sys.stdin.readline()
"""


@pytest.mark.whole
@pytest.mark.parametrize("is_running", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["server runs", "server ended"])
def test_a_real_server_keeps_nothing_of_the_scene(own_machine: Path, is_running: bool) -> None:
    """A run of real Prefect, on the schema of the installed version, with its result, log, artifact and events."""
    home = own_machine / "prefect"
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PREFECT_")} | {
        "PREFECT_HOME": str(home), "PREFECT_LOGGING_TO_API_ENABLED": "true", "PREFECT_LOGGING_TO_API_BATCH_INTERVAL": "0.1",
    }  # fmt: skip
    command = [sys.executable, "-c", DRIVEN]
    process = subprocess.Popen(
        command, cwd=REPOSITORY, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        while line and "ready" not in line:
            line = process.stdout.readline()
        assert line, process.communicate()[1]
        with contextlib.closing(sqlite3.connect(home / "prefect.db")) as connection:
            # The server records task runs from events, which arrive after the flow ended.
            while connection.execute("SELECT count(*) FROM task_run WHERE state_type = 'COMPLETED'").fetchone() != (2,):
                assert process.poll() is None
            # It writes events in batches of its own.
            while connection.execute("SELECT count(*) FROM events WHERE resource LIKE '%scene0001%'").fetchone() == (0,):
                assert process.poll() is None
        if not is_running:
            process.communicate("\n")
        places = {hit.place for hit in search_prefect(TRACES).hits}
        assert places >= {"table task_run", "table flow_run", "table events", "contents"}
        done = erase_from_prefect(TRACES)
        assert done.deleted > 4
        if is_running:
            process.communicate("\n")  # events that were on their way arrive now
            erase_from_prefect(TRACES)
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
    assert search_prefect(TRACES).hits == ()
    assert LABEL.encode() not in file_bytes(home)
    with contextlib.closing(sqlite3.connect(home / "prefect.db")) as connection:
        assert [row[0] for row in held(connection, "task_run", "name")] == [OTHER]
        assert connection.execute("PRAGMA foreign_key_check").fetchall() == []
    assert not any(TRACES.in_text(path.name) for path in home.rglob("*"))


def test_names_of_others_are_spared() -> None:
    assert redacted_text("demo/scene0001_00_b -> lake", TRACES) == "demo/scene0001_00_b -> lake"
    assert redacted_text(f"{HOME} -> lake", TRACES) == "erased"
    assert redacted_text(f"{HOME}: x".encode(), Traces(frozenset([HOME]))) == "erased"


@pytest.mark.whole
def test_the_statement_for_postgres_removes_and_redacts(tmp_path: Path) -> None:
    escaped = json.dumps(f"a line\n{HOME}")
    task, kept_task, artifact = number(), number(), number()
    message = f"2 failed:\n{HOME}: captions: a wardrobe is too small\n{OTHER}: no floor"
    parameters = {"scenes": [HOME, OTHER], "note": f"a\n{HOME} a wardrobe", "none": [], "empty": "", "count": 2}
    with postgres_server(tmp_path) as service:
        service.query(
            "CREATE TABLE task_run (id UUID PRIMARY KEY, name TEXT, inputs JSON); "
            "CREATE TABLE task_run_state (id UUID PRIMARY KEY, task_run_id UUID NOT NULL REFERENCES task_run(id) ON DELETE CASCADE, "
            "message TEXT); CREATE TABLE flow_run (name VARCHAR, parameters JSONB); CREATE TABLE variable (name TEXT UNIQUE, value JSON); "
            "CREATE TABLE log (id UUID, task_run_id UUID, message TEXT); CREATE TABLE artifact (id UUID, task_run_id UUID, data JSON); "
            "CREATE TABLE artifact_collection (latest_id UUID, data JSON); CREATE TABLE event_resources (resource JSONB); "
            f"INSERT INTO task_run VALUES ('{task}', '{HOME} captions', '{{}}'), ('{number()}', 'demo/scene0001_00_b x', '{{}}'), "
            f"('{number()}', '{OTHER}', '[\"{HOME}\"]'), ('{kept_task}', '{OTHER}', '{{\"above\": \"{task}\"}}'), "
            f"('{number()}', '{OTHER}', '{escaped}'); "
            f"INSERT INTO task_run_state VALUES ('{number()}', '{task}', ''), ('{number()}', '{kept_task}', '{message}'); "
            f"INSERT INTO log VALUES ('{number()}', '{task}', 'described a wardrobe'), ('{number()}', '{kept_task}', 'described a desk'); "
            f"INSERT INTO artifact VALUES ('{artifact}', '{task}', '[]'), ('{number()}', '{kept_task}', '[1]'); "
            f"INSERT INTO artifact_collection VALUES ('{artifact}', '[]'), ('{number()}', '[1]'); "
            f'INSERT INTO event_resources VALUES (\'{{"id": "prefect.task-run.{task}"}}\'), '
            f'(\'{{"id": "prefect.task-run.{kept_task}"}}\'); '
            f"INSERT INTO variable VALUES ('scene0001_00', '1'), ('demo_scene0001_00', '{json.dumps(parameters)}'); "
            f"INSERT INTO flow_run VALUES ('both', '{json.dumps(parameters)}')"
        )
        service.query(postgres_statement(TRACES))
        assert service.query("SELECT name FROM task_run ORDER BY 1") == [["demo/scene0001_00_b x"], [OTHER]]
        assert service.query("SELECT message FROM task_run_state") == [[f"2 failed:\nerased\n{OTHER}: no floor"]]
        assert service.query("SELECT message FROM log") == [["described a desk"]]
        for table in ("artifact", "artifact_collection"):
            assert service.query(f"SELECT data FROM {table}") == [["[1]"]], table
        assert service.query("SELECT resource ->> 'id' FROM event_resources") == [[f"prefect.task-run.{kept_task}"]]
        redacted = {**parameters, "scenes": ["erased", OTHER], "note": "a\nerased"}
        assert json.loads(service.query("SELECT parameters FROM flow_run")[0][0]) == redacted
        variables = service.query("SELECT name, value FROM variable ORDER BY length(value::text)")
        assert [name.partition("-")[0] for name, _ in variables] == ["erased", "erased"]
        assert [json.loads(value) for _, value in variables] == [1, redacted]
