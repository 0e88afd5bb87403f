"""Finished datasets into the lake: each scene read, staged as runs of the stages whose tables it fills, and committed.

Does not import Prefect. A second import of the same files does nothing; a changed file replaces its scene alone; a scene
that cannot be read leaves a row that says why and does not stop the others.
"""

from __future__ import annotations

import dataclasses
import os
import re
import resource
import socket
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from flows.progress import Progress
from flows.run.fingerprints import FileHashes, ModuleCaches, canonical, canonical_json, code_fingerprint, digest
from flows.run.patience import is_away
from flows.run.pool import spread_over
from flows.run.scene import NO_ROOM
from schemas.errors import InputError, LakeError
from schemas.record import check
from schemas.runs import StageRun
from schemas.tables import TABLES
from schemas.text import one_line
from tasks.ingestion.navmeshes import navigation_rows
from tasks.ingestion.reading import ingest
from tasks.ingestion.scene import IngestionConfig, Kind, Source
from tasks.ingestion.sources import find_sources
from tasks.stage import Context, Outcome
from warehouse.lake import Lake
from warehouse.storage.refusals import number_of
from warehouse.tables.history import Key, StageState

_BATCH = 64
"""Scenes per commit: a dataset of thousands is there bit by bit, and a commit costs less than a second."""

_READS: Mapping[str, tuple[str, ...]] = {
    "capture": (),
    "captions": ("capture",),
    "candidates": ("capture",),
    "optimization": ("capture", "candidates"),
    "micro_scenes": ("capture", "candidates", "optimization"),
    "navigation": ("capture", "candidates", "optimization"),
}
"""Stages that an import can stand for, in order, and those whose rows theirs name."""

Action = Literal["import", "reuse", "report"]


@dataclasses.dataclass(frozen=True)
class SceneImport:
    """A scene of a dataset and what is to be done with it, or was: `import` it, `reuse` what is there, `report` its failure.

    objects: Instances, 0 before they are read. notes: What had to be left out or assumed. error: Why it failed.
    """

    scene_id: str
    action: Action
    why: str
    objects: int = 0
    notes: tuple[str, ...] = ()
    error: str | None = None


@dataclasses.dataclass(frozen=True)
class DatasetImport:
    """What came of an import: every scene of the dataset, by scene id."""

    dataset: str
    kind: Kind
    scenes: tuple[SceneImport, ...]

    @property
    def failed(self) -> tuple[SceneImport, ...]:
        """Scenes that are not in the lake as the dataset has them now."""
        return tuple(scene for scene in self.scenes if scene.error is not None)


@dataclasses.dataclass(frozen=True)
class _Job:
    """A scene to import. Travels to a worker process."""

    lake: str
    source: Source
    config: IngestionConfig
    seed: int
    content: str
    code: str
    attempt: int


def import_dataset(
    lake: Lake, kind: Kind, folder: Path, dataset: str, *,
    labels: Path | None = None, config: str | None = None, seed: int = 0, workers: int = 1, dry_run: bool = False,
    retry_failed: bool = False,
) -> DatasetImport:  # fmt: skip
    """Import a finished dataset under a name. Scenes of it that are no longer in the folder stay in the lake.

    Raises:
        InputError: the folder holds no such dataset, or the name is none, or that of scans which the lake captured itself.
    """
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", dataset):
        raise InputError("--dataset", dataset, "is no name for a dataset", "use up to 64 letters, digits, and _ . - after the first")
    sources = find_sources(kind, folder, dataset, labels, config)
    history = lake.history()
    _check_name(history, sources, dataset)
    reading, hashes, code = IngestionConfig(), FileHashes(), code_fingerprint("tasks.ingestion.reading")
    jobs: list[_Job] = []
    imports: dict[str, SceneImport] = {}
    for source in sources:
        job = _Job(lake.address, source, reading, seed, _content(source, hashes), code, 1)
        state = history.get((source.scene_id, "capture"))
        plan = _plan(state, job, retry_failed)
        imports[source.scene_id] = plan
        if plan.action == "import":
            same = state is not None and state.last.fingerprint == _fingerprint(job, "capture")
            jobs.append(dataclasses.replace(job, attempt=state.last.attempt + 1 if state is not None and same else 1))
    hashes.save()
    if not dry_run:
        staged = [scene for scene in imports if (state := history.get((scene, "capture"))) is not None and state.is_staged]
        for imported in _imported(lake, jobs, staged, workers, f"import of the {kind} dataset {dataset}"):
            imports[imported.scene_id] = dataclasses.replace(imported, why=imports[imported.scene_id].why)
    return DatasetImport(dataset, kind, tuple(imports[source.scene_id] for source in sources))


def _imported(lake: Lake, jobs: Sequence[_Job], staged: Sequence[str], workers: int, note: str) -> list[SceneImport]:
    """Run the jobs, commit now and then; what a killed import staged before is committed too."""
    done: list[SceneImport] = []
    waiting = list(staged)
    spread = spread_over(min(workers, len(jobs)))
    with Progress("scenes", len(jobs)) as progress:
        for start in range(0, len(jobs), _BATCH):
            batch = jobs[start : start + _BATCH]
            step = max(workers, 1) * 2
            for first in range(0, len(batch), step):
                for scene in spread(import_scene, batch[first : first + step]):
                    done.append(scene)
                    progress.advance(scene.scene_id)
            lake.commit(note, scenes=[*waiting, *(job.source.scene_id for job in batch)])
            waiting = []
    if waiting:
        lake.commit(note, scenes=waiting)
    return done


def import_scene(job: _Job) -> SceneImport:
    """Read a scene and stage its rows; a failure is staged as a row too. Runs in a worker process.

    What the lake has no room for is said and leaves no row: the next command tries it again.
    """
    try:
        return _read_and_staged(job)
    except Exception as error:
        text = str(error) if isinstance(error, LakeError) else f"{type(error).__name__}: {one_line(error)[:500]}"
        return SceneImport(job.source.scene_id, "import", "failed", error=text)


def _read_and_staged(job: _Job) -> SceneImport:
    lake = Lake.open(job.lake)
    started, clock = datetime.now(UTC), time.perf_counter()
    scene_id = job.source.scene_id
    context = Context(scene_id=scene_id, stage="ingestion", seed=job.seed, blobs=lake.blobs, caches=ModuleCaches())
    try:
        outcomes = ingest(job.source, context, job.config)
        navigation = navigation_rows(job.source, job.config)
        if navigation is not None:
            outcomes["navigation"] = navigation
        for outcome in outcomes.values():
            _keep(lake, outcome, scene_id)
    except Exception as problem:
        text = str(problem) if isinstance(problem, LakeError) else f"{type(problem).__name__}: {one_line(problem)[:500]}"
        if is_away(problem) or number_of(problem) in NO_ROOM:  # it passes, and is none of the scene's own
            return _failed(lake, job, started, clock, text, "lost")
        return _failed(lake, job, started, clock, text, "input" if isinstance(problem, InputError) else "defect")
    # The first stage last: once it is staged the scene counts as done, so all that belongs to it must be there.
    for stage in reversed([name for name in _READS if name in outcomes]):
        outcome = outcomes[stage]
        run = _run(job, stage, started, time.perf_counter() - clock if stage == "capture" else 0.0)
        counts = tuple(f"{table}={len(rows)}" for table, rows in sorted(outcome.rows.items()))
        upstream = tuple(f"{name}={_fingerprint(job, name)}" for name in _READS[stage])
        run = dataclasses.replace(run, row_counts=counts, degradations=outcome.degradations, upstream=upstream)
        lake.stage_rows(run, outcome.rows)
    notes = tuple(note for outcome in outcomes.values() for note in outcome.degradations)
    return SceneImport(scene_id, "import", "imported", len(outcomes["capture"].rows["instances"]), notes)


def _keep(lake: Lake, outcome: Outcome, scene_id: str) -> None:
    """Hold rows against their schemas, and keep the blobs that they name."""
    named: set[str] = set()
    for table, rows in outcome.rows.items():
        check(rows, TABLES[table].record)
        if TABLES[table].grain == "scene" and any(row.scene_id != scene_id for row in rows):
            raise LakeError(f"{table}: rows of another scene than {scene_id}")
        named.update(getattr(row, c) for row in rows for c in TABLES[table].blob_columns if getattr(row, c))
    lake.blobs.put_all({name: outcome.blobs[name] for name in sorted(named)})


def _failed(lake: Lake, job: _Job, started: datetime, clock: float, error: str, kind: str) -> SceneImport:
    run = _run(job, "capture", started, time.perf_counter() - clock)
    lake.stage_rows(dataclasses.replace(run, outcome="lost" if kind == "lost" else "failed", error=error, error_kind=kind), {})
    return SceneImport(job.source.scene_id, "import", "failed", error=error)


def _run(job: _Job, stage: str, started: datetime, seconds: float) -> StageRun:
    """The row of `stage_runs` of a stage that an import stands for. Its config says that it was an import."""
    return StageRun(
        scene_id=job.source.scene_id,
        stage=stage,
        fingerprint=_fingerprint(job, stage),
        attempt=job.attempt,
        outcome="done",
        upstream=(),
        reasons=tuple(f"{name}={value}" for name, value in _reasons(job).items()),
        config=_config_json(job),
        row_counts=(),
        degradations=(),
        error=None,
        error_kind=None,
        started_at=started,
        seconds=seconds,
        host=f"{socket.gethostname()}:{os.getpid()}",
        peak_memory_mb=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        snapshot_id=0,
    )


def _reasons(job: _Job) -> dict[str, str]:
    """Parts of the fingerprint, by name. An import is known by the first."""
    return {"import": job.source.kind, "scan": job.content, "config": digest(_config_json(job)), "code": job.code, "seed": str(job.seed)}


def _config_json(job: _Job) -> str:
    settings: dict[str, Any] = {"import": job.source.kind, **canonical(job.config)}
    return canonical_json(settings)


def _fingerprint(job: _Job, stage: str) -> str:
    """What a stage's rows follow from: the scene's files and what its dataset says of it, config, code and seed."""
    return digest("import-1", stage, job.content, _config_json(job), job.code, str(job.seed))


def _content(source: Source, hashes: FileHashes) -> str:
    """Hash of all that a scene is read from."""
    problem = str(source.problem) if source.problem is not None else ""
    try:
        files = hashes.tree(source.root, source.files)
    except OSError as error:  # reading it again will say which file and why
        files = f"unreadable: {error}"
    return digest(files, canonical_json(dict(source.about)), problem)


def _plan(state: StageState | None, job: _Job, retry_failed: bool) -> SceneImport:
    """What to do with a scene, and why."""
    scene_id, fingerprint = job.source.scene_id, _fingerprint(job, "capture")
    if state is None:
        return SceneImport(scene_id, "import", "never imported")
    if state.done is not None and state.done.fingerprint == fingerprint:
        counts = dict(part.split("=", 1) for part in state.done.row_counts)
        return SceneImport(scene_id, "reuse", "unchanged", int(counts.get("instances", 0)))
    last = state.last
    if last.fingerprint == fingerprint and last.outcome == "failed" and not retry_failed:
        why = "failed before on the same files (--retry-failed reads them again)"
        return SceneImport(scene_id, "report", why, error=last.error or "failed")
    if last.fingerprint == fingerprint:
        return SceneImport(scene_id, "import", f"{last.outcome} before")
    before = dict(part.split("=", 1) for part in (state.done or last).reasons)
    changed = [name for name, value in _reasons(job).items() if before.get(name) != value]
    return SceneImport(scene_id, "import", f"{', '.join(changed)} changed")


def _check_name(history: Mapping[Key, StageState], sources: Sequence[Source], dataset: str) -> None:
    """Refuse the name of scans that were captured here: an import would take their scenes' place."""
    prefix = sources[0].scene_id.partition("/")[0] + "/"
    for (scene, stage), state in sorted(history.items()):
        run = state.done or state.last
        if stage == "capture" and scene.startswith(prefix) and not any(part.startswith("import=") for part in run.reasons):
            raise InputError("--dataset", dataset, f"is the dataset of {scene}, which was captured here", "give the import another name")
