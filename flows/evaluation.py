"""Trajectories into the lake: the evaluation stage, run here and now on a file or on a built-in policy. Does not import Prefect."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from flows.configuration import Configuration
from flows.fingerprints import canonical_json, code_fingerprint, digest
from flows.progress import Progress
from flows.worker import Job, execute
from schemas.errors import InputError
from schemas.evaluation import Trajectory
from schemas.navigation import Episode, Navmesh
from tasks import evaluation
from tasks.evaluation import EvaluationConfig, TrajectoryBatch, check_batch
from tasks.evaluation.batch import read_batch
from tasks.evaluation.policies import POLICIES
from tasks.stage import Context
from warehouse.lake import Lake
from warehouse.snapshot import Reader

STAGE = evaluation.STAGE


@dataclasses.dataclass(frozen=True)
class Imported:
    """What came of one batch. `already`: the lake had it. `notes`: what is odd about its trajectories."""

    batch_id: str
    policy: str
    run_name: str
    trajectories: int
    scenes: int
    already: bool
    notes: tuple[str, ...]
    error: str | None = None


def import_trajectories(lake: Lake, file: Path, configuration: Configuration, dry_run: bool = False) -> Imported:
    """Read a batch of trajectories, hold it against the lake's episodes, measure and append it.

    Raises:
        InputError: the file, or a trajectory in it, is refused; nothing is imported then. A batch that is in the lake
            already with other trajectories is refused: trajectories are history.
    """
    batch = read_batch(file)
    reader = lake.snapshot()
    episodes, navmeshes = _rows_of(reader, batch.scene_ids)
    content = digest(canonical_json([dataclasses.replace(attempt, where="") for attempt in batch.attempts]), batch.policy, batch.run_name)
    known = _held(lake, batch, content)
    if known is not None:
        if known != content:
            problem = f"{batch.batch_id} is in the lake with other trajectories"
            raise InputError(file.name, "batch_id", problem, "give the new ones a batch_id of their own")
        return _imported(lake, batch, already=True)
    check_batch(batch, episodes, navmeshes, _config(configuration))
    if dry_run:
        return _imported(None, batch)
    done = _measure(lake, batch, content, episodes, navmeshes, configuration)
    if done.error:
        raise InputError(file.name, "trajectories", done.error)
    return done


def run_policy(lake: Lake, policy: str, configuration: Configuration, dry_run: bool = False) -> tuple[Imported, list[str]]:
    """Let a built-in policy act in all episodes of the lake, measure and append what it did.

    The batch is named by all that its rows follow from: the same episodes and settings give the same batch, which is then
    in the lake already.

    Returns:
        What came of it, and the scenes whose navmesh cannot be used, a line each: their episodes were left out.

    Raises:
        InputError: the lake has no episodes, or none that can be run.
    """
    reader, config = lake.snapshot(), _config(configuration)
    episodes, navmeshes = reader.rows(Episode), reader.rows(Navmesh)
    if not episodes:
        raise InputError(lake.address, "episodes", "the lake has none", "`metascenes run` makes them")
    unusable = _unusable(lake, episodes, navmeshes)
    usable = [row for row in episodes if row.scene_id not in unusable]
    failed = [f"{scene}: {why}" for scene, why in sorted(unusable.items())]
    if not usable:
        raise InputError(lake.address, "navmeshes", f"none can be used; {failed[0]}", "run the navigation stage again")
    scenes = {row.scene_id for row in usable}
    navmeshes = [row for row in navmeshes if row.scene_id in scenes]
    context = Context(scene_id=policy, stage=STAGE.name, seed=configuration.seed, blobs=lake.blobs)
    attempts = POLICIES[policy](usable, config, context.rng)
    content = digest(
        policy, canonical_json([attempts, usable, navmeshes]), canonical_json(config), code_fingerprint("tasks.evaluation")
    )  # fmt: skip
    run_name = f"seed {configuration.seed}" if policy == "random" else "built-in"
    batch = TrajectoryBatch(f"{policy}-{content[:12]}", policy, run_name, attempts)
    if _held(lake, batch, content) is not None:
        return _imported(lake, batch, already=True), failed
    if dry_run:
        return _imported(None, batch), failed
    return _measure(lake, batch, content, usable, navmeshes, configuration), failed


def metrics_of(reader: Reader, batches: Sequence[Imported]) -> list[dict[str, Any]]:
    """Rows of the view `navigation_metrics` for the policies and runs of these batches."""
    with reader.connect() as connection:
        rows = connection.sql("SELECT * FROM navigation_metrics").to_arrow_table().to_pylist()
    wanted = {(batch.policy, batch.run_name) for batch in batches}
    return [row for row in rows if (row["policy"], row["run_name"]) in wanted]


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


def _rows_of(reader: Reader, scenes: Sequence[str]) -> tuple[list[Episode], list[Navmesh]]:
    episodes = [row for scene in scenes for row in reader.rows(Episode, scene)]
    return episodes, [row for scene in scenes for row in reader.rows(Navmesh, scene)]


def _unusable(lake: Lake, episodes: Sequence[Episode], navmeshes: Sequence[Navmesh]) -> dict[str, str]:
    """Why the episodes of a scene cannot be run, by scene; no entry where they can."""
    from tasks.navigation.navmesh import read_navmesh

    named = {(row.scene_id, row.agent): row.navmesh_blob for row in navmeshes}
    found: dict[str, str] = {}
    for scene, agent in sorted({(row.scene_id, row.agent) for row in episodes}):
        blob = named.get((scene, agent))
        try:
            if blob is None or blob not in lake.blobs:
                raise InputError(scene, "navmesh", f"there is none for agent {agent}", "run the navigation stage again")
            read_navmesh(lake.blobs[blob], f"{blob[:12]}.navmesh")
        except InputError as error:
            found.setdefault(scene, str(error))
    return found


def _held(lake: Lake, batch: TrajectoryBatch, content: str) -> str | None:
    """Hash of the batch's trajectories as the lake has them, None when it has none. What was only staged is committed."""
    state = lake.history().get((batch.batch_id, STAGE.name))
    if state is None or state.done is None:
        return None
    held = dict(part.split("=", 1) for part in state.done.reasons)["trajectory_batch"]
    if state.is_staged and held == content:
        lake.commit(note=f"trajectory batch {batch.batch_id}", scenes=[batch.batch_id])
    return held


def _imported(lake: Lake | None, batch: TrajectoryBatch, already: bool = False, error: str | None = None) -> Imported:
    """What came of a batch; notes are those of its rows in the lake."""
    rows = lake.snapshot().rows_by_key(Trajectory, [batch.batch_id]) if lake is not None else []
    notes = tuple(f"{row.scene_id} {row.episode_id}: {row.problem}" for row in rows if row.problem)
    return Imported(batch.batch_id, batch.policy, batch.run_name, len(batch.attempts), len(batch.scene_ids), already, notes, error)


def _measure(
    lake: Lake,
    batch: TrajectoryBatch,
    content: str,
    episodes: Sequence[Episode],
    navmeshes: Sequence[Navmesh],
    configuration: Configuration,
) -> Imported:
    """Run the stage on a batch, with a bar over its scenes, and commit it."""
    config = _config(configuration)
    inputs: Mapping[str, str] = {"trajectory_batch": content, "navigation": digest(canonical_json([episodes, navmeshes]))}
    code = code_fingerprint("tasks.evaluation")
    job = Job(
        lake=lake.address,
        scene_id=batch.batch_id,
        stage=STAGE.name,
        config=config,
        config_json=canonical_json(config),
        seed=configuration.seed,
        fingerprint=digest("evaluation", *inputs.values(), canonical_json(config), code),
        reasons=(*(f"{name}={value}" for name, value in inputs.items()), f"code={code}"),
        upstream=(),
        attempt=1,
        outside=(("trajectory_batch", batch), ("episodes", episodes), ("navmeshes", navmeshes)),
    )
    with Progress(f"{batch.policy}: scenes", len(batch.scene_ids)) as progress:
        run = execute(job, _advancing(progress))
    lake.commit(note=f"trajectory batch {batch.batch_id}", scenes=[batch.batch_id])
    return _imported(lake, batch, error=run.error)


def _advancing(progress: Progress) -> Callable[[Callable[[Any], Any], Sequence[Any]], list[Any]]:
    """A map in turn that moves a bar on after every item."""

    def spread(function: Callable[[Any], Any], items: Sequence[Any]) -> list[Any]:
        found = []
        for item in items:
            found.append(function(item))
            progress.advance(item.attempts[0].scene_id)
        return found

    return spread
