"""Carts in the scenes of a lake: what is to be driven in each, in whichever process, and what came of it. Does not import Prefect."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from flows.run.configuration import Configuration
from flows.run.fingerprints import canonical_json, code_fingerprint, digest
from flows.worker import Job, execute
from schemas.candidates import Asset
from schemas.captions import Caption
from schemas.capture import Instance, Scene, Shell
from schemas.errors import InputError
from schemas.evaluation import Trajectory
from schemas.optimization import Placement, Support
from schemas.record import arrow_to_rows
from schemas.runs import StageRun
from schemas.tables import TABLES
from tasks import robot
from tasks.robot.configuration import RobotConfig, unusual
from tasks.robot.routes import DriveBatch, spread_ways
from warehouse.lake import Lake
from warehouse.tables.snapshot import Reader

STAGE = robot.STAGE

_RECORDS = {"scenes": Scene, "shells": Shell, "instances": Instance, "captions": Caption, "placements": Placement, "supports": Support}
"""What a cart's world is made of, beside assets."""


@dataclasses.dataclass(frozen=True)
class DriveTask:
    """Ways of one trajectory batch in a scene. Travels to a worker process."""

    lake: str
    snapshot_id: int
    scene_id: str
    trajectory_batch_id: str
    configuration: Configuration


@dataclasses.dataclass(frozen=True)
class PlannedDrive:
    """A scene that a cart is to drive through. job: What would do that, without its rows. ways: How many. is_new: Whether the lake does not
    have its runs."""

    task: DriveTask
    job: Job
    ways: int
    is_new: bool

    @property
    def scene_id(self) -> str:
        """The scene."""
        return self.task.scene_id

    @property
    def batch_id(self) -> str:
        """The drive batch."""
        return self.job.scene_id


@dataclasses.dataclass(frozen=True)
class Driven:
    """What came of carts in scenes.

    batches: Drive batches. runs, scenes: Counts, those that were in the lake already included. new: Runs that were not. notes: Why runs did
    not arrive, a line each. failed: Scenes without runs, and why, a line each.
    """

    batches: tuple[str, ...]
    runs: int
    scenes: int
    new: int
    notes: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()


def planned_drives(lake: Lake, trajectory_batches: Sequence[str], configuration: Configuration) -> list[PlannedDrive]:
    """What a cart is to drive of trajectory batches: in every scene of theirs some ways, spread over its episodes.

    A drive batch is named by all that its rows follow from but the code, so only scenes are driven whose trajectories, objects or settings
    are new, or when newer code drives.

    Raises:
        InputError: the lake has no such trajectories.
    """
    reader, history, planned = lake.snapshot(), lake.history(), []
    for batch in dict.fromkeys(trajectory_batches):
        ways = _ways_by_scene(reader, batch)
        if not ways:
            raise InputError(lake.address, "trajectories", f"there is no batch {batch}", "`metascenes evaluate` makes and imports them")
        for scene, of_scene in sorted(ways.items()):
            task = DriveTask(lake.address, reader.snapshot_id, scene, batch, configuration)
            job = _job(reader, task, of_scene)
            state = history.get((job.scene_id, STAGE.name))
            is_new = state is None or state.done is None or state.done.fingerprint != job.fingerprint
            (drives,) = (value.ways for name, value in job.outside if name == "drive_batch")
            idle = dataclasses.replace(job, outside=())  # thousands of scenes' rows would not fit in memory
            planned.append(PlannedDrive(task, idle, len(drives), is_new))
    return planned


def batches_of(lake: Lake, trajectory_batches: Sequence[str]) -> list[str]:
    """Those of some trajectory batches that the newest snapshot has, in their order."""
    wanted = list(dict.fromkeys(trajectory_batches))
    there = (
        set(lake.snapshot().matching("trajectories", {"batch_id": wanted}, ["batch_id"]).column("batch_id").to_pylist()) if wanted else ()
    )
    return [batch for batch in wanted if batch in there]


def in_this_process(drives: Sequence[PlannedDrive]) -> Iterable[StageRun]:
    """One scene after another, here."""
    return (drive_scene(drive.task) for drive in drives)


def drive_scene(task: DriveTask) -> StageRun:
    """Let a cart drive the ways of a scene, and stage its runs; the row of `stage_runs` says why where it could not."""
    reader = Lake.open(task.lake).snapshot(task.snapshot_id)
    return execute(_job(reader, task, _ways_by_scene(reader, task.trajectory_batch_id)[task.scene_id]))


def driven(planned: Sequence[PlannedDrive], runs: Mapping[str, StageRun], unacted: Sequence[str] = ()) -> Driven:
    """What came of drives, of the runs by batch. unacted: Scenes in which a policy could not act, and why, a line each."""
    failed = {drive.batch_id: runs[drive.batch_id].error for drive in planned if drive.batch_id in runs and runs[drive.batch_id].error}
    done = [drive for drive in planned if drive.batch_id not in failed]
    return Driven(
        tuple(drive.batch_id for drive in planned),
        sum(drive.ways for drive in done),
        len({drive.scene_id for drive in done}),
        sum(drive.ways for drive in done if drive.is_new),
        tuple(note for drive in planned if drive.batch_id in runs for note in runs[drive.batch_id].degradations),
        (*unacted, *(f"{drive.scene_id}: {failed[drive.batch_id]}" for drive in planned if drive.batch_id in failed)),
    )


def _ways_by_scene(reader: Reader, batch: str) -> dict[str, list[Trajectory]]:
    """The trajectories of a batch by scene."""
    ways: dict[str, list[Trajectory]] = defaultdict(list)
    for row in arrow_to_rows(reader.matching("trajectories", {"batch_id": [batch]}), Trajectory):
        ways[row.scene_id].append(row)
    return ways


def world_rows(reader: Reader, scene_id: str) -> dict[str, Sequence[Any]]:
    """What a cart's world in a scene is made of, by table."""
    rows: dict[str, Sequence[Any]] = {table: reader.rows(record, scene_id) for table, record in _RECORDS.items()}
    return {**rows, "assets": reader.rows_by_key(Asset, sorted({row.asset_id for row in rows["placements"]}))}


def _lasting(table: str, row: Any) -> dict[str, Any]:
    """A row without what may differ between runs, as where its scan lay."""
    return {column.name: getattr(row, column.name) for column in TABLES[table].columns if not column.volatile}


def _job(reader: Reader, task: DriveTask, trajectories: Sequence[Trajectory]) -> Job:
    """The job of a scene, on its rows."""
    config: RobotConfig = task.configuration.stages[STAGE.name]
    ways = spread_ways(trajectories, config.routes)
    rows = world_rows(reader, task.scene_id)
    facts = {
        "drive_batch": digest(canonical_json(ways)),
        "scene": digest(canonical_json({name: [_lasting(name, row) for row in some] for name, some in rows.items()})),
    }
    content = digest(STAGE.name, *facts.values(), canonical_json(config), str(task.configuration.seed))
    code = code_fingerprint(robot.__name__)
    return Job(
        lake=task.lake,
        scene_id=f"drive-{content[:16]}",
        stage=STAGE.name,
        config=config,
        config_json=canonical_json(config),
        seed=task.configuration.seed,
        fingerprint=digest(content, code),
        reasons=tuple(f"{name}={value}" for name, value in {**facts, "code": code}.items()),
        upstream=(),
        attempt=1,
        outside=(("drive_batch", DriveBatch(f"drive-{content[:16]}", task.scene_id, ways, unusual(config))), *rows.items()),
    )
