"""Policies in the scenes of a lake: what is to be done in each, in whichever process, and what came of it. Does not import Prefect."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache

from flows.evaluation.measuring import STAGE, Evaluated, MeasuredRows, evaluation_config, measured_rows, measuring_job
from flows.inputs.policies import ACTING_CODE, SYSTEM, TrainedPolicy, trained_policy
from flows.run.configuration import Configuration
from flows.run.fingerprints import canonical_json, code_fingerprint, digest
from flows.worker import Job, execute, kind_and_text, lost_run
from schemas.capture import RoomSurface
from schemas.errors import InputError
from schemas.families.policies import POLICIES as POLICY_NAMES
from schemas.runs import StageRun
from tasks.evaluation import EvaluationConfig, TrajectoryBatch
from tasks.evaluation.batch import Attempt
from tasks.evaluation.policies import POLICIES
from tasks.families import member
from tasks.stage import Context
from warehouse.lake import Lake
from warehouse.tables.snapshot import Reader

Episodes = Mapping[str, Sequence[str]]
"""Names of episodes by scene."""


@dataclasses.dataclass(frozen=True)
class SceneTask:
    """A policy in a scene. Travels to a worker process.

    policy: A built-in one, or the id of a model. episodes: Those that it acts in; none: all of the scene.
    """

    lake: str
    snapshot_id: int
    scene_id: str
    policy: str
    configuration: Configuration
    episodes: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class PlannedScene:
    """A scene that a policy is to act in. job: What would measure it, without its rows. episodes: How many. is_new: Whether the lake does
    not have the trajectories."""

    task: SceneTask
    job: Job
    episodes: int
    is_new: bool

    @property
    def scene_id(self) -> str:
        """The scene."""
        return self.task.scene_id

    @property
    def batch_id(self) -> str:
        """The trajectory batch."""
        return self.job.scene_id


@dataclasses.dataclass(frozen=True)
class PlannedPolicy:
    """A policy that is to act in scenes. run_name: Of its trajectories."""

    policy: str
    run_name: str
    scenes: tuple[PlannedScene, ...]

    @property
    def todo(self) -> list[PlannedScene]:
        """Scenes whose trajectories the lake does not have."""
        return [scene for scene in self.scenes if scene.is_new]

    @property
    def batches(self) -> list[str]:
        """All trajectory batches."""
        return [scene.batch_id for scene in self.scenes]


ActIn = Callable[[Sequence[PlannedScene]], Iterable[StageRun]]
"""Lets policies act in scenes and measures that; the runs, in the order of the scenes."""


def planned_policy(
    lake: Lake, policy: str, configuration: Configuration, episodes: Episodes | None = None, snapshot_id: int | None = None
) -> PlannedPolicy:
    """What a built-in policy, or a model, is to do in some episodes of a snapshot, by default in all of the newest one's.

    Raises:
        InputError: there are no episodes, or there is no such policy.
    """
    trained = None if policy in POLICY_NAMES else trained_policy(lake, policy)
    name = SYSTEM if trained is not None else policy
    reader = lake.snapshot(snapshot_id)
    if episodes is None:
        episodes = dict.fromkeys(reader.arrow("episodes").column("scene_id").to_pylist(), ())
    if not episodes:
        raise InputError(lake.address, "episodes", "the lake has none", "`metascenes run` makes them")
    known = policy if trained is None else trained.model_id
    tasks = [SceneTask(lake.address, reader.snapshot_id, scene, known, configuration, tuple(episodes[scene])) for scene in sorted(episodes)]
    history = lake.history()
    scenes = []
    for task in tasks:
        acting = _acting(lake, reader, task, trained)
        state = history.get((acting.job.scene_id, STAGE.name))
        is_new = state is None or state.done is None or state.done.fingerprint != acting.job.fingerprint
        idle = dataclasses.replace(acting.job, outside=())  # thousands of scenes' rows would not fit in memory
        scenes.append(PlannedScene(task, idle, len(acting.rows.episodes), is_new))
    return PlannedPolicy(name, run_name_of(name, trained, configuration), tuple(scenes))


def in_this_process(scenes: Sequence[PlannedScene]) -> Iterable[StageRun]:
    """One scene after another, here."""
    return (act(scene.task) for scene in scenes)


def act(task: SceneTask) -> StageRun:
    """Let a policy act in a scene, and measure and stage what it did; the run says why where it could not."""
    began = time.perf_counter()
    lake = Lake.open(task.lake)
    trained = None if task.policy in POLICY_NAMES else _loaded(task.lake, task.policy)
    acting = _acting(lake, lake.snapshot(task.snapshot_id), task, trained)
    try:
        attempts = acting.attempts()
    except Exception as problem:  # as any stage's failure: it is this scene's, and others go on
        run = lost_run(acting.job, *kind_and_text(problem), time.perf_counter() - began)
        lake.stage_rows(run, {})
        return run
    return execute(acting.measuring(attempts))


def evaluated(planned: PlannedPolicy, runs: Mapping[str, StageRun]) -> Evaluated:
    """What came of a policy, of the runs by batch."""
    failed = [(scene, runs[scene.batch_id].error) for scene in planned.scenes if scene.batch_id in runs and runs[scene.batch_id].error]
    lacking = {scene.batch_id for scene, _ in failed}
    there = [scene for scene in planned.scenes if scene.batch_id not in lacking]
    return Evaluated(
        planned.policy,
        planned.run_name,
        tuple(planned.batches),
        sum(scene.episodes for scene in there),
        len(there),
        sum(scene.episodes for scene in there if scene.is_new),
        tuple(note for scene in planned.scenes if scene.batch_id in runs for note in runs[scene.batch_id].degradations),
        tuple(f"{scene.task.scene_id}: {error}" for scene, error in failed),
    )


@lru_cache(maxsize=2)
def _loaded(address: str, model_id: str) -> TrainedPolicy:
    """A model that acts, once for a process."""
    return trained_policy(Lake.open(address), model_id)


@dataclasses.dataclass(frozen=True)
class _Acting:
    """A policy in the episodes of one scene. job: That would measure it. attempts: Lets it act. measuring: The job of attempts."""

    rows: MeasuredRows
    job: Job
    attempts: Callable[[], Sequence[Attempt]]
    measuring: Callable[[Sequence[Attempt]], Job]


def _acting(lake: Lake, reader: Reader, task: SceneTask, trained: TrainedPolicy | None) -> _Acting:
    """What a policy is to do in a scene's episodes, its batch named by what its rows follow from. A model acts only when it is asked to."""
    config: EvaluationConfig = evaluation_config(task.configuration)
    rows = _rows_of(reader, task.scene_id, task.episodes)
    built_in: Sequence[Attempt] = ()
    if trained is None:
        name, run_name = task.policy, run_name_of(task.policy, None, task.configuration)
        context = Context(scene_id=task.scene_id, stage=STAGE.name, seed=task.configuration.seed, blobs=lake.blobs)
        built_in = tuple(member(POLICIES, name).act(rows.episodes, config, context.rng))
        content = digest(name, run_name, canonical_json([built_in, rows.episodes, rows.navmeshes, config]))
    else:
        name, run_name = SYSTEM, run_name_of(SYSTEM, trained, task.configuration)
        content = digest(name, trained.model_id, trained.code, *_scene_facts(reader, task.scene_id, rows, config))

    def measuring(done: Sequence[Attempt]) -> Job:
        batch = TrajectoryBatch(f"{name}-{content[:16]}", name, run_name, tuple(done))
        return measuring_job(lake, batch, content, rows, task.configuration)

    def attempts() -> Sequence[Attempt]:
        return built_in if trained is None else trained.act(lake, reader, task.scene_id, rows.episodes, config)

    return _Acting(rows, measuring(()), attempts, measuring)


def _rows_of(reader: Reader, scene_id: str, episodes: Sequence[str]) -> MeasuredRows:
    """A scene's rows, with the episodes that are named, or all of them."""
    rows = measured_rows(reader, [scene_id])
    return dataclasses.replace(rows, episodes=[row for row in rows.episodes if row.episode_id in {*episodes}]) if episodes else rows


def _scene_facts(reader: Reader, scene_id: str, rows: MeasuredRows, config: EvaluationConfig) -> tuple[str, str]:
    """What, beside a model, decides on what it does in a scene: what there is to see, as a hash, and where it starts, goes and may go."""
    return rows.digest, canonical_json([rows.episodes, rows.navmeshes, reader.rows(RoomSurface, scene_id), config])


def content_of_episodes(reader: Reader, episodes: Episodes, configuration: Configuration) -> str:
    """Hash of all that decides, beside models, on what these do in some episodes and how that is measured: rows, settings and code."""
    config = evaluation_config(configuration)
    parts = [
        part
        for scene in sorted(episodes)
        for part in (scene, *_scene_facts(reader, scene, _rows_of(reader, scene, episodes[scene]), config))
    ]
    return digest(*parts, *map(code_fingerprint, (ACTING_CODE, "tasks.evaluation")))


def run_name_of(policy: str, trained: TrainedPolicy | None, configuration: Configuration) -> str:
    """Name of a policy's run, with all that changes what it does: runs that act otherwise are never counted as one."""
    if trained is not None:
        return trained.run_name + ("" if evaluation_config(configuration).turns_aside else ", without turning aside")
    acting = member(POLICIES, policy)
    config, usual = evaluation_config(configuration), EvaluationConfig()
    values = {name: getattr(config, name) for name in acting.settings}
    changed = [f"{name} {value:g}" for name, value in values.items() if value != getattr(usual, name)]
    return ", ".join([*([f"seed {configuration.seed}"] if acting.is_drawn else []), *changed]) or "built-in"
