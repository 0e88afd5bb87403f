"""Trajectories into the lake: the evaluation stage, run here and now on a file, a built-in policy or a model. Does not import Prefect."""

from __future__ import annotations

import dataclasses
import json
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from flows.inputs.policies import SYSTEM, TrainedPolicy, trained_policy
from flows.progress import Progress
from flows.run.configuration import Configuration
from flows.run.fingerprints import canonical_json, code_fingerprint, digest
from flows.worker import Job, execute, lost_run
from schemas.candidates import Asset
from schemas.capture import Instance, RoomSurface, Shell
from schemas.errors import InputError
from schemas.families.policies import POLICIES as POLICY_NAMES
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Placement
from schemas.runs import StageRun
from tasks import evaluation
from tasks.evaluation import EvaluationConfig, TrajectoryBatch, check_batch
from tasks.evaluation.batch import Attempt, read_batch
from tasks.evaluation.policies import POLICIES
from tasks.families import member
from tasks.stage import Context
from warehouse.lake import Lake
from warehouse.tables.history import Key, StageState
from warehouse.tables.snapshot import Reader

R = TypeVar("R")

STAGE = evaluation.STAGE


@dataclasses.dataclass(frozen=True)
class Evaluated:
    """What came of one policy's trajectories.

    batches: Their batches. trajectories, scenes: Counts, those that were in the lake already included. new: Trajectories
    that were not. notes: What is odd about trajectories, a line each. failed: Scenes without a result, and why, a line each.
    """

    policy: str
    run_name: str
    batches: tuple[str, ...]
    trajectories: int
    scenes: int
    new: int
    notes: tuple[str, ...] = ()
    failed: tuple[str, ...] = ()


def import_trajectories(lake: Lake, file: Path, configuration: Configuration, dry_run: bool = False) -> Evaluated:
    """Read a batch of trajectories, hold it against the lake's episodes, measure and append it.

    Raises:
        InputError: the file, or a trajectory in it, is refused; nothing is imported then. A batch that is in the lake
            already with other trajectories, or measured at another success distance, is refused: trajectories are history.
    """
    batch = read_batch(file)
    content = digest(canonical_json([dataclasses.replace(attempt, where="") for attempt in batch.attempts]), batch.policy, batch.run_name)
    held = _held(lake.history([batch.batch_id]), batch.batch_id)
    if held is not None and held.content != content:
        problem = f"{batch.batch_id} is in the lake with other trajectories"
        raise InputError(file.name, "batch_id", problem, "give the new ones a batch_id of their own")
    config = _config(configuration)
    if held is not None and held.success_m != config.success_m:
        problem = f"{batch.batch_id} is in the lake, measured at a success distance of {held.success_m:g} m, not {config.success_m:g} m"
        raise InputError(file.name, "batch_id", problem, "import the file under another batch_id, or set evaluation.success_m as it was")
    new = 0
    notes: tuple[str, ...] = ()
    if held is None:
        reader = lake.snapshot()
        rows = _rows(reader, batch.scene_ids)
        check_batch(batch, rows.episodes, rows.navmeshes, config)
        new = len(batch.attempts)
        if not dry_run:
            with Progress(f"{batch.policy}: scenes", len(batch.scene_ids)) as progress:
                run = execute(_job(lake, batch, content, rows, configuration), _advancing(progress))
            if run.error:
                raise InputError(file.name, "trajectories", run.error)
            notes = run.degradations
    if not dry_run:
        lake.commit(note=f"trajectory batch {batch.batch_id}", scenes=[batch.batch_id])
    return Evaluated(batch.policy, batch.run_name, (batch.batch_id,), len(batch.attempts), len(batch.scene_ids), new, notes)


def run_policy(lake: Lake, policy: str | TrainedPolicy, configuration: Configuration, dry_run: bool = False) -> Evaluated:
    """Let a built-in policy, or a model, act in all episodes of the lake, measure and append what it did: a batch for every scene.

    A batch is named by all that its rows follow from but the code, so only scenes are computed whose episodes, navmesh or
    settings are new; of a model also whose looks are, or when newer code acts. Newer code measures a batch again, and its
    rows take the place of those that it had. A scene that fails does not stop the others, and leaves a row in `stage_runs`
    that says why. What was measured before a kill is not measured again.

    Raises:
        InputError: the lake has no episodes, or there is no such policy.
    """
    if isinstance(policy, str) and policy not in POLICY_NAMES:
        policy = trained_policy(lake, policy)
    trained, name = (policy, SYSTEM) if isinstance(policy, TrainedPolicy) else (None, policy)
    reader = lake.snapshot()
    scenes = sorted(set(reader.arrow("episodes").column("scene_id").to_pylist()))
    if not scenes:
        raise InputError(lake.address, "episodes", "the lake has none", "`metascenes run` makes them")
    run_name = trained.run_name if trained is not None else _run_name(name, configuration)
    history = lake.history()
    batches: list[str] = []
    notes: list[str] = []
    failed: list[str] = []
    total = new = 0
    with Progress(f"{name}: scenes", len(scenes)) as progress:
        for scene in scenes:
            rows = _rows(reader, [scene])
            acting = _acting(lake, reader, scene, name, run_name, rows, trained, configuration)
            state = history.get((acting.batch_id, STAGE.name))
            is_new = state is None or state.done is None or state.done.fingerprint != acting.fingerprint
            run = _executed(lake, acting) if is_new and not dry_run else None
            batches.append(acting.batch_id)
            progress.advance(scene)
            if run is not None and run.error:
                failed.append(f"{scene}: {run.error}")
                continue
            total += len(rows.episodes)
            new += len(rows.episodes) * is_new
            notes += run.degradations if run is not None else ()
    if not dry_run:
        lake.commit(note=f"trajectories of {name}", scenes=batches)
    return Evaluated(name, run_name, tuple(batches), total, len(scenes) - len(failed), new, tuple(notes), tuple(failed))


@dataclasses.dataclass(frozen=True)
class _Acting:
    """A policy in the episodes of one scene. idle: The job that would measure what it does. act: Lets it act, and is the job that does."""

    idle: Job
    act: Callable[[], Job]

    @property
    def batch_id(self) -> str:
        """The batch."""
        return self.idle.scene_id

    @property
    def fingerprint(self) -> str:
        """Of what is measured."""
        return self.idle.fingerprint


def _acting(
    lake: Lake, reader: Reader, scene: str, policy: str, run_name: str, rows: _SceneRows, trained: TrainedPolicy | None,
    configuration: Configuration,
) -> _Acting:  # fmt: skip
    """What a policy is to do in a scene's episodes, its batch named by what its rows follow from. A model acts only when it is asked to."""
    config = _config(configuration)
    if trained is None:
        context = Context(scene_id=scene, stage=STAGE.name, seed=configuration.seed, blobs=lake.blobs)
        attempts = member(POLICIES, policy).act(rows.episodes, config, context.rng)
        content = digest(policy, run_name, canonical_json([attempts, rows.episodes, rows.navmeshes, config]))
    else:
        seen = canonical_json([rows.episodes, rows.navmeshes, reader.rows(RoomSurface, scene), config])
        content = digest(policy, trained.model_id, trained.code, rows.digest, seen)
    batch_id = f"{policy}-{content[:16]}"

    def job(done: Sequence[Attempt]) -> Job:
        return _job(lake, TrajectoryBatch(batch_id, policy, run_name, tuple(done)), content, rows, configuration)

    def act() -> Job:
        return job(attempts if trained is None else trained.act(lake, reader, scene, rows.episodes, config))

    return _Acting(job(()), act)


def _executed(lake: Lake, acting: _Acting) -> StageRun:
    """Let a policy act, and measure that; the run says why where it could not act."""
    began = time.perf_counter()
    try:
        job = acting.act()
    except InputError as error:
        run = lost_run(acting.idle, "input", str(error), time.perf_counter() - began)
        lake.stage_rows(run, {})
        return run
    return execute(job)


def _run_name(policy: str, configuration: Configuration) -> str:
    """Name of a built-in policy's run, with all that changes what it does: runs that act otherwise are never counted as one."""
    acting = member(POLICIES, policy)
    config, usual = _config(configuration), EvaluationConfig()
    values = {name: getattr(config, name) for name in acting.settings}
    changed = [f"{name} {value:g}" for name, value in values.items() if value != getattr(usual, name)]
    return ", ".join([*([f"seed {configuration.seed}"] if acting.is_drawn else []), *changed]) or "built-in"


def metrics_of(reader: Reader, evaluated: Sequence[Evaluated], configuration: Configuration) -> list[dict[str, Any]]:
    """Rows of the view `navigation_metrics` for these policies and runs, at the success distance that is set."""
    with reader.connect() as connection:
        rows = connection.sql("SELECT * FROM navigation_metrics").to_arrow_table().to_pylist()
    wanted = {(policy_run.policy, policy_run.run_name) for policy_run in evaluated}
    success_m = _config(configuration).success_m
    return [row for row in rows if (row["policy"], row["run_name"]) in wanted and row["success_distance_m"] == success_m]


def _config(configuration: Configuration) -> EvaluationConfig:
    """The stage's config.

    Raises:
        InputError: the robot of the episodes moves otherwise than the one that is evaluated.
    """
    config: EvaluationConfig = configuration.stages[STAGE.name]
    episodes = configuration.stages["navigation"]
    for field in ("forward_m", "turn_degrees"):
        if getattr(config, field) != getattr(episodes, field):
            problem = f"is {getattr(config, field):g}, navigation.{field} is {getattr(episodes, field):g}"
            raise InputError("--set", f"evaluation.{field}", problem, "set both alike: the expert's actions are those of one robot")
    return config


@dataclasses.dataclass(frozen=True)
class _Held:
    """A batch as the lake has it, committed or staged. content: Hash of its trajectories. success_m: That it was measured at [m]."""

    content: str
    success_m: float


def _held(history: Mapping[Key, StageState], batch_id: str) -> _Held | None:
    """A batch of the lake; None when there is none of that name."""
    state = history.get((batch_id, STAGE.name))
    if state is None or state.done is None:
        return None
    reasons = dict(part.split("=", 1) for part in state.done.reasons)
    return _Held(reasons["trajectory_batch"], float(json.loads(state.done.config)["success_m"]))


@dataclasses.dataclass(frozen=True)
class _SceneRows:
    """What a batch is measured on: rows of its scenes, by the tables of the stage."""

    episodes: Sequence[Episode]
    navmeshes: Sequence[Navmesh]
    shells: Sequence[Shell]
    instances: Sequence[Instance]
    assets: Sequence[Asset]
    placements: Sequence[Placement]

    @property
    def digest(self) -> str:
        """Of what there is to see; an asset's id is a hash of it."""
        return digest(canonical_json([self.shells, self.instances, self.placements]))


def _rows(reader: Reader, scenes: Collection[str]) -> _SceneRows:
    """The rows of scenes."""
    placements = _of(reader, Placement, scenes)
    assets = reader.rows_by_key(Asset, sorted({row.asset_id for row in placements}))
    return _SceneRows(
        _of(reader, Episode, scenes), _of(reader, Navmesh, scenes), _of(reader, Shell, scenes), _of(reader, Instance, scenes), assets,
        placements,
    )  # fmt: skip


def _of(reader: Reader, record: type[R], scenes: Collection[str]) -> list[R]:
    return [row for scene in scenes for row in reader.rows(record, scene)]


def _inputs(content: str, rows: _SceneRows) -> dict[str, str]:
    """Hashes of what a batch's rows follow from."""
    return {"trajectory_batch": content, "navigation": digest(canonical_json([rows.episodes, rows.navmeshes])), "sights": rows.digest}


def _fingerprint(content: str, rows: _SceneRows, config: EvaluationConfig) -> str:
    return digest("evaluation", *_inputs(content, rows).values(), canonical_json(config), code_fingerprint("tasks.evaluation"))


def _job(lake: Lake, batch: TrajectoryBatch, content: str, rows: _SceneRows, configuration: Configuration) -> Job:
    """The job that measures a batch, on the rows of its scenes."""
    config = _config(configuration)
    facts = {**_inputs(content, rows), "code": code_fingerprint("tasks.evaluation")}
    tables = {field.name: getattr(rows, field.name) for field in dataclasses.fields(rows)}
    return Job(
        lake=lake.address,
        scene_id=batch.batch_id,
        stage=STAGE.name,
        config=config,
        config_json=canonical_json(config),
        seed=configuration.seed,
        fingerprint=_fingerprint(content, rows, config),
        reasons=tuple(f"{name}={value}" for name, value in facts.items()),
        upstream=(),
        attempt=1,
        outside=(("trajectory_batch", batch), *tables.items()),
    )


def _advancing(progress: Progress) -> Callable[[Callable[[Any], Any], Sequence[Any]], list[Any]]:
    """A map in turn that moves a bar on after every item."""

    def spread(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        results = []
        for item in items:
            results.append(function(item))
            progress.advance(item.attempts[0].scene_id)
        return results

    return spread
