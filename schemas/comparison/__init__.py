"""Rows of the comparison stage: policies that learned from different datasets, in the same episodes."""

from __future__ import annotations

from schemas.record import SCENE_PATTERN, column, record
from schemas.training import HASH

NAME_PATTERN = r"[A-Za-z0-9][A-Za-z0-9_.-]*"

MEASURES = ("success", "spl")
"""What pairs are held against each other by."""


@record(
    "compared_runs", key=("comparison_id", "trained_on", "seed", "scene_id"), stage="comparison", grain="comparison", rule="append"
)  # fmt: skip
class ComparedRun:
    """A policy in the episodes of one test scene. Its trajectories are those of the batch."""

    comparison_id: str = column(
        "Comparison: of datasets, test scenes and episodes by their content, settings, code and seeds", pattern=NAME_PATTERN
    )
    trained_on: str = column("Datasets that the policy learned from, in alphabetical order, with + between them")
    seed: int = column("Seed that it was trained with")
    scene_id: str = column("Scene that it was tested in", pattern=SCENE_PATTERN)
    model_id: str = column("Model that acted", pattern=HASH)
    training_id: str = column("Training that the model came from", pattern=NAME_PATTERN)
    batch_id: str = column("Trajectory batch with what it did", pattern=NAME_PATTERN)
    episodes: int = column("Episodes that it acted in, the same for all that are compared", minimum=1)


@record(
    "paired_tests", key=("comparison_id", "tested_on", "first", "second", "measure"), stage="comparison", grain="comparison", rule="append"
)  # fmt: skip
class PairedTest:
    """Two training datasets held against each other: policies of one seed in one episode are a pair."""

    comparison_id: str = column("Comparison", pattern=NAME_PATTERN)
    tested_on: str = column("Dataset of the test scenes")
    first: str = column("Datasets that the one policy of each pair learned from")
    second: str = column("Datasets that the other learned from")
    measure: str = column("What is compared: success, or success weighted by path length", values=MEASURES)
    pairs: int = column("Pairs: episodes times seeds", minimum=1)
    scenes: int = column("Scenes that these are in", minimum=1)
    seeds: int | None = column("Trainings on each choice of datasets", minimum=1)
    first_mean: float = column("Mean over the pairs of what the first reached", minimum=0, maximum=1)
    second_mean: float = column("Mean over the pairs of what the second reached", minimum=0, maximum=1)
    only_first: int = column("Pairs in which the first was better", minimum=0)
    only_second: int = column("Pairs in which the second was better", minimum=0)
    p_value: float = column(
        "Of these models, in episodes like these: probability of a difference as large where both are alike, pairs taken as "
        "independent: McNemar's exact test of success, flips of signs for the rest",
        minimum=0, maximum=1,
    )  # fmt: skip
    p_value_by_scene: float | None = column(
        "Of these models, in other scenes: all pairs of a scene count as one, signs of whole scenes are flipped; at least 2 / 2^scenes, "
        "missing for one scene. It says nothing of other trainings: a lucky seed is better in all scenes",
        minimum=0, maximum=1,
    )  # fmt: skip
    p_value_by_seed: float | None = column(
        "Of the datasets, in other trainings on them, in these scenes: all pairs of a seed count as one, signs of whole seeds are "
        "flipped; at least 2 / 2^seeds, 0.25 for three, missing for one seed",
        minimum=0, maximum=1,
    )  # fmt: skip
