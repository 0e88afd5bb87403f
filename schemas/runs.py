"""Rows that the lake keeps about itself: executions of stages, refused scans, snapshots, and releases."""

from __future__ import annotations

from datetime import datetime

from schemas.record import column, record

RELEASE_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]*"


@record("stage_runs", key=("scene_id", "stage", "fingerprint", "attempt"), stage="", rule="append", grain="lake")
class StageRun:
    """One execution of a stage on a scene (on a batch: scene_id holds it)."""

    scene_id: str = column("Scene, or batch for stages that work on batches")
    stage: str = column("Stage")
    fingerprint: str = column("Hash of inputs, config, code and model versions", pattern=r"[0-9a-f]{64}")
    attempt: int = column("Attempt at this fingerprint, from 1", minimum=1, volatile=True)
    outcome: str = column("What came of it", values=("done", "failed", "lost", "withdrawn"))
    upstream: tuple[str, ...] = column("Stages whose rows were read, as <stage>=<fingerprint>")
    reasons: tuple[str, ...] = column("Parts of the fingerprint as <part>=<hash>: inputs, config, code, seed")
    config: str = column("Config as canonical JSON")
    row_counts: tuple[str, ...] = column("Rows written, as <table>=<count>")
    degradations: tuple[str, ...] = column("What had to be left out or done by a fallback")
    error: str | None = column("One line: file, field, problem, remedy")
    error_kind: str | None = column("Kind of failure", values=("input", "defect", "lost", "timeout"))
    started_at: datetime = column("Start", volatile=True)
    seconds: float = column("Wall time", unit="s", minimum=0, volatile=True)
    host: str = column("Host and process that ran it", volatile=True)
    peak_memory_mb: float = column("Peak resident memory of the worker", unit="MB", minimum=0, volatile=True)
    snapshot_id: int = column("Snapshot that it was committed in", minimum=0, volatile=True)


@record("refused_scans", key=("scans", "path"), stage="", grain="lake")
class RefusedScan:
    """A scan that the last run over its folder could not use. A run over the repaired scan removes the row."""

    scans: str = column("Folder of scans, absolute, or address in a store")
    path: str = column("The scan's folder or file, as a path from the folder of scans")
    format: str | None = column("Scan format that it seems to have; missing if it looks like none")
    field: str = column("Wrong part: folder, file, name, a field of a file, ...")
    reason: str = column("Problem and remedy, in a line")
    first_seen_at: datetime = column("Start of the first run that refused it for this reason", volatile=True)
    last_seen_at: datetime = column("Start of the last run that refused it", volatile=True)


@record("snapshots", key=("snapshot_id",), stage="", rule="append", grain="lake")
class Snapshot:
    """A consistent state of all tables."""

    snapshot_id: int = column("Snapshot, from 1", minimum=1, volatile=True)
    created_at: datetime = column("When it was committed", volatile=True)
    tables: tuple[str, ...] = column("Version of every table, as <table>=<version>", volatile=True)
    note: str = column("What it was committed for", volatile=True)


@record("releases", key=("name",), stage="", rule="append", grain="lake")
class Release:
    """A named snapshot that is kept for good. Its folder `releases/<name>/` says the same in `release.json`."""

    name: str = column("Name, as it is cited", pattern=RELEASE_PATTERN)
    snapshot_id: int = column("Snapshot that it names", minimum=1, volatile=True)
    created_at: datetime = column("When it was released", volatile=True)
    notes: str = column("What it was released for", volatile=True)
    code_version: str = column("Version of the project that released it", volatile=True)
    scenes: int = column("Scenes", minimum=0)
    rooms: int = column("Physical rooms, or dwellings of several, that the scenes show: one for each room_id", minimum=0)
    objects: int = column("Instances that are not part of the building", minimum=0)
    categories: int = column("Categories of these instances", minimum=0)
    assets: int = column("Assets", minimum=0)
    placed_objects: int = column("Instances with an asset in their place", minimum=0)
    episodes: int = column("Navigation episodes", minimum=0)
    row_counts: tuple[str, ...] = column("Rows of every table, as <table>=<count>", volatile=True)
    erased_at: tuple[str, ...] = column("When something was erased from it, ISO 8601", volatile=True)
