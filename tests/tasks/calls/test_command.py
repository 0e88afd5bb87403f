"""Programs of others end with whoever wanted them, and take values for values."""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import click
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tasks.calls.command import CommandFailed, filled, run_apart, run_command
from tests.conftest import REPOSITORY

GRANDCHILDREN = {
    "below it": "",
    "in a session of its own": "start_new_session=True",
    "in a process group of its own": "process_group=0",
}

WANTS = {
    "a program": "from tasks.calls.command import run_apart; run_apart([sys.argv[1]], folder, 3600.0)",
    "Newton": "from tasks.optimization.engines import newton_engine as n; "
    "n._run(n.Newton(python=sys.argv[1]), folder / 'scene.npz', folder / 'settled.npz')",
    "the reader of foreign models": "from tasks.library import confinement as c; c.CODE = folder.joinpath('code').read_text(); "
    "folder.joinpath('a.usda').touch(); c.confined('read', folder / 'a.usda', folder, 'a.usda')",
}
"""Code that wants a program, run in a process that is killed."""


def hanging(folder: Path, grandchild: str = "") -> str:
    """Code of a program that hangs as what it began does; each has a pipe open for as long as it lives."""
    os.mkfifo(folder / "lives")
    begun = "import time; print('begun', flush=True); time.sleep(3600)"
    return (
        f"import subprocess, sys, time; lives = open({str(folder / 'lives')!r}, 'w'); "
        f"subprocess.Popen([sys.executable, '-c', {begun!r}], stdout=lives{grandchild and f', {grandchild}'}); "
        "time.sleep(3600)"
    )


def program_of(folder: Path, code: str) -> Path:
    """An executable file of Python code."""
    program = folder / "program"
    program.write_text(f"#!{sys.executable}\n{code}\n")
    program.chmod(0o755)
    return program


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux knows what a program began in another session")
@pytest.mark.parametrize("grandchild", GRANDCHILDREN.values(), ids=list(GRANDCHILDREN))
@pytest.mark.parametrize("wants", WANTS.values(), ids=list(WANTS))
def test_a_program_ends_with_the_process_that_wanted_it(tmp_path: Path, wants: str, grandchild: str) -> None:
    """With all that it began."""
    code = hanging(tmp_path, grandchild)
    (tmp_path / "code").write_text(code)
    program = program_of(tmp_path, code)
    begin = f"import sys; from pathlib import Path; folder = Path({str(tmp_path)!r}); {wants}"
    parent = subprocess.Popen([sys.executable, "-c", begin, str(program)], cwd=REPOSITORY)
    with (tmp_path / "lives").open() as lives:
        assert lives.readline() == "begun\n"
        assert parent.poll() is None
        parent.send_signal(signal.SIGKILL)
        parent.wait()
        assert lives.read() == ""  # returns when no process has it open


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux knows what a program began in another session")
@pytest.mark.parametrize("grandchild", GRANDCHILDREN.values(), ids=list(GRANDCHILDREN))
@pytest.mark.parametrize("is_ended_well", [True, False])
def test_what_a_program_began_ends_with_it(tmp_path: Path, grandchild: str, is_ended_well: bool) -> None:
    code = hanging(tmp_path, grandchild)
    code = code.replace("time.sleep(3600)", "lives.write('ended'); lives.close()") if is_ended_well else code
    reader = os.open(tmp_path / "lives", os.O_RDONLY | os.O_NONBLOCK)
    ending = run_apart([str(program_of(tmp_path, code))], tmp_path, 600.0 if is_ended_well else 3.0)
    assert ending.code == (0 if is_ended_well else None)
    os.set_blocking(reader, True)
    with open(reader) as lives:
        assert set(lives.read().split()) <= {"begun", "ended", "endedbegun"}


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV, signal.SIGXCPU, signal.SIGINT])
def test_a_signal_that_ends_a_program_is_told(tmp_path: Path, number: signal.Signals) -> None:
    ending = run_apart(["/bin/sh", "-c", f"kill -{int(number)} $$"], tmp_path, 600.0)
    assert (ending.code, ending.problem) == (-number, f"was ended by signal {int(number)}: it did not say why")


def test_words_and_exit_codes_go_through(tmp_path: Path) -> None:
    said = "import sys; open('words', 'w').write(repr(sys.argv[1:])); print('broken', file=sys.stderr); sys.exit(7)"
    words = ["-c", "--flag", "a b", "{out}", "$HOME"]
    ending = run_apart([sys.executable, "-c", said, *words], tmp_path, 600.0)
    assert (tmp_path / "words").read_text() == repr(words)
    assert (ending.code, ending.last, ending.problem) == (7, "broken", "ended with code 7: broken")
    with pytest.raises(CommandFailed, match="ended with code 7: broken"):
        run_command([sys.executable, "-c", said], tmp_path, 600.0)
    with pytest.raises(CommandFailed, match="cannot be started: there is no such program"):
        run_command([str(tmp_path / "nothing")], tmp_path, 600.0)
    (tmp_path / "text").write_text("no program")
    (tmp_path / "text").chmod(0o755)
    with pytest.raises(CommandFailed, match="cannot be started: Exec format error"):
        run_command([str(tmp_path / "text")], tmp_path, 600.0)


def test_no_file_stays_open_without_a_temporary_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "nothing"))
    open_files = set(os.listdir("/dev/fd"))
    with pytest.raises(FileNotFoundError):
        run_apart([sys.executable, "-c", ""], tmp_path, 600.0)
    assert set(os.listdir("/dev/fd")) <= open_files


OPTION_LIKE = ("--out=/etc/passwd", "-o/etc/passwd", "-", "--", "---", "-1", "--help", "-\n", "--out")


@pytest.mark.parametrize("value", OPTION_LIKE)
@pytest.mark.parametrize("word", ["{prompt}", "{prompt}{empty}", "{empty}{prompt}", "{prompt}-x"])
def test_a_value_is_no_option(value: str, word: str) -> None:
    (text,) = filled([word], {"prompt": value, "empty": ""})
    assert text.strip().startswith(value.strip())
    parser = argparse.ArgumentParser(exit_on_error=False)
    parser.add_argument("prompt")
    parser.add_argument("-o", "--out")
    assert vars(parser.parse_args([text])) == {"prompt": text, "out": None}
    seen = []
    command = click.Command(
        "paint", params=[click.Argument(["prompt"]), click.Option(["-o", "--out"])], callback=lambda **all: seen.append(all)
    )
    command.main([text], standalone_mode=False)
    assert seen == [{"prompt": text, "out": None}]


@given(st.text())
def test_values_are_filled_in_as_they_are(value: str) -> None:
    """But for the space that keeps them from being options."""
    values = {"prompt": value, "seed": "7"}
    (whole, within, fixed) = filled(["{prompt}", "--prompt={prompt}", "--seed"], values)
    assert whole in (value, f" {value}")
    assert not whole.startswith("-")
    assert (within, fixed) == (f"--prompt={value}", "--seed")
