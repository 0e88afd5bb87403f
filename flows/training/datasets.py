"""What is learned from: one snapshot or release of a lake, as streams of rows."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from functools import cached_property
from typing import TypeVar

import pyarrow as pa
import pyarrow.compute as pc

from flows.run.fingerprints import digest
from schemas.annotation import Annotation
from schemas.errors import InputError
from schemas.record import Table, arrow_to_rows, table_of
from schemas.tables import TABLES
from schemas.text import cut
from tasks.settings import nearest
from warehouse.lake import Lake
from warehouse.release import snapshot_of
from warehouse.tables.adoption import SCENE_STAGES
from warehouse.tables.history import states
from warehouse.tables.reviews import standing_answers
from warehouse.tables.snapshot import Reader

R = TypeVar("R")

SCENES_AT_ONCE = 32
"""Scenes whose rows are read in one go: files are opened once for all of them, and few rows are in memory."""

ROWS_AT_ONCE = 4096
"""Rows that are records at one time, of tables without scenes."""


def named_dataset(scene_id: str) -> str:
    """The dataset that a scene is of: the first part of its name."""
    return scene_id.partition("/")[0]


class LakeDataset:
    """A `tasks.training.dataset.Dataset` over a snapshot.

    release: Name of the release that it is; None where none was named. datasets: Of the lake, whose scenes alone it has; none: all.
    """

    def __init__(self, reader: Reader, release: str | None = None, datasets: Collection[str] = ()) -> None:
        self.reader, self.release, self.datasets = reader, release, sorted({*datasets})
        of = f": {'+'.join(self.datasets)}" if self.datasets else ""
        self.name = (f"release {release}" if release else f"snapshot {reader.snapshot_id}") + of

    @property
    def snapshot_id(self) -> int:
        """The snapshot that it is, by number."""
        return self.reader.snapshot_id

    def rows(self, record: type[R]) -> Iterator[R]:
        """Rows of a record type, in the order of its key, some scenes at a time; see `tasks.training.dataset.Dataset`."""
        table = table_of(record)
        if record is Annotation:
            yield from self._answers()  # type: ignore[misc]
        elif table.key[0] == "scene_id" and table.rule == "replace":
            for first in range(0, len(self._scenes), SCENES_AT_ONCE):
                part = self._scenes[first : first + SCENES_AT_ONCE]
                yield from _records(self.reader.matching(table.name, {"scene_id": part}), table)
        else:
            yield from _records(self._own(self.reader.arrow(table.name)), table)

    def fingerprint(self, tables: Sequence[str]) -> str:
        """Hash of the runs that wrote the rows of some tables: the same rows have the same one, in whatever snapshot or release, and
        whether the datasets that they are of were named or are all that there are.

        Raises:
            InputError: no run did: there is nothing to learn from.
        """
        stages = {TABLES[table].stage for table in tables}
        runs = self.reader.arrow("stage_runs")
        wrote = [(run.scene_id, run.stage, run.fingerprint) for run in (state.done for state in states(runs).values()) if run is not None]
        wrote = [run for run in wrote if run[1] in stages & set(SCENE_STAGES) and self._has(run[0])]
        batches = runs.filter(pc.equal(runs.column("outcome"), "done")).select(["scene_id", "stage", "fingerprint"]).to_pylist()
        wrote += [(row["scene_id"], row["stage"], row["fingerprint"]) for row in batches if row["stage"] in stages - set(SCENE_STAGES)]
        if not wrote:
            raise InputError(self.name, ", ".join(tables), "there is nothing to learn from", "`metascenes run` makes rows, of scans")
        return digest("dataset-1", *("|".join(run) for run in sorted(set(wrote))))

    @cached_property
    def _scenes(self) -> list[str]:
        """Scenes of the snapshot, sorted."""
        return sorted(scene for scene in scenes_of(self.reader) if self._has(scene))

    def _has(self, scene_id: str) -> bool:
        """Whether a scene is of the chosen datasets."""
        return not self.datasets or named_dataset(scene_id) in self.datasets

    def _own(self, rows: pa.Table) -> pa.Table:
        """Rows that name no scene, or one of the chosen datasets."""
        if not self.datasets or "scene_id" not in rows.column_names:
            return rows
        return rows.filter(pa.array([self._has(scene) for scene in rows.column("scene_id").to_pylist()], pa.bool_()))

    def _answers(self) -> Iterator[Annotation]:
        """Answers that count, and those of simulated annotators, each once, in the order of the key."""
        every = self.reader.arrow("annotations")
        simulated = every.filter(pc.equal(pc.fill_null(every.column("is_simulated"), False), True))
        rows = arrow_to_rows(self._own(pa.concat_tables([standing_answers(self.reader), simulated])), Annotation)
        key = TABLES["annotations"].key
        last = {tuple(getattr(row, name) for name in key): row for row in rows}
        yield from (last[each] for each in sorted(last))


def _records(rows: pa.Table, table: Table) -> Iterator[R]:
    """Rows as records, some at a time."""
    for first in range(0, rows.num_rows, ROWS_AT_ONCE):
        yield from arrow_to_rows(rows.slice(first, ROWS_AT_ONCE), table.record)


def scenes_of(reader: Reader) -> list[str]:
    """Scenes of a snapshot."""
    names: list[str] = reader.matching("scenes", {}, ["scene_id"]).column("scene_id").unique().to_pylist()
    return names


def check_datasets(reader: Reader, datasets: Collection[str], field: str) -> None:
    """Refuse datasets that a snapshot has no scene of. `field` is what names them. Raises `InputError`."""
    known = sorted({named_dataset(scene) for scene in scenes_of(reader)})
    for name in datasets:
        if name not in known:
            remedy = nearest(name, known, "the lake has") if known else "`metascenes run` makes scenes"
            raise InputError(field, cut(name), "is no dataset of the lake", remedy)


def chosen_dataset(
    lake: Lake, snapshot_id: int | None = None, release: str | None = None, datasets: Collection[str] = ()
) -> LakeDataset:  # fmt: skip
    """The dataset of a release, of a snapshot, or of the newest snapshot, or what these have of some datasets.

    Raises:
        InputError: there is no such release, snapshot or dataset, both are named, or the lake has no snapshot yet.
    """
    reader = lake.snapshot(snapshot_of(lake, release, snapshot_id))
    if reader.snapshot is None:
        raise InputError(lake.address, "snapshot", "the lake has none yet", "`metascenes run` makes one")
    check_datasets(reader, datasets, "training.datasets")
    return LakeDataset(reader, release, datasets)
