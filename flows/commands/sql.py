"""`metascenes sql`: questions to the lake."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import click

from flows.commands.options import chosen_snapshot, existing_lake, lake_option, snapshot_options

if TYPE_CHECKING:
    from warehouse.questions.answers import Output

_FORMS: dict[str, Output] = {".csv": "csv", ".json": "json", ".jsonl": "jsonl", ".ndjson": "jsonl", ".parquet": "parquet", ".txt": "table"}
"""Forms of an answer by the ending of the file that takes it."""

_TABLE_ROWS = 1000
"""Rows that a terminal shows where nobody says how many."""

_GRACE = 10.0  # s; DuckDB looks up from its work at least that often, unless a single value takes it longer

_SLACK = 2**30  # B; threads and allocators reserve more addresses than they use


@click.command("sql", short_help="Ask the lake a question in SQL; reads only.")
@click.argument("statement", required=False)
@click.option("--file", "source", type=click.Path(dir_okay=False), help="Read the statement from a file; - is standard input.")
@click.option(
    "--output",
    type=click.Choice(["table", "csv", "json", "jsonl", "parquet"]),
    help="Form of the answer; by default what the ending of --out says, else a table.",
)
@click.option("--out", type=click.Path(path_type=Path), help="Write the answer into a file, whole or not at all.")
@click.option("--force", is_flag=True, help="Let --out replace a file.")
@click.option("--limit", type=click.IntRange(0), help="Rows that a table shows; 0 shows all.  [default: 1000; in a file all]")
@click.option("--timeout", type=click.FloatRange(0), default=600, show_default=True, help="Seconds until it is ended; 0 waits for ever.")
@click.option("--memory", type=click.FloatRange(0.5), default=3, show_default=True, help="GB that it may use.")
@click.option("--json", "as_json", is_flag=True, help="The same as --output json; --list gives JSON, too.")
@click.option("--list", "listing", is_flag=True, help="List tables, views and macros with versions and what they answer.")
@snapshot_options
@lake_option
def command(
    statement: str | None,
    source: str | None,
    output: Output | None,
    out: Path | None,
    force: bool,
    limit: int | None,
    timeout: float,
    memory: float,
    as_json: bool,
    listing: bool,
    snapshot_id: int | None,
    release: str | None,
    address: str,
) -> None:
    """Ask the lake a question in SQL. Only statements that read are let through. A STATEMENT of - is read from standard input.

    Example: metascenes sql "SELECT category, count(*) FROM instances WHERE NOT is_structure GROUP BY ALL"

    Example: metascenes sql "FROM instances" --out instances.parquet
    """
    from flows.terminal import output as terminal_output
    from warehouse.questions.answers import write_answer
    from warehouse.questions.sql import ask

    if as_json and output not in (None, "json"):
        raise click.UsageError(f"--json contradicts --output {output}")
    output = "json" if as_json else output
    if listing:
        _list(output)
        return
    text = _statement(statement, source)
    form = output or (_form_of(out) if out and not out.is_dir() else "table")
    most = limit if limit is not None else 0 if out else _TABLE_ROWS
    if form == "parquet" and out is None and sys.stdout.isatty():
        raise click.UsageError("Parquet is not for a terminal: name a file with --out")
    lake = existing_lake(address)
    reader = lake.snapshot(chosen_snapshot(lake, snapshot_id, release))
    # Deep inside of one value DuckDB neither counts its memory nor looks at the clock, so the process has bounds of its own.
    with contextlib.ExitStack() as stack:
        sink = stack.enter_context(_whole_file(out, force, lake.storage.local_path(""))) if out else terminal_output()
        stack.enter_context(_ended_after(timeout + _GRACE if timeout else None, timeout))
        stack.enter_context(_bounded_memory(int(memory * 2**30)))
        answer = stack.enter_context(ask(reader, text, timeout=timeout or None, memory_mb=int(memory * 700)))
        rows = write_answer(answer, form, sink, most or None)
        sink.flush()
    if out is not None:
        shown = f"the first {most} of " if form == "table" and 0 < most < rows else ""
        click.echo(f"{out}: {shown}{rows} row{'' if rows == 1 else 's'}", err=True)


def _form_of(out: Path) -> Output:
    """What the ending of a file says."""
    from schemas.errors import InputError

    form = _FORMS.get(out.suffix.lower())
    if form is None:
        raise InputError(str(out), "--out", "has no ending that says what form to write", f"use one of {', '.join(_FORMS)}, or --output")
    return form


def _list(output: Output | None) -> None:
    """Every name that a statement can use."""
    from warehouse.questions.catalog import entries

    if output == "json":
        print(json.dumps([dataclasses.asdict(entry) for entry in entries()], indent=2, ensure_ascii=False))
        return
    width = max(len(entry.signature) for entry in entries())
    for entry in entries():
        version = f"v{entry.version}" if entry.version is not None else ""
        print(f"{entry.kind:<5}  {entry.signature:<{width}}  {version:<3}  {entry.text}")


def _statement(statement: str | None, source: str | None) -> str:
    """The statement, from wherever it is."""
    from schemas.budget import BUDGET
    from schemas.errors import InputError
    from schemas.files import read_file

    if (statement is None) == (source is None):
        raise click.UsageError('give a statement, --file or --list. Example: metascenes sql "SELECT * FROM scenes"')
    if statement is not None and statement != "-":
        return statement
    place = source or "-"
    try:
        data = sys.stdin.buffer.read() if place == "-" else read_file(Path(place), place, BUDGET.statement_bytes, "give a file with SQL")
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(place, "", "this is no UTF-8 text", "give a file with SQL") from error


@contextlib.contextmanager
def _whole_file(path: Path, force: bool, lake: Path | None) -> Iterator[BinaryIO]:
    """A file that gets its name when all of it is written; nothing stays of one that is not.

    Raises:
        InputError: it is there already, lies in the lake, or cannot be made.
    """
    from schemas.errors import InputError

    target = Path(os.path.realpath(path))
    if lake is not None and target.is_relative_to(os.path.realpath(lake)):
        raise InputError(str(path), "--out", "lies in the lake, which only its own commands write to", "choose another folder")
    taken = InputError(str(path), "--out", "is there already", "choose another name, or --force")
    if target.is_dir() or (target.exists() and not force):
        raise taken
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    _leftovers.add(temporary)
    try:
        try:
            handle = open(temporary, "xb")  # noqa: SIM115  # closed below: only what goes wrong here is the folder's fault
        except OSError as error:
            raise InputError(str(path), "--out", f"cannot be made ({error.strerror or error})", "choose another folder") from error
        with handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        if force:
            os.replace(temporary, target)
            return
        try:
            os.link(temporary, target)  # fails when another one was faster
        except FileExistsError:
            raise taken from None
        except OSError:  # no hard links on this file system
            os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)
        _leftovers.discard(temporary)


_leftovers: set[Path] = set()


@contextlib.contextmanager
def _ended_after(seconds: float | None, timeout: float) -> Iterator[None]:
    """End the process after so many seconds, for what cannot be interrupted."""

    def end() -> None:
        for path in _leftovers:
            path.unlink(missing_ok=True)
        print(f"metascenes: SQL: it takes longer than {timeout:g} s; ask for less, or give it more time", file=sys.stderr, flush=True)
        os._exit(2)

    timer = threading.Timer(seconds, end) if seconds else None
    if timer:
        timer.daemon = True
        timer.start()
    try:
        yield
    finally:
        if timer:
            timer.cancel()
            timer.join()


@contextlib.contextmanager
def _bounded_memory(size: int) -> Iterator[None]:
    """Let the process grow by `size` bytes at most; what would take more fails. Only where the system can say and bound it."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (ImportError, OSError):
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = pages * resource.getpagesize() + size + _SLACK
    limits = [limit for limit in (most, soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
