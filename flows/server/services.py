"""A Prefect server and a worker on this machine, for somebody who has none: both end with the process that started them,
however that ended, and so does all that they started.

``python -m flows.server.services <descriptor> <seconds> <command ...>`` is the guard below which each of them runs.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence

from flows.server.access import SERVER_TOKEN
from flows.server.process import QUIET, START_SECONDS, is_healthy
from schemas.errors import InputError, LakeError

NO_TELEMETRY = {name: value for name, value in QUIET.items() if "LOGGING" not in name}

SERVER = {
    **NO_TELEMETRY,
    # In memory, which is the default, leases are forgotten with the server, and their slots stay taken for ever.
    "PREFECT_SERVER_CONCURRENCY_LEASE_STORAGE": "prefect.server.concurrency.lease_storage.filesystem",
    # Half a minute by default, for which a free GPU would wait.
    "PREFECT_SERVER_CONCURRENCY_MAXIMUM_CONCURRENCY_SLOT_WAIT_SECONDS": "5",
    "PREFECT_SERVER_LOGGING_LEVEL": "WARNING",
}
"""What a server of ours is told, where the environment does not say otherwise."""

GRACE_SECONDS = 15.0
"""How long a service may take to end by itself: a run's process commits what it has."""

LOOK_SECONDS = 0.2
"""How often a guard looks whether its service, and whoever started it, is still there."""

_SUBREAPER = 36
"""PR_SET_CHILD_SUBREAPER of prctl(2): orphans below the guard stay below it."""


@contextlib.contextmanager
def server(token: str, host: str = "127.0.0.1", port: int = 4200) -> Iterator[tuple[str, subprocess.Popen[bytes]]]:
    """A Prefect server with its UI, on the database that the environment names, else on SQLite in PREFECT_HOME.

    Whoever asks it must show the token. Gives the address of its API, and its process.

    Raises:
        InputError: something else listens there.
        LakeError: it did not start.
    """
    import socket

    near = "127.0.0.1" if host == "0.0.0.0" else host
    address = f"http://{near}:{port}/api"
    with socket.socket() as probe:
        if probe.connect_ex((near, port)) == 0:
            raise InputError(f"{host}:{port}", "--port", "something listens there already", "give another port, or stop it")
    command = [sys.executable, "-m", "flows.server", "--host", host, "--port", str(port)]
    with guarded(command, {**SERVER, **os.environ, "PREFECT_API_URL": address, SERVER_TOKEN: token}, quiet=True) as process:
        give_up = time.monotonic() + START_SECONDS
        while not is_healthy(address):
            if process.poll() is not None:
                raise LakeError("the Prefect server did not start; its last words are above")
            if time.monotonic() > give_up:
                raise LakeError(f"the Prefect server did not answer within {START_SECONDS} s")
            time.sleep(LOOK_SECONDS)
        yield address, process


@contextlib.contextmanager
def worker(pool: str, api: str) -> Iterator[subprocess.Popen[bytes]]:
    """A worker of a process work pool; its runs have this process's environment, with the token in it."""
    command = [sys.executable, "-m", "prefect", "worker", "start", "--pool", pool, "--type", "process"]
    with guarded(command, {**NO_TELEMETRY, **os.environ, "PREFECT_API_URL": api}) as process:
        yield process


def first_to_end(services: Mapping[str, subprocess.Popen[bytes]]) -> str:
    """Wait until one of these processes ends; its name."""
    while True:
        for name, process in services.items():
            if process.poll() is not None:
                return name
        time.sleep(LOOK_SECONDS)


@contextlib.contextmanager
def guarded(command: Sequence[str], environment: Mapping[str, str], quiet: bool = False) -> Iterator[subprocess.Popen[bytes]]:
    """A command below a guard, for as long as this lasts. `quiet` drops what it prints, not what it complains of."""
    theirs, lifeline = os.pipe()
    try:
        process = subprocess.Popen(
            [sys.executable, "-m", "flows.server.services", str(theirs), str(GRACE_SECONDS), *command],
            env=dict(environment), pass_fds=[theirs],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL if quiet else sys.stderr, start_new_session=True,
        )  # fmt: skip
    except BaseException:
        os.close(lifeline)
        raise
    finally:
        os.close(theirs)
    try:
        yield process
    finally:
        os.close(lifeline)
        process.wait()


def guard(lifeline: int, grace: float, command: Sequence[str]) -> int:
    """Run a command until it ends, or until nobody holds the other end of the pipe any more; then end all below it."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_SUBREAPER, 1, 0, 0, 0)
    for polite in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(polite, lambda *_: sys.exit(1))
    process = subprocess.Popen(command)
    try:
        while process.poll() is None and not select.select([lifeline], [], [], LOOK_SECONDS)[0]:
            pass
        return process.poll() or 0
    finally:
        if process.poll() is None:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(grace)
        _end_descendants()


def _end_descendants() -> None:
    """SIGKILL to all that is left below this process, until nothing is: what runs there may be killed at any moment."""
    import psutil

    while True:
        living = [child for child in psutil.Process().children(recursive=True) if child.status() != psutil.STATUS_ZOMBIE]
        if not living:
            return
        for child in living:
            with contextlib.suppress(psutil.NoSuchProcess):
                child.kill()
        time.sleep(0.02)


if __name__ == "__main__":
    sys.exit(guard(int(sys.argv[1]), float(sys.argv[2]), sys.argv[3:]))
