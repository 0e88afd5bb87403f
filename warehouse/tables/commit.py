"""The commit: what is staged goes into all tables, one transaction per table, then into one snapshot.

The order of the steps is what makes a crash harmless. Until the snapshot's row is written, readers stay on the old
snapshot and the staged files are all still there; the next commit restores tables that ran ahead and does it again.
Once it is written, the staged files are only left over, and the next commit or sweep removes them first.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING

import pyarrow as pa
import pyarrow.compute as pc

from schemas.calls import ModelCall
from schemas.record import Table, arrow_to_rows, rows_to_arrow
from schemas.runs import RefusedScan, Snapshot, StageRun
from schemas.tables import TABLES
from warehouse.sharing.lease import Lease
from warehouse.sharing.writer import this_writer, writer_of
from warehouse.tables.adoption import ACROSS_STAGES, CommitPlan, committed_rows, now_utc, plan, without_faults
from warehouse.tables.calls import PendingCalls, merged
from warehouse.tables.delta import DeltaTables, TableWriter, nullable
from warehouse.tables.history import Key, StageState, base_of, read_elsewhere, states
from warehouse.tables.staging import StagedRun, Staging

if TYPE_CHECKING:
    from deltalake import DeltaTable

_ADOPTED = "adopted"

TABLES_AT_ONCE = 4
"""Tables that are written at a time: a store lets each of them wait, and a disk with two cores gains a third."""


@dataclasses.dataclass(frozen=True)
class Base:
    """What a commit starts from: the last snapshot's id and the version of every table."""

    snapshot_id: int
    versions: dict[str, int]


class Commit:
    """One commit, made while `lease` is held. It reads what it touches, so that its time hardly depends on the lake's size.

    erased: A scene whose erasure was begun and is not finished.
    """

    def __init__(
        self, tables: DeltaTables, staging: Staging, lease: Lease, calls: PendingCalls | None = None, erased: str | None = None
    ) -> None:
        self._tables, self._staging, self._lease, self._calls, self._erased = tables, staging, lease, calls, erased
        self._snapshots = TABLES["snapshots"]
        self._base = self._read_base()
        self._rows: dict[str, pa.Table] = {}
        self._files: dict[str, list[str]] = {}
        self._heads: dict[str, DeltaTable | None] = {}
        self._states: dict[Key, StageState] = {}
        self._done: set[Key] = set()

    def run(
        self, note: str, removed: Collection[str] = (), scenes: Collection[str] | None = None, runs: Collection[str] | None = None
    ) -> Snapshot | None:
        """Adopt, replace, withdraw, and append the snapshot; None when there is nothing to do."""
        staged = self._without_orphans(self.remove_adopted())
        staged = [staged_run for staged_run in staged if scenes is None or staged_run.run.scene_id in scenes]
        staged = [staged_run for staged_run in staged if runs is None or staged_run.token in runs]
        is_whole = scenes is None and runs is None  # else who commits has scenes in mind: calls alone are no reason for a snapshot
        if not staged and not removed and not (is_whole and self._calls is not None and self._calls.rows()):
            return None
        self._rows, faults = self._staging.taken([staged_run for staged_run in staged if staged_run.run.outcome == "done"])
        self._read_states({staged_run.run.scene_id for staged_run in staged} | set(removed))
        made = plan(self._states, without_faults(staged, faults), removed)
        unwanted = [staged_run for staged_run in made.left if staged_run.run.scene_id in removed]
        new, renewed, taken = self._new_calls() if is_whole or not made.is_empty else ([], [], [])
        if made.is_empty and not (new or renewed):
            self._staging.remove(unwanted)
            self._remove_calls(taken)
            return None
        versions = dict(self._base.versions)
        if new or renewed:
            versions["model_calls"] = self._write_calls(new, renewed)
        versions |= self._write_tables(made)
        if not made.is_empty:
            versions["stage_runs"] = self._write_runs(made)
        snapshot = self._append_snapshot(versions, note, [*made.adopted, *made.recorded])
        self._staging.remove([*made.adopted, *made.recorded, *unwanted])
        self._remove_calls(taken)
        return snapshot

    def refuse(self, scans: str, rows: Sequence[RefusedScan], note: str) -> Snapshot:
        """Put refused scans in the place of all that were refused in a folder of scans, and append the snapshot."""
        self.remove_adopted()
        table = TABLES["refused_scans"]
        writer = self._writer(table)
        writer.replace(rows_to_arrow(rows, RefusedScan), "scans", {scans})
        writer.compact()
        assert writer.version is not None
        return self._append_snapshot(dict(self._base.versions) | {table.name: writer.version}, note, [])

    def sweep(self, keep: Collection[tuple[str, str, str]]) -> None:
        """Remove staged runs that cannot be adopted and are not among `keep` (scene, stage, fingerprint).

        Those of other processes that live are spared: what they read may still be on its way.
        """
        staged = self.remove_adopted()
        self._read_states({staged_run.run.scene_id for staged_run in staged})
        left = plan(self._states, staged).left
        own = this_writer()  # lives, of course, but has said by `keep` what it needs
        idle = [staged_run for staged_run in left if staged_run.is_abandoned or writer_of(staged_run.token) == own]
        self._lease.check()
        self._staging.remove(
            [staged_run for staged_run in idle if (staged_run.run.scene_id, staged_run.run.stage, staged_run.run.fingerprint) not in keep]
        )
        self._staging.remove_incomplete()

    def remove_adopted(self) -> list[StagedRun]:
        """Remove staged runs that the last snapshot holds already (its commit died before it could); the others."""
        opened = self._tables.open("snapshots")
        facts = opened.history(1)[0] if opened is not None else {}
        self._lease.check()
        self._staging.remove_tokens(set(str(facts.get(_ADOPTED, "")).split()))
        return self._staging.runs()

    def _without_orphans(self, staged: list[StagedRun]) -> list[StagedRun]:
        """Remove what is staged of scenes that are based on one of which no run is known any more, since it was erased; the others.

        Who computed them began before the erasure and knows nothing of it.
        """
        bases = {base for staged_run in staged if (base := base_of(staged_run.run)) is not None}
        if not bases:
            return staged
        table = TABLES["stage_runs"]
        known = self._tables.read(table, self._base_files(table), ["scene_id"], {"scene_id": bases}).column("scene_id").unique().to_pylist()
        gone = bases - (set(known) - {self._erased})
        orphans = [staged_run for staged_run in staged if base_of(staged_run.run) in gone]
        self._lease.check()
        self._staging.remove(orphans)
        return [staged_run for staged_run in staged if staged_run not in orphans]

    def _read_base(self) -> Base:
        opened = self._tables.open("snapshots")
        # Kept as opened: the snapshot's row is only written if nobody wrote one since.
        self._opened_snapshots = opened
        # Kept as rows of Arrow: a lake of many commits has many, and only the last one is asked for anything.
        self._snapshot_rows = self._tables.read(self._snapshots, self._tables.files("snapshots", opened) if opened else [])
        ids = self._snapshot_rows.column("snapshot_id")
        newest = self._snapshot_rows.filter(pc.equal(ids, pc.max(ids)))
        last = next(iter(arrow_to_rows(newest, Snapshot)), None)
        return Base(last.snapshot_id if last else 0, versions_of(last) if last else {})

    def _read_states(self, scenes: Collection[str]) -> None:
        """Take in what was run on these scenes so far."""
        table = TABLES["stage_runs"]
        self._states = states(self._tables.read(table, self._base_files(table), only={"scene_id": {*scenes, *self._beside(scenes)}}))
        self._done = {key for key, state in self._states.items() if state.done is not None}

    def _beside(self, scenes: Collection[str]) -> set[str]:
        """Scenes that were held against others of these, or these against them: what was said of both goes with either."""
        runs = [staged_run.run for staged_run in self._staging.runs() if staged_run.run.stage in ACROSS_STAGES]
        if any(table.stage in ACROSS_STAGES and table.name in self._base.versions for table in TABLES.values()):
            table = TABLES["stage_runs"]
            runs += arrow_to_rows(self._tables.read(table, self._base_files(table), only={"stage": ACROSS_STAGES}), StageRun)
        named = [{run.scene_id, *(scene for scene, _ in read_elsewhere(run))} for run in runs]
        return {scene for group in named if not group.isdisjoint(scenes) for scene in group}

    def _base_files(self, table: Table) -> list[str]:
        """Files of a table in the version that the commit starts from. The table is opened once, for the writer as well."""
        version = self._base.versions.get(table.name)
        if version is not None and table.name not in self._files:
            head = self._heads[table.name] = self._tables.open(table.name)
            opened = head if head is not None and head.version() == version else self._tables.open(table.name, version)
            self._files[table.name] = self._tables.files(table.name, opened) if opened is not None else []
        return self._files.get(table.name, [])

    def _writer(self, table: Table) -> TableWriter:
        self._base_files(table)  # while the head is what the commit starts from
        head = self._heads.pop(table.name) if table.name in self._heads else self._tables.open(table.name)
        writer = self._tables.writer_from(table, head, self._lease.check)
        writer.start_from(self._base.versions.get(table.name))
        return writer

    def _write_tables(self, made: CommitPlan) -> dict[str, int]:
        """Bring all tables up to date that a plan touches, several at a time, since none waits for another; their versions."""
        stages = {staged_run.run.stage for staged_run in made.adopted} | {run.stage for run in made.withdrawn}
        touched = [table for table in TABLES.values() if table.stage in stages]
        sharing = {table.shared_by for table in TABLES.values() if table.shared_by}
        for table in TABLES.values():  # before any of them changes
            if table in touched or table.name in sharing:
                self._base_files(table)
        with ThreadPoolExecutor(TABLES_AT_ONCE, thread_name_prefix="tables") as threads:
            written = threads.map(lambda table: self._write_table(table, made), touched)
            return {table.name: version for table, version in zip(touched, written, strict=True) if version is not None}

    def _write_table(self, table: Table, made: CommitPlan) -> int | None:
        """Bring one table up to date; its version, None when it was not touched."""
        new = [staged_run for staged_run in made.adopted if staged_run.run.stage == table.stage]
        if table.rule == "replace":
            return self._replace(table, new, made)
        if table.rule == "append":
            return self._append(table, new)
        return self._share(table, new, made)

    def _replace(self, table: Table, new: Sequence[StagedRun], made: CommitPlan) -> int | None:
        """The scenes' (or libraries') new rows take the place of their old ones; withdrawn scenes' rows go."""
        old = {scene for scene, stage in self._done if stage == table.stage}
        changed = {staged_run.run.scene_id for staged_run in new} | {run.scene_id for run in made.withdrawn if run.stage == table.stage}
        rows = self._staged_rows(table, new)
        replaced = changed & old
        if not rows.num_rows and not (replaced and table.name in self._base.versions):
            return None
        writer = self._writer(table)
        if replaced:
            writer.replace(rows, table.owner, changed)
        else:
            writer.append(rows)
        writer.compact()
        return writer.version

    def _append(self, table: Table, new: Sequence[StagedRun]) -> int | None:
        """Rows are added; a row whose key is there already (a batch read again) takes its place."""
        rows = self._staged_rows(table, new)
        if not rows.num_rows:
            return None
        writer = self._writer(table)
        column = table.key[0]
        batches = set(rows.column(column).to_pylist())
        known = self._tables.read(table, writer.files, only={column: batches})
        merged = _newest(pa.concat_tables([known, rows]), table)
        if known.num_rows:
            writer.replace(merged, column, batches)
        else:
            writer.append(merged)
        writer.compact()
        return writer.version

    def _share(self, table: Table, new: Sequence[StagedRun], made: CommitPlan) -> int | None:
        """Rows about a key are kept as long as a row of `shared_by` of a scene with this stage names the key.

        Absent keys are inserted. A row that says something else than the one that is there takes its place: it was
        made by newer code or from a newer source, since the same input gives the same row.
        """
        sharing, column = TABLES[table.shared_by], table.key[0]
        rows = _newest(self._staged_rows(table, new), table)
        rows = rows.filter(
            pc.is_in(rows.column(column), value_set=self._named(table, sharing, made, {staged_run.run.scene_id for staged_run in new}))
        )
        lost = self._lost_keys(table, sharing, made)
        if not rows.num_rows and not lost:
            return None
        writer = self._writer(table)
        keys = rows.column(column).to_pylist()
        known = {*keys, *lost}
        before = {row[column]: row for row in self._tables.read(table, writer.files, only={column: known}).to_pylist()}
        changed = [key for key, row in zip(keys, rows.to_pylist(), strict=True) if before.get(key) != row]
        gone = lost & before.keys()
        fresh = rows.filter(pc.is_in(rows.column(column), value_set=pa.array(changed, pa.string())))
        if gone or before.keys() & set(changed):
            writer.replace(fresh, column, {*gone, *changed})
        elif changed:
            writer.append(fresh)
        writer.compact()
        return writer.version

    def _named(self, table: Table, sharing: Table, made: CommitPlan, scenes: Collection[str]) -> pa.Array:
        """Keys that rows of `sharing` name once this is committed, of those of `scenes` that have the stage of `table` then."""
        column = table.key[0]
        new = [staged_run for staged_run in made.adopted if staged_run.run.stage == sharing.stage]
        kept = self._with_stage(table, made, scenes)
        replaced = {staged_run.run.scene_id for staged_run in new} | {run.scene_id for run in made.withdrawn if run.stage == sharing.stage}
        old = self._tables.read(sharing, self._base_files(sharing), ["scene_id", column], {"scene_id": kept - replaced})
        fresh = self._staged_rows(sharing, new).select(["scene_id", column])
        fresh = fresh.filter(pc.is_in(fresh.column("scene_id"), value_set=pa.array(sorted(kept), pa.string())))
        return pa.concat_tables([old, fresh]).column(column).unique().drop_null()

    def _lost_keys(self, table: Table, sharing: Table, made: CommitPlan) -> set[str]:
        """Keys that the scenes of this commit named before, and that nobody names once it is made."""
        column, stages = table.key[0], {table.stage, sharing.stage}
        touched = {staged_run.run.scene_id for staged_run in made.adopted if staged_run.run.stage in stages}
        touched |= {run.scene_id for run in made.withdrawn if run.stage in stages}
        had = {scene for scene in touched if (scene, table.stage) in self._done}
        files = self._base_files(sharing)
        named_before = self._tables.read(sharing, files, [column], {"scene_id": had}).column(column).unique().drop_null()
        suspects = set(named_before.to_pylist()) - set(self._named(table, sharing, made, touched).to_pylist())
        if not suspects:
            return set()
        elsewhere = self._tables.naming(files, column, suspects, touched)
        if table.stage != sharing.stage and elsewhere.num_rows:
            other_scenes = set(elsewhere.column("scene_id").to_pylist())
            runs = self._tables.read(TABLES["stage_runs"], self._base_files(TABLES["stage_runs"]), only={"scene_id": other_scenes})
            having = sorted(scene for (scene, stage), state in states(runs).items() if stage == table.stage and state.done is not None)
            elsewhere = elsewhere.filter(pc.is_in(elsewhere.column("scene_id"), value_set=pa.array(having, pa.string())))
        return suspects - set(elsewhere.column(column).to_pylist())

    def _with_stage(self, table: Table, made: CommitPlan, scenes: Collection[str]) -> set[str]:
        """Those of `scenes` that have rows of the stage of `table` once this is committed."""
        kept = {scene for scene in scenes if (scene, table.stage) in self._done}
        kept |= {staged_run.run.scene_id for staged_run in made.adopted if staged_run.run.stage == table.stage} & set(scenes)
        return kept - {run.scene_id for run in made.withdrawn if run.stage == table.stage}

    def _remove_calls(self, paths: Sequence[str]) -> None:
        if self._calls is not None and paths:
            self._lease.check()
            self._calls.remove(paths)

    def _new_calls(self) -> tuple[list[ModelCall], list[ModelCall], list[str]]:
        """Rows of recorded calls that the snapshot does not have: those that are new, those that take the place of one without a reply; and
        the files that a snapshot with these needs no more. A reply stays as it was first."""
        pending = {path: call for path, call in self._calls.rows().items() if call.scene_id != self._erased} if self._calls else {}
        table = TABLES["model_calls"]
        ids = {call.call_id for call in pending.values()}
        rows = self._tables.read(table, self._base_files(table), only={"call_id": ids}) if ids else None
        had = {row.call_id: row for row in arrow_to_rows(rows, ModelCall)} if rows is not None else {}
        new, renewed = [], []
        for call_id in sorted(ids):
            before = had.get(call_id)
            calls = [call for call in pending.values() if call.call_id == call_id]
            if before is None:
                new.append(merged(calls))
            elif before.outcome != "answered":  # a commit that died may have taken failures in already
                later = [call for call in calls if call.outcome == "answered" or call.asked_at > before.asked_at]
                renewed += [merged([before, *later])] if later else []
        return new, renewed, list(pending)

    def _write_calls(self, new: Sequence[ModelCall], renewed: Sequence[ModelCall]) -> int:
        """Rows of calls are added; one that takes the place of a failure replaces it."""
        writer = self._writer(TABLES["model_calls"])
        if renewed:
            writer.replace(rows_to_arrow(renewed, ModelCall), "call_id", {call.call_id for call in renewed})
        if new:
            writer.append(rows_to_arrow(new, ModelCall))
        writer.compact()
        assert writer.version is not None
        return writer.version

    def _write_runs(self, made: CommitPlan) -> int:
        table = TABLES["stage_runs"]
        writer = self._writer(table)
        scenes = {staged_run.run.scene_id for staged_run in (*made.adopted, *made.recorded)} | {run.scene_id for run in made.withdrawn}
        known = self._tables.read(table, writer.files, ["scene_id", "stage", "fingerprint", "attempt"], {"scene_id": scenes})
        attempts: dict[tuple[str, str, str], int] = {}
        for row in known.to_pylist():
            key = (row["scene_id"], row["stage"], row["fingerprint"])
            attempts[key] = max(attempts.get(key, 0), row["attempt"])
        rows = committed_rows(made, attempts, self._base.snapshot_id + 1, now_utc())
        writer.append(rows_to_arrow(rows, StageRun))
        writer.compact()
        if writer.version is None:
            raise AssertionError("stage_runs has a version once it is written")
        return writer.version

    def _append_snapshot(self, versions: Mapping[str, int], note: str, adopted: Sequence[StagedRun]) -> Snapshot:
        """Write the snapshot that names these versions of tables: from then on they are what readers see."""
        snapshot = Snapshot(
            snapshot_id=self._base.snapshot_id + 1,
            created_at=now_utc(),
            tables=tuple(f"{name}={versions[name]}" for name in sorted(versions)),
            note=note,
        )
        self._write_snapshot(snapshot, adopted)
        return snapshot

    def rewrite_snapshots(self, kept: Sequence[Snapshot]) -> None:
        """Keep only these rows of `snapshots`."""
        writer = self._tables.writer_from(self._snapshots, self._opened_snapshots, self._lease.check)
        writer.rewrite(rows_to_arrow(kept, Snapshot))

    def _write_snapshot(self, snapshot: Snapshot, adopted: Sequence[StagedRun]) -> None:
        # The table is small and read by everybody first, so it is kept in one file.
        writer = self._tables.writer_from(self._snapshots, self._opened_snapshots, self._lease.check)
        tokens = " ".join(sorted(staged_run.token for staged_run in adopted))
        new = rows_to_arrow([snapshot], Snapshot).cast(self._snapshot_rows.schema)
        writer.rewrite(pa.concat_tables([self._snapshot_rows, new]), {_ADOPTED: tokens})

    def _staged_rows(self, table: Table, new: Sequence[StagedRun]) -> pa.Table:
        """Rows that the adopted runs left in a table, sorted by key, under the table's schema."""
        schema = nullable(table.arrow_schema)
        paths = [staged_run.files[table.name] for staged_run in new if table.name in staged_run.files]
        read = ((path, self._rows.get(path)) for path in paths)
        parts = [self._staging.read(path) if rows is None else rows for path, rows in read]
        data = pa.concat_tables(parts).cast(schema) if parts else schema.empty_table()
        return data.sort_by([(name, "ascending") for name in table.key])


def versions_of(snapshot: Snapshot) -> dict[str, int]:
    """Version of every table in a snapshot."""
    return {name: int(version) for name, _, version in (entry.partition("=") for entry in snapshot.tables)}


def _newest(rows: pa.Table, table: Table) -> pa.Table:
    """Rows with one per key, the last, in the order of the key."""
    keys = list(zip(*(rows.column(name).to_pylist() for name in table.key), strict=True))
    last = {key: index for index, key in enumerate(keys)}
    return rows.take(pa.array([last[key] for key in sorted(last)], pa.int64()))
