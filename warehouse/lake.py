"""The lake: tables, blobs, snapshots and the history of what was run.

Workers stage, one committer commits, readers read snapshots:

    lake = Lake.open("lake")
    lake.stage_rows(run, {"captions": rows})
    lake.commit("captions of one scene")
    lake.snapshot().rows(Caption, scene_id="scannet/scene0001_00")
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from schemas.calls import ModelCall
from schemas.errors import InputError, RecordError
from schemas.parsing import json_value
from schemas.runs import RefusedScan, Snapshot, StageRun
from schemas.tables import TABLES
from warehouse.sharing.claims import Claim, Claims, claims_of, sweep_claims
from warehouse.sharing.lease import Lease
from warehouse.sharing.looks import Looks
from warehouse.sharing.presence import LiveRun, Presence, runs_of, sweep_runs
from warehouse.sharing.writer import writer_of
from warehouse.storage.blobs import BlobStore
from warehouse.storage.files import TEMPORARY, Storage, storage_at
from warehouse.storage.workplace import sweep_workplaces
from warehouse.tables.adoption import overlaid, plan
from warehouse.tables.calls import PendingCalls
from warehouse.tables.commit import Commit
from warehouse.tables.delta import DeltaTables
from warehouse.tables.history import Key, StageState, naming, states
from warehouse.tables.outline import COLUMNS as OUTLINE_COLUMNS
from warehouse.tables.outline import Outline, outline_of
from warehouse.tables.snapshot import Reader
from warehouse.tables.staging import Staging, is_left_over

MARKER = "lake.json"
DRAFT_FOLDER = "drafts"
"""What annotators have begun and not saved, and tokens of who they are; those who serve batches keep it. Backups leave it out."""

FORMAT = 1


class Lake:
    """A lake at a local folder or an S3 prefix. Can be pickled: it is its address.

    `storage`, `tables`, `staging` and `calls` are for the other modules of the warehouse.
    """

    def __init__(self, storage: Storage) -> None:
        self.storage = storage
        self.tables = DeltaTables(storage)
        self.staging = Staging(storage)
        self.calls = PendingCalls(storage, self._prepare)
        self._is_marked = False
        self._called: tuple[str, Reader, frozenset[str]] | None = None  # by a commit: its snapshot, and the calls that it has
        self.blobs = BlobStore(storage, self._prepare)

    @classmethod
    def open(cls, address: str | Path) -> Lake:
        """The lake at an address. Nothing is created before the first write.

        Raises:
            InputError: the address cannot hold a lake, or a newer version of the project made it.
        """
        lake = cls(storage_at(address))
        lake._read_marker()
        return lake

    @classmethod
    def existing(cls, address: str | Path, field: str = "lake") -> Lake:
        """The lake that is at an address already: a mistyped one must not look like an empty lake. `field` names it in the error.

        Raises:
            InputError: there is none, or as `open`.
        """
        lake = cls.open(address)
        if not lake.exists:
            raise InputError(str(address), field, "there is no lake", "name its folder; `metascenes run` makes one")
        return lake

    def __reduce__(self) -> tuple[Any, ...]:
        return (Lake.open, (self.address,))

    @property
    def address(self) -> str:
        """Folder (absolute) or `s3://` address."""
        return self.storage.address

    @property
    def exists(self) -> bool:
        """Whether anything was ever written."""
        return self._is_marked or self._read_marker()

    def stage_rows(self, run: StageRun, rows: Mapping[str, Sequence[Any]] | None = None) -> None:
        """Leave a run and its rows for the committer: each table whole or not at all, the run's own row last.

        Raises:
            RecordError: a row breaks its schema, belongs to another scene, or names a blob that is not in the lake.
            LakeError: a table belongs to another stage, or a run that is not done has rows.
        """
        self._prepare()
        self._check_blobs(rows or {})
        self.staging.stage(run, rows or {})

    def unstage(self, run: StageRun) -> None:
        """Take back what was staged of a run by who staged it, while nobody else commits its scene; nothing where it is gone."""
        key = (run.scene_id, run.stage, run.started_at)
        own = [staged for staged in self.staging.runs() if (staged.run.scene_id, staged.run.stage, staged.run.started_at) == key]
        self.staging.remove(own)

    def staged_rows(self, table: str, scene_id: str, fingerprint: str) -> list[Any] | None:
        """Rows of the newest complete staged run with a fingerprint; None when none is staged (it may be committed)."""
        return self.staging.rows(table, scene_id, fingerprint)

    def rows_of(self, table: str, scene_id: str, fingerprint: str) -> list[Any] | None:
        """Rows that a run with a fingerprint gave, staged or in the last snapshot; None when they are in neither."""
        staged = self.staged_rows(table, scene_id, fingerprint)
        if staged is not None:
            return staged
        reader = self.snapshot()
        committed = self._committed(reader, [scene_id]).get((scene_id, TABLES[table].stage))
        if committed is None or committed.done is None or committed.done.fingerprint != fingerprint:
            return None
        return reader.rows(TABLES[table].record, scene_id)

    def commit(
        self, note: str = "", *, scenes: Collection[str] | None = None, runs: Collection[str] | None = None, timeout: float = 300.0
    ) -> Snapshot | None:
        """Take everything that is staged, by anyone, into a new snapshot; None when there is nothing to take.

        With `scenes`, only what is staged for these, nothing for an empty collection: a scene that is still being
        computed would be taken in part, and what its next stages gave before would be withdrawn for the time being.
        A run of the pipeline gives its own scenes and those that are `abandoned`. With `runs`, only staged runs with these
        tokens: who saw a scene complete may find it begun anew by the time that the lease is free.

        Raises:
            LeaseError: another committer holds the lease for more than `timeout` seconds.
        """
        return self._commit(note, (), scenes, timeout, runs)

    def refuse_scans(self, scans: str, rows: Sequence[RefusedScan], note: str = "", *, timeout: float = 300.0) -> Snapshot:
        """Keep these rows of `refused_scans`, and no others, of the folder of scans `scans`.

        Raises:
            RecordError: a row breaks its schema.
            LeaseError: another committer holds the lease for more than `timeout` seconds.
        """
        self._prepare()
        with self.leased(timeout) as lease:
            return Commit(self.tables, self.staging, lease, self.calls).refuse(scans, rows, note)

    def remove_scene(self, scene_id: str, *, timeout: float = 300.0) -> Snapshot | None:
        """Withdraw everything that was computed of a scene; None when there is nothing. Annotations stay: people made them."""
        return self._commit(f"remove {scene_id}", (scene_id,), (scene_id,), timeout)

    def sweep(self, keep: Collection[tuple[str, str, str]] = (), *, timeout: float = 300.0) -> None:
        """Remove leftovers: temporary and staged files and claims of dead processes, and runs that cannot be adopted.

        `keep` names (scene, stage, fingerprint) that may still be adopted. What other living processes staged stays,
        and so do files whose names give no writer.
        """
        if not self.exists:
            return
        with self.leased(timeout) as lease:
            Commit(self.tables, self.staging, lease, self.calls).sweep(keep)
            self.calls.sweep()
            self.sweep_temporary()
            sweep_claims(self.storage)
            sweep_runs(self.storage)

    def sweep_temporary(self) -> None:
        """Remove the temporary files and folders of dead writers, and those of table writes. Only while the lease is held."""
        for entry in self.storage.entries(TEMPORARY):
            if is_left_over(writer_of(entry.path.rpartition("/")[2]), entry.modified):
                self.storage.remove(entry.path)
        place = self.storage.local_path(TEMPORARY)
        if place is not None:
            sweep_workplaces(place)
        self.tables.sweep()

    def abandoned(self) -> set[str]:
        """Scenes whose complete staged runs have no living writer: only the commit of another run adopts them.

        A writer on another machine cannot be asked and is taken to live for a day after its run.
        """
        staged = self.staging.runs()
        return {run.run.scene_id for run in staged} - {run.run.scene_id for run in staged if not run.is_abandoned}

    def last_commit(self) -> str:
        """A cheap sign of whether there is a new snapshot: it changes with every one."""
        return max((name for name in self.storage.names("tables/snapshots/_delta_log") if name.endswith(".json")), default="")

    def has_staged(self, scene_id: str) -> bool:
        """Whether anything of a scene is staged, by anyone, whole or not."""
        return self.staging.has(scene_id)

    def history(self, scenes: Collection[str] | None = None) -> dict[Key, StageState]:
        """The state of every (scene, stage), staged runs that a commit would take included; of `scenes` when they are given."""
        current = self._committed(self.snapshot(), scenes)
        staged = [run for run in self.staging.runs() if scenes is None or run.run.scene_id in scenes]
        return overlaid(current, plan(current, staged)) if staged else current

    def call(self, call_id: str) -> ModelCall | None:
        """A recorded call, committed or not; of one that was answered the first reply."""
        pending = self.calls.get(call_id)  # first: what is committed meanwhile is in the snapshot then
        stamp = self.last_commit()
        if self._called is None or self._called[0] != stamp:
            reader = self.snapshot()
            ids = self.tables.read(TABLES["model_calls"], reader.files("model_calls"), ["call_id"]).column("call_id").to_pylist()
            self._called = (stamp, reader, frozenset(ids))
        committed = self._called[1].rows_by_key(ModelCall, [call_id]) if call_id in self._called[2] else []
        if committed and (pending is None or committed[0].outcome == "answered"):
            return committed[0]
        return pending

    def recorded(self, stage: str, reasons: Collection[str]) -> dict[str, StageState]:
        """The state of a stage by scene, of the scenes where one of its runs recorded any of these `reasons`."""
        runs = self.tables.read(TABLES["stage_runs"], self.snapshot().files("stage_runs"), ["scene_id", "reasons"], {"stage": [stage]})
        scenes = naming(runs, reasons)
        scenes |= {
            run.run.scene_id for run in self.staging.runs() if run.run.stage == stage and not set(reasons).isdisjoint(run.run.reasons)
        }
        return {scene: state for (scene, name), state in self.history(scenes).items() if name == stage}

    def outline(self) -> Outline:
        """The history of all scenes in outline, for reports of the status; far cheaper than `history`."""
        staged = self.staging.runs()  # first: what is committed meanwhile is in the snapshot then
        runs = self.tables.read(TABLES["stage_runs"], self.snapshot().files("stage_runs"), OUTLINE_COLUMNS)
        states = self.history({run.run.scene_id for run in staged}) if staged else {}
        return outline_of(runs, states, [run.run for run in staged])

    def snapshot(self, snapshot_id: int | None = None) -> Reader:
        """A snapshot, the last one by default. A lake without snapshots reads as empty tables.

        Raises:
            InputError: there is no such snapshot.
        """
        return Reader(self.storage, self.tables, snapshot_id)

    def leased(self, timeout: float = 300.0) -> Lease:
        """The lake's lease: ``with lake.leased(): ...``. Who holds it is the only one that commits or removes anything."""
        return Lease(self.storage, timeout=timeout)

    def claims(self, life: float = 60.0) -> Claims:
        """The scenes that this run computes, so that others leave them to it: ``with lake.claims() as claims: ...``.

        A claim that is not renewed for `life` seconds may be taken over from another machine.
        """
        self._prepare()
        return Claims(self.storage, life)

    def claimed(self) -> dict[str, Claim]:
        """Who computes which scene now: the claims of living runs by scene."""
        return claims_of(self.storage)

    def presence(self, facts: Mapping[str, Any] | None = None) -> Presence:
        """Tell others that a run is at work: ``with lake.presence(facts) as presence: ...``; `facts` are fields of LiveRun."""
        self._prepare()
        return Presence(self.storage, facts)

    def live_runs(self) -> list[LiveRun]:
        """The runs that are at work, the oldest first."""
        return runs_of(self.storage)

    def looks(self, scans: str) -> Looks:
        """What watchers of the scans at an address remember."""
        return Looks(self.storage, scans, self._prepare)

    def _commit(
        self, note: str, removed: Collection[str], scenes: Collection[str] | None, timeout: float, runs: Collection[str] | None = None
    ) -> Snapshot | None:
        if not self.exists:
            return None
        from warehouse.upkeep.erasure.plan import read_plan

        with self.leased(timeout) as lease:
            begun = read_plan(self.storage)
            erased = begun.scene_id if begun else None
            return Commit(self.tables, self.staging, lease, self.calls, erased=erased).run(note, removed, scenes, runs)

    def _committed(self, reader: Reader, scenes: Collection[str] | None = None) -> dict[Key, StageState]:
        only = None if scenes is None else {"scene_id": scenes}
        return states(self.tables.read(TABLES["stage_runs"], reader.files("stage_runs"), only=only))

    def _check_blobs(self, rows: Mapping[str, Sequence[Any]]) -> None:
        for name, records in rows.items():
            for column in TABLES[name].blob_columns if name in TABLES else ():
                for index, row in enumerate(records):
                    value = getattr(row, column, None)
                    if value is not None and value not in self.blobs:
                        raise RecordError(name, str(index), column, f"must name a blob of the lake, got {value!r}")

    def _prepare(self) -> None:
        """Mark the address as a lake before the first write.

        Raises:
            InputError: the folder holds other files, or cannot be made.
        """
        if self.exists:
            return
        strangers = self._strangers()
        if strangers and not self._read_marker():
            raise InputError(self.address, "", f"this is no lake but holds other files ({strangers[0]}, ...)", "give a new or empty folder")
        self.storage.create(MARKER, json.dumps({"format": FORMAT}).encode())
        self._is_marked = True

    def _strangers(self) -> list[str]:
        """Files and folders that no lake holds before its marker. Temporary files of other writers, alive or dead, do not count."""
        names = [name for name in self.storage.folders("") if name != TEMPORARY]
        names += [name for name in self.storage.names("") if name != MARKER]
        inner = [*self.storage.folders(TEMPORARY), *(name for name in self.storage.names(TEMPORARY) if writer_of(name) is None)]
        return names + [f"{TEMPORARY}/{name}" for name in inner]

    def _read_marker(self) -> bool:
        """Whether the address is marked as a lake."""
        with contextlib.suppress(FileNotFoundError):
            try:
                version = int(json_value(self.storage.read(MARKER))["format"])
            except (ValueError, KeyError, TypeError):
                raise InputError(f"{self.address}/{MARKER}", "format", "cannot be read", "restore the file") from None
            if version > FORMAT:
                problem = f"the lake has format {version}, this version reads {FORMAT}"
                raise InputError(f"{self.address}/{MARKER}", "format", problem, "update the project")
            self._is_marked = True
        return self._is_marked
