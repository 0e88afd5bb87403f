"""Releases without an erased scene: their folders are written anew from their snapshots, which have forgotten it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

from warehouse.lake import Lake
from warehouse.release import rewrite_release
from warehouse.sharing.lease import Lease
from warehouse.tables.released import FOLDER, folder_of, released
from warehouse.upkeep.erasure.plan import ErasurePlan
from warehouse.upkeep.erasure.proof import search


def erase_from_releases(lake: Lake, plan: ErasurePlan, lease: Lease, advance: Callable[[str], None] = lambda what: None) -> None:
    """Write the folders of releases anew that tell of the plan's scene; remove folders of releases that were never finished.

    A release says when something was erased from it, and not what. Holds the lake's lease.
    """
    known = released(lake.storage)
    for folder in set(lake.storage.folders(FOLDER)) - {release.name for release in known}:
        lease.check()
        for entry in list(lake.storage.walk(folder_of(folder))):
            lake.storage.remove(entry.path)
    for release in known:
        if release.name in plan.releases or search(lake.storage, plan.traces, folder=folder_of(release.name)).hits:
            # The plan's time, so that who was killed here says it once.
            erased_at = tuple(sorted({*release.erased_at, plan.started_at.isoformat()}))
            notes = plan.traces.redacted(release.notes)
            rewrite_release(lake, dataclasses.replace(release, notes=notes, erased_at=erased_at), lease.check)
            advance(folder_of(release.name))
