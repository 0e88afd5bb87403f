"""The Prefect server that a run on one machine uses, when nobody named one: on loopback, without telemetry, and dead as
soon as the run is, however that ended (Prefect's own ephemeral server outlives a killed parent).

``python -m flows.server <descriptor of a listening socket> <process to follow>`` is that server.
"""

from __future__ import annotations

import contextlib
import os
import re
import socket
import subprocess
import sys
import tempfile
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from schemas.errors import LakeError

START_SECONDS = 120
"""First start on a machine migrates an empty database: 10 s on two idle cores, much more on busy ones."""

DATABASE = "PREFECT_API_DATABASE_CONNECTION_URL"
SHORTEST_SECRET = 4
"""Shorter pieces of a password are part of any text."""

QUIET = {
    "DO_NOT_TRACK": "1",
    "PREFECT_SERVER_ANALYTICS_ENABLED": "false",
    "PREFECT_SERVER_UI_V2_ENABLED": "false",  # its pages ask amplitude.com for a configuration, analytics or not; the older ones ask nobody
    "PREFECT_SERVER_UI_SHOW_PROMOTIONAL_CONTENT": "false",
    "PREFECT_LOGGING_LEVEL": "CRITICAL",
    "PREFECT_LOGGING_ROOT_LEVEL": "CRITICAL",
    "PREFECT_SERVER_LOGGING_LEVEL": "CRITICAL",
    "PREFECT_LOGGING_TO_API_ENABLED": "false",
    "PREFECT_CLI_PROMPT": "false",
}
"""No telemetry; and on the command line the lake's own words instead of Prefect's log. What a user set stays as it is."""

NAMED = {name: value for name, value in QUIET.items() if "LOGGING" not in name} | {"PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL"}
"""The same where the server is somebody's own: it keeps the log of the run, and the command line does not print it."""


@contextlib.contextmanager
def prefect_server() -> Iterator[str]:
    """A Prefect API to talk to: the one that PREFECT_API_URL names, else one of our own for as long as this lasts.

    Must be entered before Prefect is imported. Gives the address.

    Raises:
        LakeError: the server did not start.
    """
    named = os.environ.get("PREFECT_API_URL")
    for name, value in (NAMED if named else QUIET).items():
        os.environ.setdefault(name, value)
    if named:
        yield named
        return
    home = Path(os.environ.get("PREFECT_HOME") or Path.home() / ".prefect")
    home.mkdir(parents=True, exist_ok=True)  # Prefect expects at least the home folder to be there
    # Its words go to a file: a pipe that nobody drains would stop the server once it is full.
    with tempfile.TemporaryFile() as said:
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", 0))
            listener.listen(128)
            port = listener.getsockname()[1]
            process = subprocess.Popen(
                [sys.executable, "-m", "flows.server", str(listener.fileno()), str(os.getpid())],
                pass_fds=[listener.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=said,
                start_new_session=True,  # Ctrl-C is for the run, which still has to tell the server how it ended
            )
        address = f"http://127.0.0.1:{port}/api"
        try:
            _wait_until_healthy(process, address, said)
            os.environ["PREFECT_API_URL"] = address
            yield address
        finally:
            os.environ.pop("PREFECT_API_URL", None)
            process.terminate()
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def is_healthy(address: str) -> bool:
    """Whether the Prefect API at an address (`http://host:port/api`) says that it is well."""
    try:
        with urllib.request.urlopen(f"{address}/health", timeout=2) as reply:
            return bool(reply.status == 200)
    except OSError:
        return False


def _wait_until_healthy(process: subprocess.Popen[bytes], address: str, said: IO[bytes]) -> None:
    """Return once the server answers."""
    give_up = time.monotonic() + START_SECONDS
    while time.monotonic() < give_up:
        if process.poll() is not None:
            said.seek(0)
            reason = _reason(said.read().decode(errors="replace")) or f"exit code {process.returncode}"
            raise LakeError(f"the Prefect server did not start: {without_secrets(reason)}{_database_hint()}")
        if is_healthy(address):
            return
        time.sleep(0.1)
    process.kill()
    raise LakeError(f"the Prefect server did not answer within {START_SECONDS} s; set PREFECT_API_URL to one that runs")


_RAISED = re.compile(r"^[A-Za-z_][\w.]*([Ee]rror|Exception|Timeout)\b.*")


def _reason(said: str) -> str:
    """The line that says why a server ended: its last exception, else its last words."""
    lines = [line.strip() for line in said.strip().splitlines()]
    return next((line for line in reversed(lines) if _RAISED.match(line)), lines[-1] if lines else "")


def _database_hint() -> str:
    return f" (its database is what {DATABASE} names)" if os.environ.get(DATABASE) else ""


def without_secrets(text: str) -> str:
    """A text for people without the credentials of the database that the environment names, in whole or in pieces."""
    credentials = os.environ.get(DATABASE, "").partition("://")[2].rpartition("@")[0]
    password = credentials.partition(":")[2]
    pieces = [urllib.parse.unquote(password), *re.split(r"[:@/]", password)]
    for secret in sorted({credentials, password, *pieces}, key=len, reverse=True):
        if len(secret) >= SHORTEST_SECRET:
            text = text.replace(secret, "***")
    return re.sub(r"(\w://)[^\s@/]*@", r"\1***@", text)


def main(descriptor: int, parent: int) -> None:
    """Serve Prefect's API on a listening socket until `parent` is gone."""
    from flows.child import follow_parent

    follow_parent(parent)
    for name in ("PREFECT_LOGGING_LEVEL", "PREFECT_LOGGING_ROOT_LEVEL", "PREFECT_SERVER_LOGGING_LEVEL"):
        os.environ[name] = "ERROR"  # nobody sees it but `prefect_server`, which looks there for the reason of a failed start
    import uvicorn

    uvicorn.run("prefect.server.api.server:create_app", factory=True, fd=descriptor, log_level="error", timeout_keep_alive=5)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
