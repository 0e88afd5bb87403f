"""Serving a page to people on this machine: the socket, the address with its token, and the end."""

from __future__ import annotations

import contextlib
import html
import os
import socket
import sys
import webbrowser
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING
from urllib.parse import quote

from flows.server.access import new_token
from flows.server.connections import bound, run_server
from flows.view.gate import People, guarded
from schemas.files import write_whole
from schemas.machine.scratch import temporary_folder

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
        listening = until_the_end.enter_context(bound(host, port))
        token = new_token()

        def show() -> None:
            address = f"{origin_at(host, listening)}/?token={token}" + (f"&at={quote(at)}" if at else "")
            announce(address)
            if browser and _has_screen():
                webbrowser.open(until_the_end.enter_context(_leading_to(address)))

        serve_people(app, host, listening, lambda: {token: "viewer"}, show)


def serve_people(
    app: FastAPI, host: str, listening: socket.socket, people: People, announce: Callable[[], None], patience: int = 2
) -> None:
    """Serve an application to people, each by a token of their own, until interrupted.

    `people`: asked with each request. `announce` is called once the server answers. `patience`: how long a request that is being
    answered at the end is waited for [s].
    """
    listening.listen(64)  # from here on who opens the address is answered, if a moment later
    announce()
    guard = guarded(app, listening.getsockname()[1], people, [_name(host)])
    run_server(guard, listening, patience=patience)  # below warnings uvicorn writes down what clients send, tokens included


def origin_at(host: str, listening: socket.socket) -> str:
    """The address of a server's pages, without a path."""
    return f"http://{_name(host)}:{listening.getsockname()[1]}"


def _name(host: str) -> str:
    return socket.gethostname().lower() if host in _EVERYWHERE else f"[{host}]" if ":" in host else host


@contextlib.contextmanager
def _leading_to(address: str) -> Iterator[str]:
    """The address of a file that only its owner reads and that leads on to an address with a token.

    A browser is a process, and everybody on a machine reads the arguments of its processes.
    """
    with temporary_folder() as folder:
        file = folder / "open.html"
        write_whole(file, _REDIRECT.format(html.escape(address)).encode(), cache=True)  # of mode 0600
        yield file.as_uri()


def _has_screen() -> bool:
    """Whether a person sits at this machine: else a browser of text would take over the terminal."""
    graphical = sys.platform in ("darwin", "win32") or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    return graphical and sys.stdout.isatty()
