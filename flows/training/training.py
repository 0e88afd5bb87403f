"""One training, from the dataset that is named to the model in the lake. Does not import Prefect."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from flows.run.configuration import Configuration, configure
from flows.run.fingerprints import ModuleCaches, canonical_json, code_fingerprint, digest
from flows.training.contents import contents_of
from flows.training.datasets import LakeDataset, chosen_dataset
from flows.training.models import found_model, loaded_model, paths_of, reads_of
from flows.worker import Job, execute, followed
from schemas.errors import InputError, LakeError
from schemas.record import arrow_to_rows
from schemas.training import LearnedModel
from tasks import training
from tasks.families import member
from tasks.models import Model, identity_json
from tasks.stage import silently
from tasks.training.checkpoints import forget
from tasks.training.dataset import Provenance
from tasks.training.devices import check_installed, rank
from tasks.training.learned_systems import SYSTEMS
from warehouse.lake import Lake
from warehouse.tables.history import StageState

STAGE = training.STAGE
CHECKPOINTS = "tasks.training.fitting"
"""The module in whose cache checkpoints lie."""

Report = Callable[[int, int, str], None]


class UnderWay(InputError):
    """Somebody else is at the same training."""


@dataclasses.dataclass(frozen=True)
class PlannedTraining:
    """A training that can be run. why: What the lake says of it. held: Its model, where the lake has it already."""

    job: Job
    dataset: LakeDataset
    why: str
    held: LearnedModel | None

    @property
    def training_id(self) -> str:
        """Name of the training: of learned system, dataset content, config, seed, code, model and weights that it begins with."""
        return self.job.scene_id


def system_configuration(
    system: str,
    file: Path | None = None,
    settings: Sequence[str] = (),
    seed: int | None = None,
    tables: Mapping[str, Mapping[str, Any]] | None = None,
) -> Configuration:
    """Settings of a run that trains a learned system; what a file or tables say of another one is left.

    Raises:
        InputError: as `configure`, or the settings name another learned system.
    """
    before = configure(file, tables=tables)
    if before.stages[STAGE.name].system.kind != system:
        tables = {**(tables or {}), STAGE.name: {"system": system}}
    configuration = configure(file, settings, None, seed, tables)
    config = configuration.stages[STAGE.name].system
    if config.kind != system:
        raise InputError("--set", "training.system", f"is {config.kind}, and {system} is to be trained", "name one of them")
    return configuration


def planned_training(
    lake: Lake,
    configuration: Configuration,
    *,
    snapshot_id: int | None = None,
    release: str | None = None,
    start: str | None = None,
) -> PlannedTraining:
    """What training the learned system of a configuration on a dataset would be, held against the lake; nothing is computed.

    `start` names the model whose weights it begins with.

    Raises:
        InputError: there is no such dataset, nothing in it to learn from, or no such model.
    """
    config = configuration.stages[STAGE.name]
    system = config.system.kind
    dataset = chosen_dataset(lake, snapshot_id, release, config.datasets)
    begins_with: Model | None = None
    if start is not None:
        begins_with = loaded_model(lake, found_model(lake.snapshot(), start, system)[0])
        member(SYSTEMS, system).continues(begins_with.config, config.system, f"model {begins_with.model_id[:12]}")
    parts = {
        "dataset": dataset.fingerprint(reads_of(system)),
        "system": digest(identity_json(config.system)),
        "code": code_fingerprint(f"tasks.training.systems.{system}"),
        "seed": str(configuration.seed),
        "start": begins_with.model_id if begins_with is not None else "none",
    }
    contents = contents_of(paths_of(system, config.system))
    if contents:
        parts["weights"] = digest(*contents)
    fingerprint = digest("training-1", system, *parts.values())
    training_id = f"{system}-{fingerprint[:16]}"
    provenance = Provenance(dataset.snapshot_id, release, parts["dataset"], parts["code"])
    state = lake.history([training_id]).get((training_id, STAGE.name))
    job = Job(
        lake=lake.address,
        scene_id=training_id,
        stage=STAGE.name,
        config=config,
        config_json=canonical_json(config),
        seed=configuration.seed,
        fingerprint=fingerprint,
        reasons=tuple(f"{name}={value}" for name, value in parts.items()),
        upstream=(),
        attempt=state.last.attempt + 1 if state is not None and state.last.fingerprint == fingerprint else 1,
        outside=(("dataset", dataset), ("start", begins_with), ("provenance", provenance)),
    )
    held = _held(lake, training_id, state)
    return PlannedTraining(job, dataset, _why(state, held), held)


def _held(lake: Lake, training_id: str, state: StageState | None) -> LearnedModel | None:
    """The model of a training that is done; what is staged of it is committed first."""
    if state is None or state.done is None:
        return None
    if state.is_staged:
        lake.commit(note=f"training {training_id}", scenes=[training_id])
    return model_of_training(lake, training_id)


def model_of_training(lake: Lake, training_id: str) -> LearnedModel | None:
    """The model that a training left; None where there is none."""
    rows = arrow_to_rows(lake.snapshot().matching("models", {"training_id": [training_id]}), LearnedModel)
    return rows[0] if rows else None


def trained_on(lake: Lake, system: str, release: str) -> LearnedModel | None:
    """A model of a learned system that was trained on all of a release, withdrawn or not; None where there is none."""
    named = {"kind": [system], "release": [release], "dataset": [f"release {release}"]}  # not on some datasets of it
    rows = arrow_to_rows(lake.snapshot().matching("models", named), LearnedModel)
    return rows[0] if rows else None


def _why(state: StageState | None, held: LearnedModel | None) -> str:
    if held is not None:
        return "withdrawn" if held.is_withdrawn else "unchanged"
    if state is not None and state.last.outcome != "done":
        return f"{state.last.outcome} before"
    return "never done"


def train(lake: Lake, planned: PlannedTraining, report: Report = silently) -> LearnedModel:
    """Carry a training out, if the lake does not have its model: fit, measure, stage and commit. After a kill it goes on where it was.

    Of several processes at one training (`torchrun`, `fabric run`) the first one keeps what comes of it.

    Raises:
        InputError: what training needs is not installed, or the dataset cannot be learned from.
        UnderWay: somebody else is at it.
        LakeError: it failed by a defect; the text says where.
    """
    if planned.held is not None:
        return planned.held
    check_installed()
    if rank() > 0:
        return _followed(planned, report)
    name = planned.training_id
    with _claimed(lake, name):
        run = execute(planned.job, report=report)
        lake.commit(note=f"training {name} on {planned.dataset.name}", scenes=[name])
    if run.error is not None:
        raise (InputError(name, "training", run.error) if run.error_kind == "input" else LakeError(f"{name}: {run.error}"))
    forget_checkpoints(name)
    model = model_of_training(lake, name)
    if model is None:
        raise LakeError(f"{name}: its rows are not in the lake; somebody removed them meanwhile, train again")
    return model


def _followed(planned: PlannedTraining, report: Report) -> LearnedModel:
    """Take part in a training that another process keeps."""
    outcome = followed(planned.job, report=report)
    model: LearnedModel = outcome.rows["models"][0]
    return model


@contextlib.contextmanager
def _claimed(lake: Lake, training_id: str) -> Iterator[None]:
    """While nobody else is at this training: two would write one set of checkpoints."""
    with lake.claims() as claims:
        if not claims.claim(training_id):
            holder = lake.claimed().get(training_id)
            who = f" on {holder.host}" if holder is not None else ""
            raise UnderWay(training_id, "training", f"is under way{who}", "wait for it, or stop it")
        yield


def forget_checkpoints(training_id: str) -> None:
    """Remove the checkpoints of a training and of its parts: its model is in the lake."""
    checkpoints = ModuleCaches()[CHECKPOINTS]
    for key in {name.rpartition("-")[0] for name in checkpoints if name.startswith(training_id)}:
        forget(checkpoints, key)
