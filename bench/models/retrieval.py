"""How well retrieval finds the model that was scanned, and what a query costs.

The library holds the real models, and as many distractors of the same categories as asked for, drawn by the furniture generator: half
in their usual size, half in about the size of a real model. Queries are scans of the real models in furnished rooms, as captured. Weights
were chosen on rooms of the seeds `TUNED`; `HELD_OUT` are others, with other distractors.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.models.rooms import asked, query_rooms
from bench.realdata import MODELS
from bench.shelves import ShelvedModel, models_in
from schemas.budget import BUDGET
from schemas.files import read_file
from tasks.candidates.request import CandidateRequest
from tasks.furniture import generate
from tasks.geometry.meshes import dump_glb
from tasks.library.catalog import catalog_of
from tasks.library.entry import IndexEntry
from tasks.library.indexing import IndexConfig, ModelIndex, index_folder
from tasks.library.search import LibraryQuery, LibrarySearch

TUNED, HELD_OUT = (1, 2), (3, 4)
"""Seeds of rooms and distractors by which weights were chosen, and of others."""

DISTRACTORS = 400
SPREAD = 0.2
"""Standard deviation of the logarithm of a distractor's sides against those of a real model."""

LARGE = 10_000
"""Entries at which a query's time is measured."""

FIRST, FEW = 1, 10


@dataclasses.dataclass(frozen=True)
class ScannedQuery:
    """A scanned instance. file: The model that it shows. category: As the capture has it; true_category: the model's."""

    file: str
    category: str
    true_category: str
    request: CandidateRequest


@dataclasses.dataclass(frozen=True)
class RetrievalShares:
    """Shares of queries, 0..1: the scanned model first, or among the ten first, by category or without one; and the right category first
    where the scanned model is withheld, likewise."""

    first: float
    in_ten: float
    first_unnamed: float
    in_ten_unnamed: float
    category_withheld: float
    category_withheld_unnamed: float


@dataclasses.dataclass(frozen=True)
class RetrievalFigures:
    """What was measured. seconds: Of computing for queries at `LARGE` entries, shape (queries,)."""

    queries: int
    entries: int
    shares: RetrievalShares
    seconds: NDArray[np.float64]

    def lines(self) -> list[str]:
        """The figures, as a person reads them."""
        values = ", ".join(f"{key} {value:.3f}" for key, value in dataclasses.asdict(self.shares).items())
        made = [f"{self.queries} queries, {self.entries} models", values]
        low, high = (1e3 * float(np.quantile(self.seconds, share)) for share in (0.5, 0.95))
        return [*made, f"a query at {LARGE} models: median {low:.1f} ms of one core, of 20 the slowest {high:.1f} ms"]


def lacking(realdata: Path | None) -> str | None:
    """Why retrieval cannot be measured; None where it can."""
    if realdata is None:
        return "METASCENES_REALDATA or --realdata names the folder that holds the models"
    return None if (realdata / MODELS / "index.json").is_file() else f"{realdata} does not hold {MODELS}"


def measured(realdata: Path, seeds: Sequence[int] = HELD_OUT, distractors: int = DISTRACTORS) -> RetrievalFigures:
    """Scan the real models once for every seed, and look each up among the distractors of that seed."""
    places: list[NDArray[np.int64]] = []
    seconds: list[NDArray[np.float64]] = []
    entries = 0
    for seed in seeds:
        with tempfile.TemporaryDirectory(prefix="library-", ignore_cleanup_errors=True) as place:
            folder = Path(place)
            write_library(realdata / MODELS, folder, distractors, seed)
            made = index_folder(folder, catalog_of(folder), IndexConfig(), {})
            queries = queries_of(models_in(realdata / MODELS), seed)
            search = LibrarySearch.of(made.entries)
            places.append(_places(queries, search, {entry.file: entry.category for entry in made.entries}))
            seconds.append(timed(made, queries))
            entries = len(made.entries)
    return RetrievalFigures(sum(map(len, places)), entries, _shares(np.concatenate(places)), np.concatenate(seconds))


def write_library(models: Path, folder: Path, distractors: int, seed: int) -> None:
    """The real models in a folder, with distractors and an index of all of them; the same seed writes the same bytes."""
    rows = json.loads(read_file(models / "index.json", "index.json", BUDGET.text_bytes))
    known = {model.file: model for model in models_in(models)}
    for row in rows:
        (folder / row["file"]).write_bytes(read_file(models / row["file"], row["file"], BUDGET.asset_bytes))
    rng = np.random.default_rng([seed, 3])
    files = sorted(known)
    listed = [{"file": row["file"], "category": row["category"]} for row in rows]
    for number in range(distractors):
        like = known[files[number % len(files)]]
        x, y, z = np.maximum(like.extents * np.exp(rng.normal(0.0, SPREAD, 3)), 0.004).tolist()
        name = f"drawn_{number:04d}.glb"
        (folder / name).write_bytes(dump_glb(generate(like.category, (x, y, z) if number % 2 else None, rng).parts))
        listed.append({"file": name, "category": like.category})
    (folder / "index.json").write_text(json.dumps(listed))


def queries_of(real: Sequence[ShelvedModel], seed: int) -> list[ScannedQuery]:
    """Scans of real models."""
    rooms = query_rooms(real, seed)
    return [
        ScannedQuery(entry.file, request.category, entry.category, request)
        for number, entries in enumerate(rooms)
        for entry, request in asked(entries, seed, number)
    ]


def query_of(category: str, query: ScannedQuery) -> LibraryQuery:
    """What the index is asked."""
    request = query.request
    rng = request.context.rng("search", request.instance.instance_id)
    return LibraryQuery.of(category, request.descriptor, request.points[0], rng)


def _places(queries: Sequence[ScannedQuery], search: LibrarySearch, categories: dict[str, str]) -> NDArray[np.int64]:
    """For every query: the place of its model by category and without one, from 0, then whether the first of the others is of its
    category, 0 or 1, likewise; shape (queries, 4)."""
    rows = []
    for query in queries:
        places, right = [], []
        for category in (query.category, ""):
            files = [match.file for match in search.find(query_of(category, query), len(search.files))]
            remaining = [file for file in files if file != query.file]
            places.append(files.index(query.file) if query.file in files else len(categories))
            right.append(int(bool(remaining) and categories[remaining[0]] == categories[query.file]))
        rows.append([*places, *right])
    return np.array(rows, dtype=np.int64).reshape(-1, 4)


def _shares(places: NDArray[np.int64]) -> RetrievalShares:
    named, unnamed, right, right_unnamed = places.T

    def share(place: NDArray[np.int64], most: int) -> float:
        return float((place < most).mean())

    return RetrievalShares(
        share(named, FIRST), share(named, FEW), share(unnamed, FIRST), share(unnamed, FEW), float(right.mean()), float(right_unnamed.mean())
    )


def timed(index: ModelIndex, queries: Sequence[ScannedQuery], entries: int = LARGE) -> NDArray[np.float64]:
    """Seconds of computing for every query, its preparation among them, at so many entries: those of the index, again and again."""
    many: list[IndexEntry] = [
        dataclasses.replace(index.entries[number % len(index.entries)], file=f"{number:06d}", duplicate_of="") for number in range(entries)
    ]
    search = LibrarySearch.of(many)
    search.find(query_of("", queries[0]), FEW)  # compiled, and loaded
    seconds = []
    for query in queries:
        _ = query.request.descriptor, query.request.points  # the capture's part
        start = time.thread_time()
        search.find(query_of(query.category, query), FEW)
        seconds.append(time.thread_time() - start)
    return np.array(seconds)
