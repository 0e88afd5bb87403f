"""A batch served to its people: drafts and tokens opened, everybody's address, and the end."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from flows.view.annotating.drafts import Drafts, drafts_folder
from flows.view.annotating.people import Keys, keep_keys, kept_keys
from flows.view.annotating.routes import annotation_application
from flows.view.annotating.settling import Rooms
from flows.view.annotating.work import ServedBatch, created_batch
from flows.view.serving import bound, serve_people
from schemas.errors import InputError
from warehouse.lake import Lake

PATIENCE_SECONDS = 60
"""How long figures that are being computed are waited for at the end."""


def serve_annotation(
    lake: Lake, batch_id: str, reviewers: Sequence[str], file: Path | None, host: str, port: int,
    announce: Callable[[dict[str, dict[str, Any]]], None],
) -> None:  # fmt: skip
    """Serve a batch to its annotators and to reviewers until interrupted. `announce` is called with roles and address by name.

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
        tokens = place.with_name(f"{place.name}.tokens")
        keys = kept_keys(tokens, work.roles)
        with _listening(host, port, keys.port) as listening:
            is_asked = bool(port) or not keys.port
            # where another server of the batch has the port, its addresses stay what is kept
            keep_keys(tokens, Keys(keys.tokens, listening.getsockname()[1] if is_asked else keys.port))

            ending = threading.Event()
            warming = threading.Thread(target=rooms.warm, args=(ending,), name="warming")

            def show(addresses: Mapping[str, str]) -> None:
                warming.start()
                announce({name: {"roles": list(work.roles[name]), "address": address} for name, address in addresses.items()})

            people = {token: name for name, token in keys.tokens.items()}
            try:
                serve_people(annotation_application(work, rooms), host, listening, people, show, PATIENCE_SECONDS)
            finally:
                ending.set()
                if warming.ident is not None:
                    warming.join()  # native code must not run on while the process ends


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
