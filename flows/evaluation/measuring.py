"""Measuring trajectories on the episodes of a lake: the job of the evaluation stage, and what came of it. Does not import Prefect."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from typing import TypeVar

from flows.run.configuration import Configuration
from flows.run.fingerprints import canonical_json, code_fingerprint, digest
from flows.worker import Job
from schemas.candidates import Asset
from schemas.capture import Instance, Shell
from schemas.errors import InputError
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Placement
from tasks import evaluation
from tasks.evaluation import EvaluationConfig, TrajectoryBatch
from warehouse.lake import Lake
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


def evaluation_config(configuration: Configuration) -> EvaluationConfig:
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
class MeasuredRows:
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


def measured_rows(reader: Reader, scenes: Collection[str]) -> MeasuredRows:
    """The rows of scenes."""
    placements = _of(reader, Placement, scenes)
    assets = reader.rows_by_key(Asset, sorted({row.asset_id for row in placements}))
    return MeasuredRows(
        _of(reader, Episode, scenes), _of(reader, Navmesh, scenes), _of(reader, Shell, scenes), _of(reader, Instance, scenes), assets,
        placements,
    )  # fmt: skip


def _of(reader: Reader, record: type[R], scenes: Collection[str]) -> list[R]:
    return [row for scene in scenes for row in reader.rows(record, scene)]


def _inputs(content: str, rows: MeasuredRows) -> dict[str, str]:
    """Hashes of what a batch's rows follow from."""
    return {"trajectory_batch": content, "navigation": digest(canonical_json([rows.episodes, rows.navmeshes])), "sights": rows.digest}


def _fingerprint(content: str, rows: MeasuredRows, config: EvaluationConfig) -> str:
    return digest("evaluation", *_inputs(content, rows).values(), canonical_json(config), code_fingerprint("tasks.evaluation"))


def measuring_job(lake: Lake, batch: TrajectoryBatch, content: str, rows: MeasuredRows, configuration: Configuration) -> Job:
    """The job that measures a batch, on the rows of its scenes."""
    config = evaluation_config(configuration)
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
