"""The client as it was built at set-up: what `requirements/client.py` made of `flows/view/client/` and three.js."""

from __future__ import annotations

from pathlib import Path

from schemas.errors import InputError
from schemas.files import is_there

BUILT = Path(__file__).parent / "built"

KINDS = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8"}
"""Files of the client that are served, by ending."""


def client_file(name: str) -> bytes:
    """A file of the built client, such as `view.js`.

    Raises:
        InputError: the client was not built.
        KeyError: it has no such file.
    """
    if not (BUILT / "view.js").is_file():
        raise InputError("metascenes view", "client", "was not built", "`make client` in a checkout does; it needs three.js from npm once")
    if Path(name).name != name or Path(name).suffix not in KINDS or not is_there(BUILT / name):
        raise KeyError(name)
    return (BUILT / name).read_bytes()


def is_built() -> bool:
    """Whether there is a client."""
    return (BUILT / "view.js").is_file()
