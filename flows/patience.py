"""Waiting for a lake or a store that is away, or whose lease somebody else holds: nobody's fault, and it passes."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TypeVar

from flows.artifacts import run_log
from flows.progress import current
from schemas.text import one_line
from warehouse.lease import LeaseError

T = TypeVar("T")

PAUSES = (10.0, 30.0, 120.0, 600.0)
"""Seconds before each further try: a store that is started again, a long commit, a move of the store."""


def is_away(error: Exception) -> bool:
    """Whether a lake or a store does not answer for the time being, or somebody else holds the lease: worth waiting for."""
    if isinstance(error, ConnectionError | TimeoutError | LeaseError):
        return True
    kinds = {f"{kind.__module__}.{kind.__name__}" for kind in type(error).__mro__}
    if kinds & {"botocore.exceptions.ConnectionError", "botocore.exceptions.HTTPClientError"}:
        return True
    return isinstance(error, OSError) and "Generic S3 error" in str(error)  # as delta-rs says it


def patiently(work: Callable[[], T], pauses: Sequence[float] | None = None) -> T:
    """What `work` gives, tried again after each pause (`PAUSES`) where the lake was away or in use. Bad input is not tried again.

    What `work` raises the last time goes on.
    """
    for pause in PAUSES if pauses is None else pauses:
        try:
            return work()
        except Exception as error:
            if not is_away(error):
                raise
            text = f"{type(error).__name__}: {one_line(error)}; trying again in {pause:g} s"
            current().say(text)
            run_log(text, warning=True)
            time.sleep(pause)
    return work()
