"""Comparison: policies that learned from different datasets, held against each other in the same episodes (supplementary, Table A4).

Who was compared are rows; means are SQL over their trajectories (`warehouse/questions/views/navigation_comparison.sql`).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np

from schemas.comparison import ComparedRun, PairedTest
from schemas.errors import InputError
from schemas.evaluation import Trajectory
from tasks.comparison.paired import mcnemar, sign_flips, whole_flips
from tasks.settings import Config, Count
from tasks.stage import Context, Outcome, Stage


@dataclasses.dataclass(frozen=True)
class ComparisonConfig(Config):
    """How much is compared."""

    seeds: Count = 3  # trainings on each choice of datasets: one alone may be luck
    scenes: Count = 10  # of each test dataset; as in Table A4
    trajectories: Count = 10  # in each of these; as in Table A4
    draws: Count = 20_000  # of signs, where there are too many to try all: a p value of 0.05 is known to 0.0015 then


PairKey = tuple[str, str, int]
"""Scene, episode and seed."""


@dataclasses.dataclass(frozen=True)
class PairOutcome:
    """What came of one attempt: whether it succeeded, and success weighted by path length."""

    success: float
    spl: float


def outcome_of(row: Trajectory) -> PairOutcome:
    """Success and SPL of a trajectory, as the view `trajectory_metrics` has them."""
    final = row.final_distance_m
    if not row.called_stop or final is None or not final < row.success_distance_m:
        return PairOutcome(0.0, 0.0)
    longest = max(row.travelled_m, row.start_distance_m)
    return PairOutcome(1.0, row.start_distance_m / longest if longest else 1.0)


def run(
    *, compared_batches: Sequence[ComparedRun], trajectories: Sequence[Trajectory], context: Context, config: ComparisonConfig
) -> Outcome:
    """Who was compared, and a test of each two choices of datasets for each test dataset. `context.scene_id` is the comparison.

    `trajectories` are those of the batches.

    Raises:
        InputError: a batch does not have the episodes that the others have.
    """
    by_batch: defaultdict[tuple[str, str], list[Trajectory]] = defaultdict(list)
    for row in trajectories:
        by_batch[row.batch_id, row.scene_id].append(row)
    outcomes: defaultdict[str, defaultdict[str, dict[PairKey, PairOutcome]]] = defaultdict(lambda: defaultdict(dict))
    for each in compared_batches:
        tested_on = each.scene_id.partition("/")[0]
        done = by_batch[each.batch_id, each.scene_id]
        if len(done) != each.episodes:
            problem = f"has {len(done)} trajectories in {each.scene_id}, and {each.episodes} episodes were to be done"
            raise InputError("trajectories", each.batch_id, problem, "run the comparison again")
        for row in done:
            outcomes[tested_on][each.trained_on][row.scene_id, row.episode_id, each.seed] = outcome_of(row)
    tests: list[PairedTest] = []
    for tested_on, of_set in sorted(outcomes.items()):
        for first, second in itertools.combinations(sorted(of_set), 2):
            if of_set[first].keys() != of_set[second].keys():
                problem = f"policies trained on {first} and {second} were not in the same episodes of {tested_on}"
                raise InputError("compared_runs", context.scene_id, problem, "run the comparison again")
            tests += paired_tests(of_set[first], of_set[second], context, config, tested_on=tested_on, first=first, second=second)
    return Outcome(compared_runs=compared_batches, paired_tests=tests)


def paired_tests(
    first_of: Mapping[PairKey, PairOutcome], second_of: Mapping[PairKey, PairOutcome], context: Context, config: ComparisonConfig,
    *, tested_on: str, first: str, second: str,
) -> list[PairedTest]:  # fmt: skip
    """A row for each measure, of outcomes of the same episodes and seeds. The names are those of the row."""
    keys = sorted(first_of)
    scenes = sorted({scene for scene, _, _ in keys})
    seeds = sorted({seed for _, _, seed in keys})
    place = np.array([scenes.index(scene) for scene, _, _ in keys])
    training = np.array([seeds.index(seed) for _, _, seed in keys])
    rows = []
    for measure in ("success", "spl"):
        values = np.array([[getattr(first_of[key], measure), getattr(second_of[key], measure)] for key in keys])
        difference = values[:, 0] - values[:, 1]
        wins = int((difference > 0).sum()), int((difference < 0).sum())
        rng = context.rng(tested_on, first, second, measure)
        p_value = mcnemar(*wins) if measure == "success" else sign_flips(difference, rng, config.draws)
        by_scene, by_seed = (whole_flips(difference, units, rng, config.draws) for units in (place, training))
        rows.append(
            PairedTest(
                comparison_id=context.scene_id, tested_on=tested_on, first=first, second=second, measure=measure, pairs=len(keys),
                scenes=len(scenes), seeds=len(seeds), first_mean=float(values[:, 0].mean()), second_mean=float(values[:, 1].mean()),
                only_first=wins[0], only_second=wins[1], p_value=p_value, p_value_by_scene=by_scene, p_value_by_seed=by_seed,
            )
        )  # fmt: skip
    return rows


STAGE = Stage(
    name="comparison",
    reads=("trajectories",),
    writes=("compared_runs", "paired_tests"),
    config=ComparisonConfig,
    run=run,
    grain="comparison",
    outside=("compared_batches",),
)
