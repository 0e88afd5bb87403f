"""A flow carried out in this process, by a command, with the server that is named or one of our own."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable
from typing import Any

from flows.progress import Progress, listen
from flows.server.process import is_of_server, prefect_server, why_not
from schemas.errors import LakeError


def result_here(load: Callable[[], Any], progress: Progress, parameters: dict[str, Any]) -> tuple[Any, Callable[[], LakeError | None]]:
    """The result of the flow that `load` imports, or the error that it ended with; and what to say of that where the server is to blame.

    `progress` shows how far it is. Prefect is imported while its server starts.
    """

    def ahead() -> None:
        with contextlib.suppress(Exception):  # it is the flow's result below
            load()

    with progress, prefect_server(ahead) as api:
        listen(progress)
        try:
            state = load()(**parameters, return_state=True)
            result = state.result(raise_on_failure=False)
        except Exception as error:
            result = error
        finally:
            listen(None)

    def blamed() -> LakeError | None:
        return LakeError(why_not(api, result)) if isinstance(result, Exception) and is_of_server(result) else None

    return result, blamed


_kept: list[Any] = []


def keep(result: Any) -> None:
    """Keep what a flow comes to: a server that is away in the end then makes Prefect forget it."""
    _kept[:] = [result]


def result_or_raise(load: Callable[[], Any], progress: Progress, parameters: dict[str, Any]) -> Any:
    """What the flow that `load` imports kept by `keep`; what was done is done, whatever Prefect's server has to say.

    Raises:
        LakeError: it kept nothing, and the server is to blame, or whatever it ended with.
    """
    _kept.clear()
    result, blamed = result_here(load, progress, parameters)
    if _kept:
        if isinstance(result, BaseException):
            print(f"note: Prefect's server does not know how the run ended ({type(result).__name__}); the lake does", file=sys.stderr)
        return _kept.pop()
    error = blamed()
    if error is not None:
        raise error from result
    assert isinstance(result, BaseException)
    raise result
