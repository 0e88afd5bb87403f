"""Pictures that were drawn before, in the cache of this machine: under a hash of all that they show and of the code that draws.

Nothing stale is ever shown: other rows, another look or other code have another hash. An erasure of a scene removes them
all (`flows.scans.erasure`), for a hash does not say whose it is.
"""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import pkgutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

import pyarrow as pa

from flows.run.fingerprints import PICTURES, FileCache, cache_folder, code_fingerprint, digest
from schemas.parsing import json_value
from tasks.films.drives import DriveStill
from tasks.films.walks import WalkStrip
from tasks.stats.scenes import ScenePictures
from tasks.stats.style import Picture
from tasks.stats.thumbnails import CandidateStrip, CandidateTile

T = TypeVar("T")

MOST_FILES = 2000
"""Pictures that are kept: a few hundred MB. The oldest go."""

KINDS: Mapping[str, type] = {kind.__name__: kind for kind in (ScenePictures, Picture, CandidateStrip, CandidateTile, WalkStrip, DriveStill)}


class NotDrawnYet(Exception):
    """A picture would have to be drawn where none may be."""


_DRAWS: ContextVar[bool] = ContextVar("draws", default=True)


@contextmanager
def only_remembered() -> Iterator[None]:
    """What was not drawn before raises `NotDrawnYet` in this context, so that workers are started only for what must be drawn."""
    before = _DRAWS.set(False)
    try:
        yield
    finally:
        _DRAWS.reset(before)


def remembered(facts: Sequence[Any], draw: Callable[[], T]) -> T:
    """The result of `draw`, cached by the `facts` that it depends on (tables, rows, numbers, configs).

    Raises:
        NotDrawnYet: it is not cached, and nothing may be drawn (`only_remembered`).
    """
    store = _cache()
    key = digest(*map(_text, facts))
    try:
        picture: T = _made(json_value(store[key]))
        return picture
    except (KeyError, ValueError, TypeError):  # not there, or not whole
        pass
    if not _DRAWS.get():
        raise NotDrawnYet
    made = draw()
    store[key] = json.dumps(_plain(made)).encode()
    return made


def forget_old() -> None:
    """Remove the oldest pictures beyond `MOST_FILES`, and those of other versions of the code."""
    for folder in (cache_folder() / "modules").glob(f"{PICTURES}*"):
        files = sorted(folder.glob("*"), key=_age, reverse=True)
        for file in files[MOST_FILES:] if folder.name == f"{PICTURES}{_code()[:16]}" else files:
            file.unlink(missing_ok=True)


def _age(file: Path) -> float:
    try:
        return file.stat().st_mtime
    except OSError:  # somebody else removed it
        return 0.0


def _cache() -> FileCache:
    return FileCache(cache_folder() / "modules" / f"{PICTURES}{_code()[:16]}")


@cache
def _code() -> str:
    """Hash of all that draws: the modules of `tasks.stats` with what they import, of `tasks.films`, of `flows.stats`, and the libraries."""
    import tasks.stats

    drawing = [f"tasks.stats.{module.name}" for module in pkgutil.iter_modules(tasks.stats.__path__)]
    own = [
        code_fingerprint(name)
        for name in (*drawing, "tasks.films.frames", "tasks.films.drives", "flows.outputs.films", "flows.outputs.drives")
    ]
    callers = [hashlib.sha256(file.read_bytes()).hexdigest() for file in sorted(Path(__file__).parent.glob("*.py"))]
    return digest(*own, *callers, *(version(name) for name in ("matplotlib", "pillow", "numpy", "embreex", "wordcloud")))


def _text(fact: Any) -> str:
    """A fact as text: the same for the same rows."""
    if isinstance(fact, pa.Table):
        return json.dumps([fact.schema.to_string(show_schema_metadata=False), fact.to_pylist()], default=repr)
    if isinstance(fact, Mapping | list | tuple):
        return json.dumps(fact, default=_text)
    return repr(fact)


def _plain(value: Any) -> Any:
    """A picture as JSON."""
    if isinstance(value, bytes):
        return {"bytes": base64.b64encode(value).decode()}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {type(value).__name__: {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}}
    return {"tuple": [_plain(item) for item in value]} if isinstance(value, tuple) else value


def _made(value: Any) -> Any:
    """What `_plain` was given."""
    if not isinstance(value, dict):
        return value
    ((kind, held),) = value.items()
    if kind == "bytes":
        return base64.b64decode(held, validate=True)
    if kind == "tuple":
        return tuple(_made(item) for item in held)
    return KINDS[kind](**{name: _made(item) for name, item in held.items()})
