"""Run a program until it ends or its wanter does; then end all that it started.

Run by `tasks.calls.command`: `python -I -S guard.py <descriptor> <program> <words ...>`. The descriptor is one end of a pipe;
the process that wants the program holds the other end for as long as it lives.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import select
import signal
import sys
from typing import NoReturn

_PARENT_DEATH_SIGNAL, _SUBREAPER = 1, 36
"""Of prctl(2): a child ends with its parent, and orphans below this process stay below it."""

NOT_STARTED = 127
"""Exit code for a program that the system does not start, as in a shell."""

NOT_STARTED_LINE = "the guard cannot start the program: error "
"""Line on standard error for such a program, before the number of the error."""


def main() -> NoReturn:
    """Run the program, and end as it ended."""
    lifeline, words = int(sys.argv[1]), sys.argv[2:]
    os.set_inheritable(lifeline, False)
    _ask_kernel(_SUBREAPER, 1)
    ended, wake = os.pipe()
    os.set_blocking(ended, False)
    os.set_blocking(wake, False)
    # The signal writes to the pipe, so that one wait covers both the program's end and the wanter's.
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    child = os.fork()
    if child == 0:
        _become(words)
    status = None
    while status is None:
        if lifeline in select.select([lifeline, ended], [], [])[0]:
            break
        with contextlib.suppress(BlockingIOError):
            os.read(ended, 4096)
        status = _reap(child)
    _end_all(child)
    _end_as(status)


def _become(words: list[str]) -> NoReturn:
    """Turn this process into the program, in a session of its own."""
    guard = os.getppid()
    os.setsid()
    _ask_kernel(_PARENT_DEATH_SIGNAL, int(signal.SIGKILL))
    if os.getppid() != guard:
        os._exit(1)
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    try:
        os.execvp(words[0], words)
    except OSError as error:
        os.write(2, f"{NOT_STARTED_LINE}{error.errno}\n".encode())
    os._exit(NOT_STARTED)


def _reap(child: int) -> int | None:
    """Take up ended processes below this one; the status of the program if it is among them."""
    program_status = None
    with contextlib.suppress(ChildProcessError):
        while True:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                return program_status
            if pid == child:
                program_status = status
    return program_status


def _end_all(child: int) -> None:
    """Kill all processes below this one until none is left; those of other users stay."""
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)
    while True:
        refused = 0
        children = _children()
        for pid in children:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                pass
            except PermissionError:
                refused += 1
        if refused == len(children):
            return
        try:
            # Its own children are now this process's: look again.
            os.waitpid(-1, 0)
        except ChildProcessError:
            return


def _children() -> list[int]:
    """Process ids directly below this process; without /proc none is known."""
    own_pid, pids = str(os.getpid()), list[int]()
    try:
        names = os.listdir("/proc")
    except OSError:
        return []
    for name in filter(str.isdecimal, names):
        with contextlib.suppress(OSError), open(f"/proc/{name}/stat", "rb") as file:
            if file.read().rpartition(b")")[2].split()[1].decode() == own_pid:
                pids.append(int(name))
    return pids


def _end_as(status: int | None) -> NoReturn:
    """End with the program's exit code, or by the signal that ended it."""
    if status is None:
        os._exit(1)
    code = os.waitstatus_to_exitcode(status)
    if code >= 0:
        os._exit(code)
    import resource

    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if -code not in (signal.SIGKILL, signal.SIGSTOP):
        signal.signal(-code, signal.SIG_DFL)
    os.kill(os.getpid(), -code)
    os._exit(1)


def _ask_kernel(option: int, value: int) -> None:
    """Call prctl(2) where the system has it: Linux."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


if __name__ == "__main__":
    main()
