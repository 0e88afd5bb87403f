"""A batch served to its people: drafts and tokens opened, everybody's address, and the end."""

from __future__ import annotations

import contextlib
import dataclasses
import socket
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from flows.server.connections import bound
from flows.view.annotating.drafts import Drafts, drafts_folder
from flows.view.annotating.keys import KeyFile
from flows.view.annotating.routes import annotation_application
from flows.view.annotating.settling import Rooms
from flows.view.annotating.work import ServedBatch, created_batch
from flows.view.serving import origin_at, serve_people
from schemas.errors import InputError
from warehouse.lake import Lake

PATIENCE_SECONDS = 60
"""How long figures that are being computed are waited for at the end."""


def serve_annotation(
    lake: Lake, batch_id: str, reviewers: Sequence[str], file: Path | None, host: str, port: int,
    announce: Callable[[dict[str, dict[str, Any]]], None],
) -> None:  # fmt: skip
    """Serve a batch to its annotators and to reviewers until interrupted. `announce` is called with roles and address by name; the
    address is None where the person's token was withdrawn.

    `file`: of the drafts; in the lake's folder when none is named. Port 0 is the one of the last time, while it is free.

    Raises:
        InputError: the batch, a name, the file, the host or the port cannot be used.
    """
    import shapely  # noqa: F401  # here, once: two threads that import it for the first time at once may find half of it

    created_batch(lake.snapshot(), batch_id)  # before a file is made for it
    place = file or drafts_file(lake, batch_id)
    with contextlib.closing(Drafts(place, batch_id)) as drafts:
        work = ServedBatch(lake, batch_id, drafts, reviewers)
        rooms = Rooms(work)
        tokens = key_file(place)
        last = tokens.read().port
        with _listening(host, port, last) as listening:
            own, origin = listening.getsockname()[1], origin_at(host, listening)
            # Where another server of the batch has the port, its addresses stay those that are kept.
            is_kept = bool(port) or last in (0, own)
            keys = tokens.serve(work.roles, own, origin) if is_kept else tokens.serve(work.roles)

            ending = threading.Event()
            warming = threading.Thread(target=rooms.warm, args=(ending,), name="warming")

            def show() -> None:
                warming.start()
                shown = dataclasses.replace(keys, origin=origin)
                announce({name: {"roles": list(held), "address": shown.address(name)} for name, held in work.roles.items()})

            try:
                app = annotation_application(work, rooms)
                serve_people(app, host, listening, lambda: tokens.people(work.roles), show, PATIENCE_SECONDS)
            finally:
                ending.set()
                if warming.ident is not None:
                    warming.join()  # native code must not run on while the process ends


def key_file(drafts: Path) -> KeyFile:
    """The file of tokens that belongs to a file of drafts."""
    return KeyFile(drafts.with_name(f"{drafts.name}.tokens"))


def drafts_file(lake: Lake, batch_id: str) -> Path:
    """Where the drafts of a batch lie.

    Raises:
        InputError: the lake is in no local folder.
    """
    folder = drafts_folder(lake)
    if folder is None:
        raise InputError(lake.address, "--drafts", "the lake is not in a local folder", "name a file of this machine for the drafts")
    return folder / f"{batch_id}.sqlite"


@contextlib.contextmanager
def _listening(host: str, port: int, last: int) -> Iterator[socket.socket]:
    """A socket at a port; for port 0 at the last one, so that addresses stay as they are, or at a free one."""
    with contextlib.ExitStack() as stack:
        try:
            made = stack.enter_context(bound(host, port or last))
        except InputError:
            if port:
                raise
            made = stack.enter_context(bound(host, 0))
        yield made
