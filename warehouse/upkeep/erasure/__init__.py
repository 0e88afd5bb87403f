"""Erasure: a scene leaves the lake for good, with all that was ever kept of it, and the rest stays what it was.

New versions of all tables are written beside the old ones, one per snapshot that stays (releases and the last). They
share every data file that does not tell of the scene. One write of `snapshots` then puts them in force, and what only
the old versions needed is removed. Until that write readers see all of the scene, after it nothing.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Mapping, Sequence

from schemas.errors import InputError
from schemas.record import SCENE_PATTERN
from schemas.runs import Snapshot
from schemas.tables import TABLES
from warehouse.lake import Lake
from warehouse.sharing.claims import remove_claim, sweep_claims
from warehouse.sharing.lease import Lease
from warehouse.sharing.presence import sweep_runs
from warehouse.tables.adoption import SCENE_STAGES, now_utc
from warehouse.tables.commit import Commit, versions_of
from warehouse.tables.datafiles import exchange, files_of
from warehouse.tables.delta import FOLDER as TABLE_FOLDER
from warehouse.tables.history import base_of
from warehouse.tables.released import released
from warehouse.tables.staging import quoted_scene
from warehouse.upkeep.erasure.dependents import FurnishedAnewError, furnished_anew
from warehouse.upkeep.erasure.plan import PATH as PLAN_PATH
from warehouse.upkeep.erasure.plan import ErasurePlan, read_plan
from warehouse.upkeep.erasure.proof import Proof, search, tells
from warehouse.upkeep.erasure.releases import erase_from_releases
from warehouse.upkeep.erasure.rewriting import SceneRows
from warehouse.upkeep.erasure.traces import Traces, traces_of
from warehouse.upkeep.references import workspace
from warehouse.upkeep.vacuum import forget

NOTE = "erasure"

Advance = Callable[[str], None]
Elsewhere = Callable[[Traces, frozenset[str]], None]


@dataclasses.dataclass(frozen=True)
class Erasure:
    """What an erasure removed, or would remove.

    `rows` are the scene's per table in the last snapshot. `snapshots` are those that are no longer kept, `releases` those
    that were written anew. `young_blobs` are blobs that no row names and that somebody put within a day, of whatever scene.
    `traces` are the names that were looked for, `hashes` those of blobs and assets that went. `proof` is None on a dry run.
    `models` are those that were trained while the scene was there: what they learned of it stays in their weights.
    """

    scene_id: str
    rows: Mapping[str, int]
    staged_runs: int
    blobs: int
    snapshots: tuple[int, ...]
    releases: tuple[str, ...]
    young_blobs: int
    traces: Traces
    hashes: tuple[str, ...]
    proof: Proof | None
    models: tuple[str, ...] = ()


def erase(
    lake: Lake,
    scene_id: str,
    *,
    dry_run: bool = False,
    timeout: float = 300.0,
    advance: Advance = lambda what: None,
    elsewhere: Elsewhere = lambda traces, hashes: None,
) -> Erasure:
    """Erase a scene from tables, blobs, snapshots and releases, and search the whole lake for what may be left.

    All snapshots that are neither released nor the last are dropped. `advance` is told each step. `elsewhere` is called
    before the erasure counts as finished, with the scene's traces and the hashes of what went: for what is kept of it
    outside of the lake.

    Raises:
        InputError: this is no scene, there is no lake, or the erasure of another scene is not finished.
        FurnishedAnewError: scenes that were made of it are there; from the first step of an erasure on no commit takes in others.
        LeaseError: another process holds the lake's lease for more than `timeout` seconds.
    """
    if not re.fullmatch(SCENE_PATTERN, scene_id):
        raise InputError(lake.address, "scene", f"{scene_id!r} is no scene", "give <dataset>/<scan>")
    if not lake.exists:
        raise InputError(lake.address, "", "there is no lake", "name its folder")
    with lake.leased(timeout) as lease:
        begun = read_plan(lake.storage)
        if begun is not None and begun.scene_id != scene_id:
            raise InputError(lake.address, PLAN_PATH, f"the erasure of {begun.scene_id} is not finished", "finish it first")
        if not dry_run:
            if begun is None and (dependents := furnished_anew(lake, scene_id)):
                raise FurnishedAnewError(lake, scene_id, dependents)
            _settle_batches(lake, lease, scene_id)
        with workspace(lake.storage) as connection:
            work = _Work(lake, scene_id, SceneRows(lake, scene_id, connection), lease, begun)
            if dry_run:
                return work.result(None)
            if work.is_unknown:
                proof = search(lake.storage, work.plan.traces, advance)
                if not proof.hits:
                    # An erasure before may have found these in use, or they are of a lake that was erased elsewhere.
                    elsewhere(work.plan.traces, frozenset())
                    work.remove_unnamed_blobs()  # a vacuum may have taken away what said whose they are
                    return work.result(proof)
            work.carry_out(advance, elsewhere)
        return work.result(search(lake.storage, work.final_traces, advance))


class _Work:
    """One erasure, made while the lease is held."""

    def __init__(self, lake: Lake, scene_id: str, rows: SceneRows, lease: Lease, begun: ErasurePlan | None) -> None:
        self._lake, self._scene, self._rows, self._lease = lake, scene_id, rows, lease
        self._every = lake.snapshot().snapshots
        named = {release.snapshot_id for release in released(lake.storage)}
        if begun is not None and begun.last is not None:
            named.add(begun.last)
        self._kept = [row for row in self._every if row is self._every[-1] or row.snapshot_id in named or _is_marker(row, begun)]
        self._going = tuple(row.snapshot_id for row in self._every if row not in self._kept)
        self._staged = [staged_run for staged_run in lake.staging.runs() if scene_id in (staged_run.run.scene_id, base_of(staged_run.run))]
        self._staged_runs = len(self._staged)
        self._has_calls = any(call.scene_id == scene_id for call in lake.calls.all().values())
        self._removed_blobs: set[str] = set()
        self._is_carried_out = False
        self._young = 0
        self.counts = self._count()
        self._models = _trained_on(lake, scene_id)
        self.plan = self._planned(begun)
        # Nothing but the command line says that there ever was such a scene.
        self.is_unknown = begun is None and not (
            sum(self.counts.values()) or self._staged or self._has_calls or self.plan.blobs or self._is_in_any_file()
        )
        self.final_traces = self.plan.traces

    def carry_out(self, advance: Advance, elsewhere: Elsewhere) -> None:
        """Everything, in an order that a kill cannot hurt."""
        self.plan.write(self._lake.storage)
        remove_claim(self._lake.storage, self._scene)  # before its staged runs: who computes it finds that out first
        self._remove_staged()
        advance("staged runs")
        self._put_in_force(advance)
        erase_from_releases(self._lake, self.plan, self._lease, advance)
        self._remove_unnamed_tables()
        self._remove_blobs()
        self.remove_unnamed_blobs()
        self._lake.sweep_temporary()
        sweep_claims(self._lake.storage)  # a claim or a folder of scans may name the scene, too
        sweep_runs(self._lake.storage)
        advance("files")
        assets = self._assets_that_stay()
        hashes = {name.partition(".")[0] for name in self._removed_blobs} | (self.plan.assets - assets)
        self.final_traces = dataclasses.replace(self.plan.traces, hashes=frozenset(hashes))
        elsewhere(self.plan.traces, frozenset(hashes))
        self._lake.storage.remove(PLAN_PATH)
        self._is_carried_out = True

    def remove_unnamed_blobs(self) -> None:
        """Remove blobs that no row names, whosever they are, but those that a run may be about to name.

        A young one that tells of the scene goes, too: of a run that another took the place of before it was committed.
        """
        kept = self._lake.snapshot().snapshots
        self._young = forget(self._lake, self._lease, kept, goes=self._tells).young_blobs

    def _tells(self, path: str) -> bool:
        """Whether a file of the lake tells of the scene."""
        try:
            return tells(path, self._lake.storage.read(path), self.plan.traces)
        except FileNotFoundError:
            return False

    def result(self, proof: Proof | None) -> Erasure:
        """What was done."""
        return Erasure(
            scene_id=self._scene,
            rows=self.counts,
            staged_runs=self._staged_runs,
            blobs=len(self._removed_blobs) if proof is not None else len(self._blobs_that_go()),
            snapshots=self._going if self._is_carried_out or proof is None else (),
            releases=tuple(sorted(self.plan.releases)),
            young_blobs=self._young,
            traces=self.plan.traces,
            hashes=tuple(sorted(self.final_traces.hashes)),
            proof=proof,
            models=self._models,
        )

    def _count(self) -> dict[str, int]:
        """The scene's rows per table in the last snapshot."""
        if not self._every:
            return {}
        at = self._files_at(self._every[-1])
        counted = {table: self._rows.count(table, files, self._shared(table, at)) for table, files in at.items()}
        return {table: count for table, count in counted.items() if count}

    def _planned(self, begun: ErasurePlan | None) -> ErasurePlan:
        own_rooms, other_rooms = self._rows.rooms()
        other_names = self._rows.other_scenes() | other_rooms | {staged_run.run.scene_id for staged_run in self._lake.staging.runs()}
        releases = set()
        for row in self._kept:
            at = self._files_at(row)
            if any(self._rows.count(table, files, self._shared(table, at)) for table, files in at.items()):
                releases |= {release.name for release in released(self._lake.storage) if release.snapshot_id == row.snapshot_id}
        blobs = self._rows.blobs() | self._staged_blobs()
        assets = self._rows.shared_keys("assets", alone=False)
        traces = traces_of(self._scene, own_rooms, other_names)
        last = self._every[-1].snapshot_id if self._every else 0
        fresh = ErasurePlan(self._scene, now_utc(), traces, frozenset(blobs), frozenset(assets), frozenset(releases), last)
        return begun | fresh if begun is not None else fresh

    def _files_at(self, snapshot: Snapshot) -> dict[str, list[str]]:
        """Data files of every table in a snapshot."""
        by_version = {}
        for table, version in versions_of(snapshot).items():
            files = files_of(self._lake.tables, table, [version])
            if version not in files:
                raise InputError(self._lake.address, table, f"version {version} is missing, which a snapshot names", "restore the folder")
            by_version[table] = files[version]
        return by_version

    def _shared(self, table: str, at: Mapping[str, Sequence[str]]) -> frozenset[str]:
        """Keys of a shared table that only the scene names in a snapshot, whose files are given."""
        sharing = TABLES[table].shared_by if table in TABLES else ""
        return frozenset(self._rows.shared_keys(table, at.get(sharing, []))) if sharing else frozenset()

    def _is_in_any_file(self) -> bool:
        """Whether any data file tells of the scene, named by a snapshot or not."""
        return any(self._rows.affected(table, files, self.plan.traces) for table, files in self._rows.files.items() if table != "snapshots")

    def _put_in_force(self, advance: Advance) -> None:
        """New versions of every table, and the snapshots that name them."""
        if not self._kept:
            return
        new: list[dict[str, int]] = [{} for _ in self._kept]
        at = [self._files_at(row) for row in self._kept]
        for table in sorted({name for files in at for name in files}):
            versions = self._new_versions(table, at)
            for index, version in versions.items():
                new[index][table] = version
            advance(table)
        rows = [
            dataclasses.replace(
                row,
                tables=tuple(f"{name}={version}" for name, version in sorted(versions.items())),
                note=self.plan.traces.redacted(row.note),
            )
            for row, versions in zip(self._kept, new, strict=True)
        ]
        marker = dataclasses.replace(rows[-1], snapshot_id=rows[-1].snapshot_id + 1, created_at=now_utc(), note=NOTE)
        commit = Commit(self._lake.tables, self._lake.staging, self._lease)
        commit.remove_adopted()
        has_marker = any(_is_marker(row, self.plan) for row in rows)  # of an attempt that was killed later
        commit.rewrite_snapshots(rows if has_marker else [*rows, marker])

    def _new_versions(self, table: str, at: Sequence[Mapping[str, Sequence[str]]]) -> dict[int, int]:
        """Write a table's versions without the scene, one after another; their numbers by index of the snapshot."""
        made: dict[tuple[str, frozenset[str]], list[str]] = {}
        versions: dict[int, int] = {}
        opened = self._lake.tables.open(table)
        present = set(self._lake.tables.files(table, opened)) if opened is not None else set()
        is_first = True
        for index, files in enumerate(at):
            if table not in files:
                continue
            shared = self._shared(table, files)
            new = {file for file in files[table] if (file, shared) not in made}
            affected = set(self._rows.affected(table, sorted(new), self.plan.traces, shared))
            for file in sorted(new):
                key = (file, shared)
                made[key] = (
                    self._rows.rewritten(table, file, self.plan.traces, shared, self._lease.check)[0] if file in affected else [file]
                )
            target = {path for file in files[table] for path in made[(file, shared)]}
            # The first is written even if nothing changes: the log in front of it tells of the scene and can go then.
            versions[index] = exchange(
                self._lake.tables, self._lake.storage, table, present - target, target - present, self._lease.check, forced=is_first
            )
            present, is_first = target, False
        return versions

    def _staged_blobs(self) -> set[str]:
        """Blobs that the scene's staged rows name."""
        names: set[str] = set()
        for staged_run in self._staged:
            for table, path in staged_run.files.items():
                for column in TABLES[table].blob_columns if table in TABLES else ():
                    names.update(name for name in self._lake.staging.read(path).column(column).to_pylist() if name is not None)
        return names | self._lake.calls.blob_names(lambda call: call.scene_id == self._scene)

    def _remove_staged(self) -> None:
        self._lake.staging.remove(self._staged)
        self._lake.calls.erase(self._scene)
        for name in self._lake.storage.names("staged", f"{quoted_scene(self._scene)}@"):
            self._lake.storage.remove(f"staged/{name}")  # without the run's own row
        self._lake.staging.remove_incomplete()  # a batch whose writer died may tell of the scene, and nobody will take it in

    def _remove_unnamed_tables(self) -> None:
        """Remove what a commit that died left of tables that no snapshot names."""
        named = {table for row in self._lake.snapshot().snapshots for table in versions_of(row)} | {"snapshots"}
        for table in set(self._lake.storage.folders(TABLE_FOLDER)) - named:
            self._lease.check()
            for entry in list(self._lake.storage.walk(f"{TABLE_FOLDER}/{table}")):
                self._lake.storage.remove(entry.path)

    def _blobs_that_go(self) -> set[str]:
        """Blobs of the plan that no other row names, in what stays or staged."""
        own = {staged_run.token for staged_run in self._staged}
        named: set[str] = set()
        for row in self._kept:
            at = self._files_at(row)
            for table, files in at.items():
                shared = self._shared(table, at)
                named |= self._rows.blobs_of_others(table, files, self.plan.blobs, shared)
        for staged_run in self._lake.staging.runs():
            for table, path in staged_run.files.items() if staged_run.token not in own else ():
                for column in TABLES[table].blob_columns if table in TABLES else ():
                    named |= set(self._lake.staging.read(path).column(column).to_pylist())
        return set(self.plan.blobs) - named - self._lake.calls.blob_names(lambda call: call.scene_id != self._scene)

    def _remove_blobs(self) -> None:
        self._kept = list(self._lake.snapshot().snapshots)
        self._staged = []
        for name in sorted(self._blobs_that_go()):
            self._lease.check()
            self._lake.blobs.remove(f"blobs/{name[:2]}/{name[2:4]}/{name}")
            self._removed_blobs.add(name)

    def _assets_that_stay(self) -> set[str]:
        """Those of the plan's assets that other scenes name."""
        staying: set[str] = set()
        for row in self._lake.snapshot().snapshots:
            files = self._files_at(row).get("assets", [])
            staying |= set(
                self._lake.tables.read(TABLES["assets"], files, ["asset_id"], {"asset_id": self.plan.assets}).column(0).to_pylist()
            )
        return staying


def _is_marker(row: Snapshot, plan: ErasurePlan | None) -> bool:
    """True if an attempt at this very erasure added the snapshot."""
    if plan is None or row.note != NOTE:
        return False
    return row.created_at >= plan.started_at if plan.last is None else row.snapshot_id > plan.last


def _trained_on(lake: Lake, scene_id: str) -> tuple[str, ...]:
    """Models in use that were trained on a snapshot since the scene's first one, or began with one that was, withdrawn or not.

    Nothing says that they did not learn from it.
    """
    reader = lake.snapshot()
    runs = reader.matching("stage_runs", {"scene_id": [scene_id]}, ["snapshot_id"]).to_pylist()
    if not runs:
        return ()
    first = min(row["snapshot_id"] for row in runs)
    models = reader.matching("models", {}, ["snapshot_id", "parent_id", "is_withdrawn"]).to_pylist()
    named = {row["model_id"] for row in models if (row["snapshot_id"] or 0) >= first}
    while more := {row["model_id"] for row in models if row["parent_id"] in named} - named:
        named |= more
    return tuple(row["model_id"] for row in models if not row["is_withdrawn"] and row["model_id"] in named)


def _settle_batches(lake: Lake, lease: Lease, scene_id: str) -> None:
    """Commit staged batches that hold rows of the scene, so that their rows are named where all others are."""
    commit = Commit(lake.tables, lake.staging, lease)
    batches = set()
    for staged_run in commit.remove_adopted():
        if staged_run.run.stage not in SCENE_STAGES:
            for path in staged_run.files.values():
                data = lake.staging.read(path)
                named = [name for name in ("scene_id", "reference_scene_id") if name in data.column_names]
                if any(scene_id in data.column(name).to_pylist() for name in named):
                    batches.add(staged_run.run.scene_id)
    if batches:
        commit.run("", scenes=batches)


__all__ = ["NOTE", "Erasure", "ErasurePlan", "Proof", "Traces", "erase", "read_plan"]
