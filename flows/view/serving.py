"""Serving a page to people on this machine: the socket, the address with its token, and the end."""

from __future__ import annotations

import contextlib
import html
import os
import socket
import sys
import tempfile
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from flows.server.access import new_token
from flows.view.gate import guarded
from schemas.errors import InputError

if TYPE_CHECKING:
    from fastapi import FastAPI

LOOPBACK = "127.0.0.1"
_EVERYWHERE = {"0.0.0.0", "::"}
_REDIRECT = """<!doctype html>
<meta charset="utf-8"><meta name="referrer" content="no-referrer"><meta http-equiv="refresh" content="0;url={}"><title>Scene lake</title>
"""


def serve(app: FastAPI, host: str, port: int, announce: Callable[[str], None], browser: bool = False, at: str = "") -> None:
    """Serve an application to whoever has its token, until interrupted. `announce` is called with the address once it answers.

    Port 0 is a free one. `browser`: also open the page, where somebody sits at this machine. `at`: the scene, or the object of
    one, that the address leads to.

    Raises:
        InputError: the host or port cannot be had.
    """
    with contextlib.ExitStack() as until_the_end:

        def show(addresses: Mapping[str, str]) -> None:
            address = addresses["viewer"] + (f"&at={quote(at)}" if at else "")
            announce(address)
            if browser and _has_screen():
                webbrowser.open(until_the_end.enter_context(_leading_to(address)))

        with bound(host, port) as listening:
            serve_people(app, host, listening, {new_token(): "viewer"}, show)


def serve_people(
    app: FastAPI, host: str, listening: socket.socket, people: Mapping[str, str], announce: Callable[[Mapping[str, str]], None],
    patience: int = 2,
) -> None:  # fmt: skip
    """Serve an application to people, each by a token of their own, until interrupted.

    `people`: names by token. `announce` is called with everybody's address by name once the server answers. `patience`: how long a
    request that is being answered at the end is waited for [s].
    """
    import uvicorn

    number = listening.getsockname()[1]
    name = socket.gethostname().lower() if host in _EVERYWHERE else f"[{host}]" if ":" in host else host
    listening.listen(64)  # from here on who opens the address is answered, if a moment later
    announce({person: f"http://{name}:{number}/?token={token}" for token, person in people.items()})
    guard = guarded(app, number, people, [name])
    # below warnings uvicorn writes down what clients send, tokens included
    server = uvicorn.Server(uvicorn.Config(guard, log_level="warning", access_log=False, timeout_graceful_shutdown=patience))
    with contextlib.suppress(KeyboardInterrupt):
        server.run(sockets=[listening])


@contextlib.contextmanager
def bound(host: str, port: int) -> Iterator[socket.socket]:
    """A socket at a host and port of this machine.

    Raises:
        InputError: it is taken, or not this machine's.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as made:
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            made.bind((host, port))
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise InputError(f"{host}:{port}", "--port", f"cannot be had ({reason})", "leave --port away for a free one") from error
        yield made


@contextlib.contextmanager
def _leading_to(address: str) -> Iterator[str]:
    """The address of a file that only its owner reads and that leads on to an address with a token.

    A browser is a process, and everybody on a machine reads the arguments of its processes.
    """
    handle, name = tempfile.mkstemp(prefix="metascenes-", suffix=".html")  # of mode 0600
    file = Path(name)
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as page:
            page.write(_REDIRECT.format(html.escape(address)))
        yield file.as_uri()
    finally:
        file.unlink(missing_ok=True)


def _has_screen() -> bool:
    """Whether a person sits at this machine: else a browser of text would take over the terminal."""
    graphical = sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return graphical and sys.stdout.isatty()
