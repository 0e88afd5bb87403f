"""Waiting for a lake, a store or a Prefect server that is away, or for a lease that somebody else holds: nobody's fault, and it passes."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from typing import TypeVar

from flows.progress import current
from flows.server.artifacts import run_log
from schemas.errors import LakeError
from schemas.text import one_line
from warehouse.sharing.lease import LeaseError

T = TypeVar("T")

PAUSES = (10.0, 30.0, 120.0, 600.0)
"""Seconds before each further try: a store that is started again, a long commit, a move of the store."""

_OF_CREDENTIALS = {"botocore.exceptions.ConnectionError", "botocore.exceptions.HTTPClientError"}
"""Errors of what looks for credentials and lists buckets of others; named, so that nothing is imported for them."""


def is_away(error: BaseException | None) -> bool:
    """Whether a lake, a store or a server does not answer for the time being, or somebody else holds the lease: worth waiting for."""
    import httpx

    if isinstance(error, httpx.HTTPStatusError):
        return error.response.status_code >= 500 or error.response.status_code == 429
    if isinstance(error, ConnectionError | TimeoutError | LeaseError | httpx.TransportError):
        return True
    if error is None or isinstance(error, LakeError):
        return False
    if _OF_CREDENTIALS & {f"{kind.__module__}.{kind.__name__}" for kind in type(error).__mro__}:
        return True
    if isinstance(error, OSError) and re.search("Generic (S3|GCS|MicrosoftAzure) error", str(error)):  # as delta-rs says it
        return True
    return is_away(error.__cause__)  # Prefect wraps what happens while it connects


def retried(work: Callable[[], T], pauses: Iterable[float], before: Callable[[Exception, float], None] = lambda error, pause: None) -> T:
    """The result of `work`, tried again after each pause [s] while a service is away; the error of the last try is raised.

    before: Called with the error and the pause that follows it.
    """
    for pause in pauses:
        try:
            return work()
        except Exception as error:
            if not is_away(error):
                raise
            before(error, pause)
        time.sleep(pause)
    return work()


def patiently(work: Callable[[], T]) -> T:
    """`retried` after each of `PAUSES`, which says so. Bad input is not tried again."""

    def tell(error: Exception, pause: float) -> None:
        text = f"{type(error).__name__}: {one_line(error)}; trying again in {pause:g} s"
        current().say(text)
        run_log(text, warning=True)

    return retried(work, PAUSES, tell)
