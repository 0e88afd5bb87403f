"""What a stage is: a declaration, a frozen config and a pure `run`."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from typing import Any, Literal, Protocol

import numpy as np

from schemas.tables import TABLES
from tasks.calls.ledger import Ledger, Recollection


class Blobs(Mapping[str, bytes]):
    """Files made by a stage, by name. A name is the hash of the content: `<sha256>.<extension>`."""

    def __init__(self) -> None:
        self._data: dict[str, bytes] = {}

    def add(self, data: bytes, extension: str) -> str:
        """Keep `data` and return its name, which rows use to refer to it."""
        name = f"{hashlib.sha256(data).hexdigest()}.{extension}"
        self._data[name] = data
        return name

    def update(self, other: Mapping[str, bytes]) -> None:
        """Keep the files of `other` too."""
        self._data.update(other)

    def __getitem__(self, name: str) -> bytes:
        return self._data[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._data)

    def __len__(self) -> int:
        return len(self._data)


def silently(done: int, of: int, text: str) -> None:
    """Progress that nobody watches."""


Spread = Callable[[Callable[[Any], Any], Sequence[Any]], list[Any]]
"""A map: the function's values for items, in their order."""


def in_turn(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
    """The function's values, one item after another, in this process."""
    return [function(item) for item in items]


class Caches(Protocol):
    """A memory for every module, by the module's name."""

    def __getitem__(self, module: str, /) -> MutableMapping[str, bytes]:
        """What the module remembers."""


def _forgetful() -> Caches:
    """Memories that last as long as the context."""
    memories: defaultdict[str, dict[str, bytes]] = defaultdict(dict)
    return memories


@dataclasses.dataclass(frozen=True)
class Context:
    """What a run may know besides its inputs: whose it is, the seed, and the blobs that its input rows name.

    `scene_id` is the batch for stages that work on batches, the library for the one that makes libraries, the later scan for the one that
    holds scans of a room against each other. `caches` remember, between
    runs and stages, what costs much and follows from content alone, one for every module that computes such values
    (`caches["tasks.geometry.pieces"]`): a key must name everything that its value depends on but the module's own code.
    `spread(function, items)` is the list of the function's values, in the order of the items, computed in other processes where cores
    are free.
    `report(done, of, text)` tells whoever watches how far a long run is. `ledger` has every call to a model.
    """

    scene_id: str
    stage: str
    seed: int
    blobs: Mapping[str, bytes]
    caches: Caches = dataclasses.field(default_factory=_forgetful)
    spread: Spread = in_turn
    report: Callable[[int, int, str], None] = silently
    ledger: Ledger = dataclasses.field(default_factory=Recollection)

    def rng(self, *words: object) -> np.random.Generator:
        """A generator seeded by (run seed, scene, stage, words): the same on every worker."""
        text = "\x1f".join([str(self.seed), self.scene_id, self.stage, *map(str, words)])
        return np.random.default_rng(list(hashlib.sha256(text.encode()).digest()))


class Outcome:
    """What a run gives back: rows per table, the blobs they name, and what had to be left out.

    ``Outcome(captions=rows, blobs=blobs, degradations=["0007: too few points for a color"])``
    """

    def __init__(self, *, blobs: Mapping[str, bytes] | None = None, degradations: Sequence[str] = (), **rows: Sequence[Any]) -> None:
        self.rows: dict[str, list[Any]] = {table: list(values) for table, values in rows.items()}
        self.blobs: Mapping[str, bytes] = blobs if blobs is not None else {}
        self.degradations = tuple(degradations)


@dataclasses.dataclass(frozen=True)
class WantedModel:
    """A model that a stage asks for: of the learned system `kind`, the newest, or the one whose id is, or begins with, `model_id`."""

    kind: str
    model_id: str = ""


OutsideInput = Literal[
    "scan",
    "library",
    "models_folder",
    "annotation_batch",
    "review_batch",
    "batch_acts",
    "trajectory_batch",
    "drive_batch",
    "dataset",
    "start",
    "provenance",
    "model",
    "compared_batches",
    "rescanned_rooms",
]


@dataclasses.dataclass(frozen=True)
class Stage:
    """A stage's declaration. `run` takes a keyword per table in `reads`, per name in `outside`, `context` and `config`.

    `history` names tables that are read as they stand in the lake, whoever wrote them (annotations: those that were
    accepted), instead of from an upstream stage of the same scene. `streams` are tables of which a stage of grain `dataset`
    reads the rows of all scenes, through its input `dataset`. A stage with the outside input `model` says by `model_wanted(config)`
    which one it wants, if any. `scan_wanted(config)` says of a stage with the outside input `scan` whether it wants it; one that does not
    is given None, and its fingerprint does not name the scan.
    """

    name: str
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    config: type
    run: Callable[..., Outcome]
    grain: Literal["scene", "rescan", "library", "annotation_batch", "trajectory_batch", "drive_batch", "dataset", "comparison"] = "scene"
    outside: tuple[OutsideInput, ...] = ()
    history: tuple[str, ...] = ()
    streams: tuple[str, ...] = ()
    model_wanted: Callable[[Any], WantedModel | None] | None = None
    scan_wanted: Callable[[Any], bool] | None = None

    def takes_scan(self, config: Any) -> bool:
        """Whether a run with a config is given the scan."""
        return "scan" in self.outside and (self.scan_wanted is None or self.scan_wanted(config))

    def __post_init__(self) -> None:
        if ("model" in self.outside) != (self.model_wanted is not None):
            raise ValueError(f"stage {self.name}: the outside input `model` and `model_wanted` go together")
        if self.scan_wanted is not None and "scan" not in self.outside:
            raise ValueError(f"stage {self.name}: `scan_wanted` is there for the outside input `scan` alone")
        for table in (*self.reads, *self.streams, *self.writes):
            if table not in TABLES:
                raise ValueError(f"stage {self.name}: {table} is no table of schemas.tables")
        wrong = [table for table in self.writes if TABLES[table].stage != self.name]
        if wrong:
            raise ValueError(f"stage {self.name}: {', '.join(wrong)} belong to another stage")
