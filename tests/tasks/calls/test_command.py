"""Programs of others end with whoever wanted them."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tasks.calls.command import CommandFailed, run_apart, run_command


def is_alive(pid: int) -> bool:
    stat = Path(f"/proc/{pid}/stat")
    return stat.exists() and stat.read_text().rpartition(")")[2].split()[0] not in "ZX"


@pytest.mark.skipif(not Path("/proc/self").exists(), reason="only Linux tells a program that its parent died")
def test_a_program_ends_with_the_process_that_wanted_it(tmp_path: Path) -> None:
    mark = tmp_path / "pid"
    program = f"import os, pathlib, time; pathlib.Path({str(mark)!r}).write_text(str(os.getpid())); time.sleep(3600)"
    run = f"run_apart([{sys.executable!r}, '-c', {program!r}], Path({str(tmp_path)!r}), 3600)"
    wants = f"from pathlib import Path; from tasks.calls.command import run_apart; {run}"
    parent = subprocess.Popen([sys.executable, "-c", wants])
    while not mark.exists() or not mark.read_text():
        assert parent.poll() is None
        time.sleep(0.01)
    pid = int(mark.read_text())
    assert is_alive(pid)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    while is_alive(pid):
        time.sleep(0.01)


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
