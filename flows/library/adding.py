"""A folder of models becomes a library of the lake; the same folder again brings what changed."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from flows.run.fingerprints import FileHashes, canonical_json, code_fingerprint, digest
from flows.run.libraries import folder_hash, indexed_library
from flows.run.pool import spread_over
from flows.worker import Job, Report, execute, lost_run
from schemas.errors import InputError, LakeError
from schemas.indexing import LIBRARY_PATTERN, IndexedLibrary, LibraryModel, RefusedModel
from schemas.record import arrow_to_rows
from tasks.indexing import STAGE, ModelsFolder
from tasks.library.catalog import catalog_of
from tasks.library.indexing import IndexConfig
from tasks.pipeline import MODULES
from tasks.stage import silently
from warehouse.lake import Lake

if TYPE_CHECKING:
    from warehouse.tables.history import StageState
    from warehouse.tables.snapshot import Reader


@dataclasses.dataclass(frozen=True)
class LakeShelf:
    """Blobs of a lake as a shelf for an indexing. Goes to other processes as the lake's address."""

    lake: Lake

    def refresh(self, name: str) -> bool:
        """Whether a blob is there; if so, a vacuum spares it as if it was put now."""
        return self.lake.blobs.refresh(name)

    def put(self, data: bytes, extension: str) -> str:
        """Keep a blob; its name."""
        return self.lake.blobs.put(data, extension)


@dataclasses.dataclass(frozen=True)
class PlannedLibrary:
    """What adding a folder would do. why: What is new of it; '' where the lake has it as it is."""

    name: str
    job: Job
    why: str
    state: StageState | None

    @property
    def is_known(self) -> bool:
        """Whether the lake, or what is staged for it, has this very library."""
        return not self.why


@dataclasses.dataclass(frozen=True)
class LibraryContents:
    """A library of the lake, with all its rows."""

    library: IndexedLibrary
    models: tuple[LibraryModel, ...]
    refused: tuple[RefusedModel, ...]


def planned_library(lake: Lake, folder: Path, name: str, metadata: Sequence[Path], config: IndexConfig, processes: int) -> PlannedLibrary:
    """Hold a folder against the lake; nothing is indexed or written but the cache of file hashes.

    name: '' for the folder's own. metadata: See `tasks.library.catalog.catalog_of`.

    Raises:
        InputError: there is no such folder, the name is none, or a file of metadata or the weights cannot be used.
    """
    name = name or re.sub(r"[^A-Za-z0-9_.-]+", "_", folder.resolve().name).strip("_.-")
    if not re.fullmatch(LIBRARY_PATTERN, name):
        raise InputError("library add", "--name", f"{name!r} is no name", "use letters, digits, and _ . -")
    hashes = FileHashes()
    files = folder_hash(folder, hashes)
    catalog = catalog_of(folder, metadata)
    stated = digest(*(f"{path.name}={hashes.hash(path)}" for path in metadata))
    hashes.save()
    weights = _weights(config)
    settings = dataclasses.replace(config, weights=weights)  # wherever its folder lies
    facts = {
        "files": files, "metadata": stated, "config": digest(canonical_json(settings)), "code": code_fingerprint(MODULES[STAGE.name]),
    }  # fmt: skip
    fingerprint = digest("library-1", *(f"{key}={value}" for key, value in facts.items()))
    state = lake.history([name]).get((name, STAGE.name)) if lake.exists else None
    job = Job(
        lake=lake.address, scene_id=name, stage=STAGE.name, config=config, config_json=canonical_json(config), seed=0,
        fingerprint=fingerprint, reasons=tuple(f"{key}={value}" for key, value in facts.items()), upstream=(),
        attempt=state.last.attempt + 1 if state is not None and state.last.fingerprint == fingerprint else 1,
        outside=(("models_folder", ModelsFolder(folder.absolute(), catalog, LakeShelf(lake))),), processes=processes,
    )  # fmt: skip
    return PlannedLibrary(name, job, _why(state, facts, fingerprint), state)


def _weights(config: IndexConfig) -> str:
    """Hash of the weights that are named; '' for none."""
    if not config.weights:
        return ""
    from tasks.library.embeddings import encoder_in
    from tasks.selection.methods.encoders import weights_digest

    encoder_in(config.weights)
    return weights_digest(config.weights)


def _why(state: StageState | None, facts: dict[str, str], fingerprint: str) -> str:
    """What is new of a library."""
    if state is None or state.done is None or REMOVED in state.done.reasons:
        return "new"
    if state.done.fingerprint == fingerprint:
        return ""
    before = dict(reason.split("=", 1) for reason in state.done.reasons)
    return f"{', '.join(key for key, value in facts.items() if before.get(key) != value)} changed"


def add_library(lake: Lake, planned: PlannedLibrary, report: Report = silently) -> LibraryContents:
    """Index a folder into the lake, in one commit. One that was killed goes on with the files that this machine does not remember.

    Raises:
        InputError: the folder or the weights cannot be used.
        LakeError: the indexing failed otherwise.
    """
    name = planned.name
    if not planned.is_known:
        run = execute(planned.job, spread_over(planned.job.processes, lambda done, of: report(done, of, "")), report)
        if run.error is not None:
            lake.commit(note=f"library {name} failed", scenes=[name])
            raise InputError(name, "indexing", run.error) if run.error_kind == "input" else LakeError(f"{name}: {run.error}")
    lake.commit(note=f"library {name}", scenes=[name])
    return contents_of(lake.snapshot(), name)


REMOVED = "removed=true"
"""The reason of a run that leaves a library without rows."""


def remove_library(lake: Lake, name: str, dry_run: bool = False) -> IndexedLibrary:
    """Take a library out of the lake. Candidates that were taken from it stay, with their assets; vacuum removes the other blobs.

    Raises:
        InputError: there is no such library.
    """
    row = _known(lake.snapshot(), name)
    if not dry_run:
        started = datetime.now(UTC)
        job = Job(
            lake=lake.address, scene_id=name, stage=STAGE.name, config=None, config_json="{}", seed=0,
            fingerprint=digest("library-1", REMOVED, name, started.isoformat()), reasons=(REMOVED,), upstream=(), attempt=1,
        )  # fmt: skip
        lake.stage_rows(dataclasses.replace(lost_run(job, None, None, 0.0), started_at=started))
        lake.commit(note=f"library {name} removed", scenes=[name])
    return row


def listed_libraries(reader: Reader) -> list[IndexedLibrary]:
    """The libraries of a snapshot, by name."""
    return reader.rows(IndexedLibrary)


def contents_of(reader: Reader, name: str) -> LibraryContents:
    """All rows of a library.

    Raises:
        InputError: there is no such library.
    """
    row, only = _known(reader, name), {"library": [name]}
    models = arrow_to_rows(reader.matching("library_models", only), LibraryModel)
    refused = arrow_to_rows(reader.matching("refused_models", only), RefusedModel)
    return LibraryContents(row, tuple(models), tuple(refused))


def _known(reader: Reader, name: str) -> IndexedLibrary:
    row = indexed_library(reader, name)
    if row is None:
        names = ", ".join(row.library for row in listed_libraries(reader)) or "none"
        raise InputError("library", name, "is no library of the lake", f"there are: {names}")
    return row
