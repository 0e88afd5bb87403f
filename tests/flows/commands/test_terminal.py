"""What the command line prints: fit for a terminal whatever files and rows hold, without credentials, and never lost in silence."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest

from flows.cli import COMMANDS, cli, main
from schemas.capture import Scene
from tests.conftest import REPOSITORY
from tests.samples import fingerprint, sample, stage_run
from tests.schemas.test_text import SECRET
from warehouse.lake import Lake

PLACE = f"s3://AKIA55:{SECRET}@bucket/lake"
RED = "\x1b[31mred\u202e\x9b2J\r"

ADDRESSES = {"address", "scans", "target", "source", "folder", "file", "library", "config_file", "asked", "statement", "scene", "release"}
"""Names of parameters that take addresses, or words that errors repeat."""

MAKES = {"demo", "bench"}
"""Commands that read no lake: they only make one."""


def leaves() -> Iterator[tuple[tuple[str, ...], click.Command]]:
    context = click.Context(cli, **cli.context_settings)
    for name in COMMANDS:
        command = cli.get_command(context, name)
        assert command is not None
        if isinstance(command, click.Group):
            yield from (((name, inner), each) for inner, each in command.commands.items())
        else:
            yield (name,), command


CASES = [
    (words, command, parameter.name)
    for words, command in leaves()
    if words[0] not in MAKES
    for parameter in command.params
    if parameter.name in ADDRESSES
]


def call(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["metascenes", *arguments])
        with pytest.raises(SystemExit) as ended:
            main()
    said = capsys.readouterr()
    return int(ended.value.code or 0), said.out + said.err


@pytest.mark.parametrize(("words", "command", "name"), CASES, ids=[f"{' '.join(words)} {name}" for words, _, name in CASES])
@pytest.mark.parametrize("value", [PLACE, RED], ids=["credentials", "escapes"])
def test_no_command_repeats_credentials_or_escapes(
    words: tuple[str, ...], command: click.Command, name: str, value: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [*words]
    for parameter in command.params:
        told = value if parameter.name == name else str(tmp_path / str(parameter.name))
        if isinstance(parameter, click.Argument):
            if parameter.required or parameter.name == name:
                arguments += [told]
        elif parameter.required or parameter.name in (name, "address"):
            arguments += [parameter.opts[0], told]
    if words == ("watch",):
        arguments.append("--once")
    code, said = call(capsys, *arguments)
    assert code in (1, 2), said
    assert "AKIA55" not in said
    assert "wJal" not in said
    assert not {"\x1b", "\u202e", "\x9b", "\r"} & set(said)


@pytest.fixture
def odd_lake(tmp_path: Path) -> str:
    """A lake whose rows hold what commands a terminal."""
    lake = Lake.open(tmp_path / "lake")
    failed = {"outcome": "failed", "error": RED, "error_kind": "input", "reasons": (f"scan={RED}",)}
    lake.stage_rows(stage_run("a/one", "capture", fingerprint(1), **failed), {})
    scene = sample(Scene, scene_id="a/two", mesh_blob=lake.blobs.put(b"mesh", "glb"))
    lake.stage_rows(stage_run("a/two", "capture", fingerprint(2), degradations=(RED,)), {"scenes": [scene]})
    lake.commit()
    return lake.address


@pytest.mark.parametrize(
    "words",
    [
        ("status", "--all"),
        ("status", "--all", "--json"),
        ("scenes", "--json"),
        ("sql", "SELECT error, degradations FROM stage_runs"),
        ("sql", f"SELECT '{RED}' AS \"{RED}\""),
        ("sql", f"SELECT '{RED}' AS \"{RED}\"", "--json"),
        ("sql", f"SELECT '{RED}' AS \"{RED}\"", "--output", "jsonl"),
        ("sql", f"SELECT {RED}"),
        ("explain", "a/one"),
        ("explain", "a/two", "--json"),
        ("doctor", "lake"),
        ("lake", "erase", "a/one", "--dry-run"),
    ],
    ids=lambda words: " ".join(words[:2]).encode("unicode_escape").decode()[:30],
)
def test_what_rows_hold_reaches_no_terminal_raw(words: tuple[str, ...], odd_lake: str) -> None:
    done = shell(*words, "--lake", odd_lake)
    said = (done.stdout + done.stderr).decode()
    assert done.returncode in (0, 1, 2), said
    assert not {"\x1b", "\u202e", "\x9b", "\r"} & set(said)
    if words[0] != "doctor" and "--dry-run" not in words and done.returncode != 2:
        assert "\\u001b" in said
    if "--json" in words:
        assert "\x1b" in json.dumps(json.loads(done.stdout), ensure_ascii=False).encode().decode("unicode_escape")


@pytest.mark.whole
def test_csv_is_exact_in_a_pipe_and_escaped_on_a_terminal(odd_lake: str) -> None:
    words = ("sql", "SELECT error FROM stage_runs WHERE error IS NOT NULL", "--output", "csv", "--lake", odd_lake)
    piped = shell(*words)
    assert RED.encode() in piped.stdout
    ours, theirs = pty.openpty()
    try:
        done = shell(*words, stdout=theirs, stderr=subprocess.PIPE, capture_output=False)
        assert done.returncode == 0, done.stderr
        seen = os.read(ours, 65536).decode()
    finally:
        os.close(ours)
        os.close(theirs)
    assert "\x1b" not in seen
    assert "\\u001b[31mred\\u202e" in seen


WAYS = {"no room": ("no space left", lambda: os.open("/dev/full", os.O_WRONLY)), "closed": ("bad file descriptor", lambda: None)}


@pytest.mark.slow
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize(
    "words", [("--help",), ("status", "--help"), ("status",), ("sql", "SELECT 1"), ("sql", "SELECT 1", "--output", "csv")]
)
@pytest.mark.parametrize("unbuffered", ["", pytest.param("1", marks=pytest.mark.whole)])
def test_an_answer_that_cannot_be_written_is_not_lost_in_silence(way: str, words: tuple[str, ...], unbuffered: str, odd_lake: str) -> None:
    reason, place = WAYS[way]
    descriptor = place()
    arguments = [*words, *(() if "--help" in words else ("--lake", odd_lake))]
    done = shell(
        *arguments, stdout=descriptor, stderr=subprocess.PIPE, capture_output=False, env={**os.environ, "PYTHONUNBUFFERED": unbuffered},
        preexec_fn=(lambda: os.close(1)) if descriptor is None else None,
    )  # fmt: skip
    if descriptor is not None:
        os.close(descriptor)
    lines = done.stderr.decode().splitlines()
    assert done.returncode == 2, lines
    assert len(lines) == 1, lines
    assert lines[0].lower().startswith(f"metascenes: standard output: cannot be written ({reason}")


def test_a_command_without_standard_streams_writes_into_no_file_of_its_own(odd_lake: str, tmp_path: Path) -> None:
    out = tmp_path / "answer.csv"
    words = ["sql", "SELECT 1 AS a", "--out", str(out), "--lake", odd_lake]
    command = [sys.executable, "-m", "flows.cli", *words]
    assert subprocess.run(command, cwd=REPOSITORY, preexec_fn=lambda: os.closerange(0, 3)).returncode == 0
    assert out.read_text() == "a\n1\n"


def test_a_reader_that_goes_away_ends_the_command_quietly(odd_lake: str) -> None:
    ours, theirs = os.pipe()
    os.close(ours)
    done = shell(
        "sql",
        "SELECT * FROM range(100000)",
        "--output",
        "csv",
        "--lake",
        odd_lake,
        stdout=theirs,
        stderr=subprocess.PIPE,
        capture_output=False,
    )
    os.close(theirs)
    assert (done.returncode, done.stderr) == (141, b"")


def shell(*arguments: str, **named: Any) -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-m", "flows.cli", *arguments]
    return subprocess.run(command, cwd=REPOSITORY, **{"capture_output": True, **named})
