"""What a comparison of datasets is: trainings with one budget, and test episodes in rooms that none of them learned from.

Does not import Prefect.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections import defaultdict
from collections.abc import Mapping, Sequence

from flows.evaluation.acting import content_of_episodes
from flows.run.configuration import Configuration
from flows.run.fingerprints import canonical_json, code_fingerprint, digest
from flows.training.datasets import LakeDataset, check_datasets, chosen_dataset, named_dataset
from flows.training.training import PlannedTraining, planned_training
from schemas.errors import InputError
from schemas.navigation import Split
from schemas.text import cut
from schemas.wording import counted, noun
from tasks import comparison
from tasks.comparison import ComparisonConfig
from tasks.navigation import room_name, split_of
from warehouse.lake import Lake
from warehouse.tables.snapshot import Reader

STAGE = comparison.STAGE
SYSTEM = "navigation"
"""The learned system whose policies are compared."""


@dataclasses.dataclass(frozen=True)
class ComparisonRequest:
    """What is asked for. train: Choices of datasets, each sorted, at least two. test: Datasets, sorted."""

    train: tuple[tuple[str, ...], ...]
    test: tuple[str, ...]

    @property
    def labels(self) -> tuple[str, ...]:
        """What each choice is called: its datasets with + between them."""
        return tuple(label_of(choice) for choice in self.train)


def label_of(datasets: Sequence[str]) -> str:
    """How rows call a choice of datasets."""
    return "+".join(datasets)


def asked_comparison(train: Sequence[str], test: Sequence[str]) -> ComparisonRequest:
    """The comparison that texts ask for: choices of training datasets such as `a`, `b` and `a+b`, and test datasets.

    Raises:
        InputError: a choice names nothing or is named twice, there are fewer than two of them, or there is no test dataset.
    """
    choices: list[tuple[str, ...]] = []
    for text in train:
        parts = [part.strip() for part in text.split("+")]
        if not all(parts):
            raise InputError("--train", cut(text), "names no dataset on one side of +", "give names as in a or a+b")
        choice = tuple(sorted({*parts}))
        if choice in choices:
            raise InputError("--train", label_of(choice), "is named twice", "name each choice of datasets once")
        choices.append(choice)
    if len(choices) < 2:
        raise InputError("--train", ", ".join(map(label_of, choices)), "is nothing to compare", "give --train at least twice")
    if not test:
        raise InputError("--test", "", "names no dataset", "give the dataset whose scenes the policies are to be tested in")
    return ComparisonRequest(tuple(choices), tuple(sorted({*test})))


@dataclasses.dataclass(frozen=True)
class ComparedTraining:
    """One of the trainings that are compared."""

    trained_on: str
    seed: int
    planned: PlannedTraining


@dataclasses.dataclass(frozen=True)
class PlannedComparison:
    """A comparison that can be run. episodes: Names of test episodes by scene. notes: What people should know before they believe it.

    configuration: Of all stages; `training` is told no datasets, and the seed is that of the first trainings. snapshot_id: That all is read
    from.
    """

    comparison_id: str
    request: ComparisonRequest
    configuration: Configuration
    snapshot_id: int
    trainings: tuple[ComparedTraining, ...]
    episodes: Mapping[str, tuple[str, ...]]
    notes: tuple[str, ...]

    @property
    def config(self) -> ComparisonConfig:
        """The stage's config."""
        config: ComparisonConfig = self.configuration.stages[STAGE.name]
        return config


def planned_comparison(
    lake: Lake, request: ComparisonRequest, configuration: Configuration, *, snapshot_id: int | None = None, release: str | None = None
) -> PlannedComparison:
    """What comparing datasets would be, held against the lake; nothing is computed. Settings are those of the stages, with `navigation`
    as the learned system.

    Raises:
        InputError: a dataset is none of the lake, has no episodes to learn from or to be tested in, or the policies would be tested in
            rooms that one of them learned from and in no others.
    """
    training = configuration.stages["training"]
    if training.datasets:
        raise InputError(
            "--set", "training.datasets", f"is {label_of(training.datasets)}, and --train says what is learned from", "leave it"
        )
    snapshot = chosen_dataset(lake, snapshot_id, release)
    reader = snapshot.reader
    for option, names in (("--train", [name for choice in request.train for name in choice]), ("--test", request.test)):
        check_datasets(reader, names, option)
    rooms = _Rooms(reader, training.system.test_share)
    for choice in request.train:
        for name in choice:  # else a+b may be a to the last bit: two trainings, one model, and nothing to compare
            if not any(split == "train" for _, split in rooms.with_episodes(name).values()):
                problem = f"{name} adds nothing to learn from, it has no episode in a room of the split 'train'"
                raise InputError("--train", label_of(choice), problem, "leave it out, or run the stage navigation on more of its rooms")
    config: ComparisonConfig = configuration.stages[STAGE.name]
    episodes, notes = _test_episodes(snapshot, request, rooms, config)
    trainings = []
    for choice in request.train:
        for number in range(config.seeds):
            stages = {**configuration.stages, "training": dataclasses.replace(training, datasets=choice)}
            own = dataclasses.replace(configuration, stages=stages, seed=configuration.seed + number)
            planned = planned_training(lake, own, snapshot_id=None if release else snapshot.snapshot_id, release=release)
            if planned.held is not None and planned.held.is_withdrawn:
                problem = f"{planned.held.model_id[:12]}, trained on {label_of(choice)}, was withdrawn"
                raise InputError("models", "model_id", problem, "compare with another seed or other settings")
            trainings.append(ComparedTraining(label_of(choice), own.seed, planned))
    parts = [
        canonical_json([request.train, request.test, config]), *(each.planned.training_id for each in trainings),
        canonical_json([[scene, *names] for scene, names in sorted(episodes.items())]),
        content_of_episodes(snapshot.reader, episodes, configuration), code_fingerprint("tasks.comparison"),
    ]  # fmt: skip
    name = f"comparison-{digest('comparison-1', *parts)[:16]}"
    return PlannedComparison(name, request, configuration, snapshot.snapshot_id, tuple(trainings), episodes, notes)


class _Rooms:
    """Rooms of a snapshot's scenes, and the episodes in them. test_share: Of rooms, where the snapshot has no split of one."""

    def __init__(self, reader: Reader, test_share: float) -> None:
        splits = {row.room_id: row.split for row in reader.rows(Split)}
        scenes = reader.matching("scenes", {}, ["room_id"]).to_pylist()
        self.of = {row["scene_id"]: (row["room_id"], splits.get(row["room_id"]) or split_of(row["room_id"], test_share)) for row in scenes}
        self.episodes: defaultdict[str, list[str]] = defaultdict(list)
        for row in reader.matching("episodes", {}, ["episode_id"]).select(["scene_id", "episode_id"]).to_pylist():
            self.episodes[row["scene_id"]].append(row["episode_id"])

    def with_episodes(self, dataset: str) -> dict[str, tuple[str, str]]:
        """Room and split of the scenes of a dataset that have episodes."""
        return {scene: self.of[scene] for scene in sorted(self.episodes) if scene in self.of and named_dataset(scene) == dataset}


def _test_episodes(
    snapshot: LakeDataset, request: ComparisonRequest, rooms: _Rooms, config: ComparisonConfig
) -> tuple[dict[str, tuple[str, ...]], tuple[str, ...]]:
    """Test episodes by scene, and notes: of each test dataset some scenes, drawn by their names, none in a room that is learned from, also
    under another dataset's name, and of each the first episodes. More scenes or episodes come on top of fewer.
    """
    learned = {
        room_name(room)
        for name in {name for choice in request.train for name in choice}
        for room, split in rooms.with_episodes(name).values()
        if split == "train"
    }
    chosen: dict[str, tuple[str, ...]] = {}
    notes: list[str] = []
    for name in request.test:
        scenes = rooms.with_episodes(name)
        if not scenes:
            raise InputError("--test", name, f"has no episodes in {snapshot.name}", "`metascenes run` makes them, or name another dataset")
        fresh = [scene for scene, (room, _) in scenes.items() if room_name(room) not in learned]
        if not fresh:
            problem = (
                f"is trained on: all of its {counted(len(scenes), 'scene with episodes is', 'scenes with episodes are')} "
                f"in rooms that a policy learns from"
            )
            raise InputError("--test", name, problem, "test on another dataset, or leave this one out of --train")
        if len(fresh) < len(scenes):
            notes.append(
                f"{name}: {len(scenes) - len(fresh)} of {counted(len(scenes), 'scene')} "
                f"{noun(len(scenes) - len(fresh), 'is', 'are')} left out, their rooms are learned from"
            )
        some = sorted(fresh, key=lambda scene: hashlib.sha256(f"comparison {scene}".encode()).digest())[: config.scenes]
        if len(some) < config.scenes:
            notes.append(f"{name}: {counted(len(some), 'scene')} to test in, not {config.scenes}")
        own = {scene: tuple(sorted(rooms.episodes[scene])[: config.trajectories]) for scene in some}
        short = [scene for scene, names in own.items() if len(names) < config.trajectories]
        if short:
            notes.append(
                f"{name}: {counted(len(short), 'scene has', 'scenes have')} fewer "
                f"than {counted(config.trajectories, 'episode')}, {short[0]} first"
            )
        chosen |= own
    return chosen, tuple(notes)
