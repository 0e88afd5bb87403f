"""Prefect servers of ours, and how they are reached.

A run on one machine uses its own, when nobody named one: on loopback, without telemetry, and dead as soon as the run is,
however that ended (Prefect's own ephemeral server outlives a killed parent).

``python -m flows.server --port 4200`` is `prefect server start` behind a door: it wants a token in its environment
(`PREFECT_SERVER_API_AUTH_STRING`), goes by its own names only, and is asked by its own pages only (`flows.server.access`).
"""

from __future__ import annotations

import argparse
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
from collections.abc import Callable, Iterator
from typing import IO

from flows.server.access import (
    CLIENT_TOKEN,
    ORIGINS,
    SERVER_TOKEN,
    Doorkeeper,
    TokenWatch,
    close_home,
    new_token,
    own_origins,
    prefect_home,
    take_token,
)
from schemas.errors import InputError, LakeError
from schemas.machine.loopback import bypass_proxies

START_SECONDS = 120
"""The first start of an installation migrates an empty database: 10 s on two idle cores, much more on busy ones."""

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

OF_A_RUN = {"PREFECT_SERVER_REGISTER_BLOCKS_ON_START": "false"}
"""Settings of the server of one run: 54 types of blocks are registered by servers that stay, which people ask for them."""

NAMED = {name: value for name, value in QUIET.items() if "LOGGING" not in name} | {"PREFECT_LOGGING_HANDLERS_CONSOLE_LEVEL": "CRITICAL"}
"""The same where the server is somebody's own: it keeps the log of the run, and the command line does not print it."""


@contextlib.contextmanager
def prefect_server(meanwhile: Callable[[], object] = lambda: None) -> Iterator[str]:
    """A Prefect API to talk to: the one that PREFECT_API_URL names, else one of our own for as long as this lasts.

    Must be entered before Prefect is imported, which `meanwhile` may do: it is called once while a server of our own starts, when its
    address is known already. Gives the address.

    Raises:
        LakeError: the server did not start, or the one that is named does not answer as one, refuses our token, or leaves what
            this lasts for without an answer.
    """
    bypass_proxies()
    named = os.environ.get("PREFECT_API_URL")
    for name, value in (NAMED if named else QUIET).items():
        os.environ.setdefault(name, value)
    if named:
        take_token(named)
        check_server(named)
        try:
            yield named
        except Exception as error:
            if is_of_server(error):
                raise LakeError(why_not(named, error)) from error
            raise
        return
    prefect_home().mkdir(parents=True, exist_ok=True, mode=0o700)  # Prefect expects at least the home folder to be there
    token, before = new_token(), os.environ.get(CLIENT_TOKEN)
    # Its words go to a file: a pipe that nobody drains would stop the server once it is full.
    with tempfile.TemporaryFile() as log:
        with socket.socket() as listener:
            listener.bind(("127.0.0.1", 0))
            listener.listen(128)
            port = listener.getsockname()[1]
            process = subprocess.Popen(
                [sys.executable, "-m", "flows.server", "--socket", str(listener.fileno()), "--follow", str(os.getpid())],
                env={**OF_A_RUN, **os.environ, SERVER_TOKEN: token},
                pass_fds=[listener.fileno()],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=log,
                start_new_session=True,  # Ctrl-C is for the run, which still has to tell the server how it ended
            )
        address = f"http://127.0.0.1:{port}/api"
        try:
            os.environ |= {"PREFECT_API_URL": address, CLIENT_TOKEN: token}
            meanwhile()
            _wait_until_healthy(process, address, log)
            yield address
        finally:
            for name in ("PREFECT_API_URL", CLIENT_TOKEN):
                os.environ.pop(name, None)
            if before is not None:
                os.environ[CLIENT_TOKEN] = before
            process.terminate()
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def is_healthy(address: str) -> bool:
    """Whether the Prefect API at an address (`http://host:port/api`) says that it is well."""
    try:
        # The servers that are waited for are of this machine: no proxy stands before them.
        direct = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with direct.open(f"{address}/health", timeout=2) as reply:
            return bool(reply.status == 200)
    except OSError:
        return False


def _wait_until_healthy(process: subprocess.Popen[bytes], address: str, log: IO[bytes]) -> None:
    """Return once the server answers."""
    give_up = time.monotonic() + START_SECONDS
    while time.monotonic() < give_up:
        if process.poll() is not None:
            log.seek(0)
            reason = _reason(log.read().decode(errors="replace")) or f"exit code {process.returncode}"
            raise LakeError(f"the Prefect server did not start: {without_secrets(reason)}{_database_hint()}")
        if is_healthy(address):
            return
        time.sleep(0.1)
    process.kill()
    raise LakeError(f"the Prefect server did not answer within {START_SECONDS} s; set PREFECT_API_URL to one that runs")


_RAISED = re.compile(r"^[A-Za-z_][\w.]*([Ee]rror|Exception|Timeout)\b.*")


def _reason(text: str) -> str:
    """The line that says why a server ended: its last exception, else its last words."""
    lines = [line.strip() for line in text.strip().splitlines()]
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


def check_server(address: str) -> None:
    """Ask the named server for its version, as Prefect's client asks everything.

    Raises:
        LakeError: nobody answers, or somebody else does, or our token is refused.
    """
    from prefect.client.orchestration import get_client
    from prefect.settings import PREFECT_CLIENT_MAX_RETRIES, temporary_settings

    try:
        with temporary_settings({PREFECT_CLIENT_MAX_RETRIES: 0}), get_client(sync_client=True, httpx_settings={"timeout": 60}) as client:
            version = client.api_version()
        if not re.match(r"\d+\.", version):
            raise ValueError(version)
    except Exception as error:
        raise LakeError(why_not(address, error)) from error


def is_of_server(error: BaseException | None) -> bool:
    """Whether an error is what a Prefect server had to say instead of an answer, and nothing of ours.

    Prefect's client raises whatever comes of reading an answer that is none.
    """
    import traceback

    if error is None:
        return False
    modules = {frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)}
    return any(name.startswith(("httpx", "prefect.client.")) for name in modules) or is_of_server(error.__cause__)


def why_not(address: str, error: BaseException) -> str:
    """A line on what a Prefect server at an address had to say instead of an answer."""
    import httpx

    from flows.run.patience import is_away

    shown = without_secrets(address)
    status = error.response.status_code if isinstance(error, httpx.HTTPStatusError) else 0
    if status in (401, 403):
        return f"{shown}: the Prefect server refuses us ({status}); {CLIENT_TOKEN} must hold its {SERVER_TOKEN}"
    if status and status != 404 and not is_away(error):
        return f"{shown}: the Prefect server refused ({status}): {without_secrets(' '.join(error.response.text.split())[:300])}"  # type: ignore[attr-defined]
    if is_away(error):
        return f"{shown}: no Prefect server answers; check PREFECT_API_URL, or start it"
    return f"{shown}: what answers there is no Prefect server ({type(error).__name__}); check PREFECT_API_URL, which ends with /api"


def serve(host: str, port: int, descriptor: int | None = None) -> None:
    """Serve Prefect's API and UI at an address, or on a listening socket, to whoever `Doorkeeper` lets in.

    Raises:
        InputError: the environment holds no token.
    """
    if not os.environ.get(SERVER_TOKEN):
        raise InputError(SERVER_TOKEN, "", "holds no token: everybody could command the server", "openssl rand -hex 24 makes one")
    os.environ.setdefault("PREFECT_SERVER_UI_API_URL", f"http://{'127.0.0.1' if host == '0.0.0.0' else host}:{port}/api")
    os.environ[ORIGINS] = ",".join(own_origins(port, os.environ))
    prefect_home().mkdir(parents=True, exist_ok=True, mode=0o700)
    from flows.server.database import place_database

    place_database()
    close_home(os.environ.get(DATABASE, ""))
    from prefect.server.api.server import create_app

    from flows.server.connections import bound, run_server

    app = create_app()
    os.umask(0o077)  # from here on: the pages that were unpacked may be another user's, too; the database may not
    level = os.environ.get("PREFECT_SERVER_LOGGING_LEVEL", "warning").lower()
    level = "info" if level in ("debug", "trace") else level  # below, uvicorn writes down what clients send, tokens included
    watched = TokenWatch(app, os.environ[SERVER_TOKEN])
    with bound(host, port) if descriptor is None else socket.socket(fileno=os.dup(descriptor)) as listening:
        run_server(Doorkeeper(watched, os.environ[ORIGINS].split(",")), listening, level, has_sockets=True)


def main() -> int:
    """``python -m flows.server``; with `--socket` and `--follow`, the server of one run."""
    parser = argparse.ArgumentParser(prog="python -m flows.server", description="A Prefect server that wants a token.")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen on")
    parser.add_argument("--port", type=int, default=4200)
    parser.add_argument("--socket", type=int, help="descriptor of a listening socket, instead")
    parser.add_argument("--follow", type=int, help="process with which to end")
    arguments = parser.parse_args()
    if arguments.follow is not None:
        from flows.run.child import follow_parent

        follow_parent(arguments.follow)
    if arguments.socket is not None:
        arguments.host, arguments.port = socket.socket(fileno=os.dup(arguments.socket)).getsockname()[:2]
        for name in ("PREFECT_LOGGING_LEVEL", "PREFECT_LOGGING_ROOT_LEVEL", "PREFECT_SERVER_LOGGING_LEVEL"):
            os.environ[name] = "ERROR"  # nobody sees it but `prefect_server`, which looks there for the reason of a failed start
    try:
        serve(arguments.host, arguments.port, arguments.socket)
    except InputError as error:
        print(f"metascenes: {error}", file=sys.stderr)
        return 2
    return 0
