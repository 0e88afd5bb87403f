"""What must hold of a lake after any disturbance, held against the lake of an undisturbed run of the same scans."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from schemas.runs import StageRun
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.tables.digest import digests
from warehouse.tables.snapshot import Reader
from warehouse.upkeep.inspection import inspect

Finished = dict[tuple[str, str], tuple[str, str]]
"""Of every finished (scene, stage): its fingerprint, and when and where it was computed."""

_LEFTOVERS = ("staged", "tmp", "claims", "runs")


@dataclasses.dataclass(frozen=True)
class LakeVerdict:
    """What is wrong with a lake; empty where nothing is.

    different: tables whose rows are not those of the undisturbed run. doubled: tables in which a key stands twice.
    computed_twice: (scene, stage) that more than one run finished. leftovers: files of runs that are over.
    unnamed_blobs: blob files that the undisturbed lake does not have. findings: what `metascenes doctor lake` says.
    """

    different: tuple[str, ...]
    doubled: tuple[str, ...]
    computed_twice: tuple[str, ...]
    leftovers: tuple[str, ...]
    unnamed_blobs: tuple[str, ...]
    findings: tuple[str, ...]

    @property
    def faults(self) -> int:
        """How many faults there are."""
        return sum(len(getattr(self, field.name)) for field in dataclasses.fields(self))


def verdict_on(lake: Lake, undisturbed: Lake) -> LakeVerdict:
    """Hold a local lake against a local lake of the same scans."""
    reader = lake.snapshot()
    result, wanted = digests(reader), digests(undisturbed.snapshot())
    return LakeVerdict(
        different=tuple(sorted(name for name in {*result, *wanted} if result.get(name) != wanted.get(name))),
        doubled=tuple(_doubled(reader)),
        computed_twice=tuple(_computed_twice(reader.rows(StageRun))),
        leftovers=tuple(_files(Path(lake.address), _LEFTOVERS)),
        unnamed_blobs=tuple(sorted(set(_files(Path(lake.address), ["blobs"])) - set(_files(Path(undisturbed.address), ["blobs"])))),
        findings=tuple(str(finding) for finding in inspect(lake).findings),
    )


def finished(lake: Lake) -> Finished:
    """What is finished in a lake, committed or staged."""
    states = lake.history()
    return {key: (s.done.fingerprint, f"{s.done.started_at.isoformat()} {s.done.host}") for key, s in states.items() if s.done is not None}


def _doubled(reader: Reader) -> Iterable[str]:
    """Tables with a key that stands in more than one row."""
    for table in TABLES.values():
        rows = reader.arrow(table.name).select(list(table.key)).to_pylist()
        if len({tuple(row.values()) for row in rows}) != len(rows):
            yield table.name


def _computed_twice(runs: Iterable[StageRun]) -> Iterable[str]:
    """Stages of scenes that were finished more than once on the same input."""
    counts = Counter((run.scene_id, run.stage, run.fingerprint) for run in runs if run.outcome == "done")
    return (f"{scene} {stage}: {count} times" for (scene, stage, _), count in sorted(counts.items()) if count > 1)


def _files(root: Path, folders: Iterable[str]) -> list[str]:
    return sorted(path.relative_to(root).as_posix() for name in folders for path in (root / name).rglob("*") if path.is_file())
