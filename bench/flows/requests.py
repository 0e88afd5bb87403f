"""Requests to a store of objects, counted where they arrive: a store that speaks S3, in this process, on loopback.

What delta-rs, Arrow and DuckDB ask of a store by themselves is counted like what the lake asks.
"""

from __future__ import annotations

import contextlib
import os
import re
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from schemas.errors import InputError

KINDS = ("put", "get", "list", "head", "delete")
"""What stores charge for, each at a price of its own: those that delete cost nothing on S3."""

_BUCKET = "scale"
_LIST = re.compile(r"(^|&)(list-type|prefix|delimiter)=")


class Requests:
    """How many requests of each kind came in during each part of the work."""

    def __init__(self) -> None:
        self.part = ""
        self._counts: Counter[tuple[str, str]] = Counter()
        self._lock = threading.Lock()

    def note(self, method: str, query: str) -> None:
        """One more, as the line of the request has it."""
        with self._lock:
            self._counts[self.part, kind_of(method, query)] += 1

    def of(self, part: str) -> dict[str, int]:
        """Those of a part by kind."""
        return {kind: self._counts[part, kind] for kind in KINDS}


def kind_of(method: str, query: str) -> str:
    """The kind of a request: `query` tells a listing from an object. Parts of an upload are puts."""
    if method == "GET" and _LIST.search(query):
        return "list"
    known = {"GET": "get", "HEAD": "head", "PUT": "put", "POST": "put", "DELETE": "delete"}
    return known[method]


@contextlib.contextmanager
def counting_store(requests: Requests) -> Iterator[str]:
    """An address for a new lake in an empty store, to which the environment of this process leads meanwhile.

    Raises:
        InputError: the package that is the store is not installed.
    """
    try:
        from moto.server import DomainDispatcherApplication, create_backend_app
        from werkzeug.serving import WSGIRequestHandler, make_server
    except ImportError as error:
        raise InputError("--requests", "", "needs the package moto with its server", "pip install 'moto[server]'") from error

    class Silent(WSGIRequestHandler):
        """Answers without a line for each request, and keeps connections open as stores do."""

        protocol_version = "HTTP/1.1"

        def log_request(self, *arguments: Any) -> None:
            """Nothing."""

    application = DomainDispatcherApplication(create_backend_app)

    def counted(environment: dict[str, Any], answer: Callable[..., Any]) -> Iterable[bytes]:
        requests.note(environment["REQUEST_METHOD"], environment.get("QUERY_STRING", ""))
        replies: Iterable[bytes] = application(environment, answer)
        return replies

    server = make_server("127.0.0.1", 0, counted, threaded=True, request_handler=Silent)
    thread = threading.Thread(target=server.serve_forever, name="store", daemon=True)
    thread.start()
    access = {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{server.server_port}", "AWS_ACCESS_KEY_ID": "scale", "AWS_SECRET_ACCESS_KEY": "scale",
        "AWS_DEFAULT_REGION": "us-east-1",
    }  # fmt: skip
    before = dict(os.environ)
    for name in ("AWS_PROFILE", "AWS_SESSION_TOKEN", "AWS_ENDPOINT_URL_S3"):
        os.environ.pop(name, None)
    os.environ.update(access)
    try:
        from botocore.session import get_session

        get_session().create_client("s3", endpoint_url=access["AWS_ENDPOINT_URL"]).create_bucket(Bucket=_BUCKET)
        yield f"s3://{_BUCKET}/lake"
    finally:
        os.environ.clear()
        os.environ.update(before)
        server.shutdown()
        thread.join()
        server.server_close()
