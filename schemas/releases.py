"""Rows about releases: named snapshots that are kept for good and can be cited."""

from __future__ import annotations

from datetime import datetime

from schemas.record import column, record

NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]*"


@record("releases", key=("name",), stage="", rule="append", grain="lake")
class Release:
    """A named snapshot that is kept for good. Its folder `releases/<name>/` says the same in `release.json`."""

    name: str = column("Name, as it is cited", pattern=NAME_PATTERN)
    snapshot_id: int = column("Snapshot that it names", minimum=1, volatile=True)
    created_at: datetime = column("When it was released", volatile=True)
    notes: str = column("What it was released for", volatile=True)
    code_version: str = column("Version of the project that released it", volatile=True)
    scenes: int = column("Scenes", minimum=0)
    rooms: int = column("Physical rooms that the scenes show", minimum=0)
    objects: int = column("Instances that are not part of the building", minimum=0)
    categories: int = column("Categories of these instances", minimum=0)
    assets: int = column("Assets", minimum=0)
    placed_objects: int = column("Instances with an asset in their place", minimum=0)
    episodes: int = column("Navigation episodes", minimum=0)
    row_counts: tuple[str, ...] = column("Rows of every table, as <table>=<count>", volatile=True)
    erased_at: tuple[str, ...] = column("When something was erased from it, ISO 8601", volatile=True)
