"""Paired tests against SciPy's and against brute force, and the stage and its views against plain Python over made-up rows."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import binomtest, ttest_rel

from schemas.comparison import ComparedRun, PairedTest
from schemas.errors import InputError
from schemas.evaluation import Trajectory
from schemas.record import check
from schemas.training import LearnedModel
from tasks.comparison import ComparisonConfig, outcome_of, run
from tasks.comparison.paired import EXACT, mcnemar, sign_flips, whole_flips
from tasks.stage import Context
from tests.samples import fingerprint, sample
from tests.warehouse.questions.view_answers import EXACT as NUMBERS
from tests.warehouse.questions.view_answers import Database, by_key

NAME = "comparison-0123456789abcdef"
CONTEXT = Context(NAME, "comparison", 0, {})
FEW = ComparisonConfig(draws=500)
SETS = ("alpha", "alpha+beta", "beta")


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@given(st.integers(0, 400), st.integers(0, 400))
@settings(max_examples=60, deadline=None)
def test_mcnemar_is_the_exact_binomial_test_of_pairs_that_differ(only_first: int, only_second: int) -> None:
    if only_first + only_second == 0:
        assert mcnemar(0, 0) == 1.0
    else:
        count = only_first + only_second
        tail = sum(math.comb(count, k) for k in range(min(only_first, only_second) + 1))
        assert mcnemar(only_first, only_second) == pytest.approx(min(1.0, 2 * tail / 2**count), rel=1e-9)
    assert mcnemar(only_first, only_second) == mcnemar(only_second, only_first)


@given(st.lists(st.integers(-64, 64).map(lambda n: n / 64), min_size=1, max_size=12))
@settings(max_examples=40, deadline=None)
def test_few_flips_are_all_tried(differences: list[float]) -> None:
    found = sign_flips(differences, generator(), 1)
    if not any(differences):
        assert found == 1.0
        return
    values = np.array(differences)
    sums = [abs(float(np.dot(signs, values))) for signs in itertools.product((-1, 1), repeat=len(values))]
    assert found == pytest.approx(min(1.0, np.mean(np.array(sums) >= abs(values.sum()) - 1e-9) if values.sum() else 1.0))
    assert sign_flips(np.concatenate([differences, np.zeros(5)]), generator(), 1) == found, "pairs that are alike say nothing"


def test_many_flips_are_drawn_and_come_near_to_what_the_t_test_says() -> None:
    for shift in (0.0, 0.08, 0.16):
        values = generator(5).normal(shift, 0.6, size=180)
        assert len(values) > EXACT
        found = sign_flips(values, generator(), 20_000)
        assert found == pytest.approx(ttest_rel(values, np.zeros_like(values)).pvalue, abs=0.015)
        signs = generator(7).choice((-1, 1), size=(4000, len(values)))
        assert found == pytest.approx(np.mean(np.abs(signs @ values) >= abs(values.sum())), abs=0.03)
    assert found == sign_flips(generator(1).permutation(values), generator(), 20_000), "the order of pairs changes nothing"
    assert sign_flips(values + 10, generator(), 499) == pytest.approx(2 / 500), "never 0: the flip that was seen is one of them"


def test_where_both_are_alike_p_is_spread_evenly() -> None:
    many = [sign_flips(generator(seed).normal(size=30), generator(seed + 1000), 400) for seed in range(300)]
    assert [np.mean(np.array(many) <= level) for level in (0.05, 0.2, 0.5)] == pytest.approx([0.05, 0.2, 0.5], abs=0.07)


def test_a_lucky_seed_passes_for_a_better_dataset_by_scene_and_not_by_seed() -> None:
    """Two trainings of each seed on one dataset: what they reach differs by luck alone, the same in all scenes."""
    scenes, episodes, seeds, trials = 8, 6, 6, 150
    place, training = (axis.ravel() for axis in np.indices((scenes, seeds, episodes))[:2])
    by_scene, by_seed = [], []
    for trial in range(trials):
        rng = generator(trial)
        lucky = rng.normal(0.3, 0.1, size=(2, seeds))[:, training].clip(0, 1)
        difference = np.subtract(*(rng.random(lucky.shape) < lucky).astype(float))
        by_scene.append(whole_flips(difference, place, generator(), 1))
        by_seed.append(whole_flips(difference, training, generator(), 1))
    low = [np.mean(np.array(values) <= 0.05) for values in (by_scene, by_seed)]
    assert low[0] > 0.12, "by scene it is these models that differ, and they do"
    assert low[1] < 0.08, "the datasets do not"
    assert min(by_seed) == pytest.approx(2 / 2**seeds), "and fewer seeds can never give less"


def test_one_unit_says_nothing_of_others() -> None:
    assert whole_flips([1.0, 0.5, 1.0], [0, 0, 0], generator(), 1) is None
    assert whole_flips([1.0, 0.5, 1.0], [0, 1, 0], generator(), 1) == 0.5
    assert whole_flips([1.0, 0.5, 1.0], [0, 1, 2], generator(), 1) == 0.25, "the least that three seeds can give"


@st.composite
def compared(draw: st.DrawFn) -> tuple[list[ComparedRun], list[Trajectory], list[LearnedModel]]:
    """Who was compared and what they did: the same episodes for all sets and seeds."""
    scenes = {f"{dataset}/{number}": draw(st.integers(1, 3)) for dataset in ("gamma", "delta") for number in range(draw(st.integers(0, 2)))}
    seeds, sets = draw(st.integers(1, 2)), SETS[: draw(st.integers(2, 3))]
    runs, rows, models = [], [], []
    for label, seed in itertools.product(sets, range(seeds)):
        model = sample(LearnedModel, model_id=fingerprint(label, seed), kind="navigation", architecture="small", is_withdrawn=False)
        models.append(model)
        for scene, episodes in scenes.items():
            batch = f"navigation-{fingerprint(label, seed, scene)[:16]}"
            runs.append(
                ComparedRun(
                    comparison_id=NAME, trained_on=label, seed=seed, scene_id=scene, model_id=model.model_id,
                    training_id=f"navigation-{seed}", batch_id=batch, episodes=episodes,
                )
            )  # fmt: skip
            for number in range(episodes):
                start, travelled = draw(NUMBERS), draw(NUMBERS)
                actions = ("forward",) * draw(st.integers(0, 2)) + (("stop",) if draw(st.booleans()) else ())
                rows.append(
                    sample(
                        Trajectory, batch_id=batch, scene_id=scene, episode_id=f"{number:04d}", policy="navigation", actions=actions,
                        run_name=model.model_id[:12], poses=tuple((0.5 * at, 0.0, 0.0) for at in range(len(actions) + 1)),
                        called_stop=actions[-1:] == ("stop",), final_distance_m=draw(st.sampled_from((None, 0.05, 0.15, 0.3))),
                        success_distance_m=0.2, start_distance_m=start, travelled_m=travelled, expert_actions=draw(st.integers(0, 4)),
                        is_target_seen=draw(st.sampled_from((None, False, True))),
                    )
                )  # fmt: skip
    return runs, rows, models


@given(compared())
@settings(max_examples=25, deadline=None)
def test_means_and_tests_are_those_of_the_trajectories(
    database: Database, made: tuple[list[ComparedRun], list[Trajectory], list[LearnedModel]]
) -> None:
    runs, rows, models = made
    outcome = run(compared_batches=runs, trajectories=rows, context=CONTEXT, config=FEW)
    tests: list[PairedTest] = outcome.rows["paired_tests"]
    check(tests, PairedTest)
    elsewhere = [
        dataclasses.replace(row, batch_id=f"of-nobody-{row.batch_id}") for row in rows
    ]  # trajectories that were not compared count for nothing
    database.fill(*runs, *rows, *elsewhere, *models, *tests)
    per_row = by_key(
        database.ask("SELECT * FROM trajectory_metrics WHERE batch_id NOT LIKE 'of-nobody%'"), "batch_id", "scene_id", "episode_id"
    )
    for row in rows:
        measured = per_row[row.batch_id, row.scene_id, row.episode_id]
        assert (outcome_of(row).success, outcome_of(row).spl) == (float(measured["success"]), pytest.approx(measured["spl"]))
    found = by_key(database.ask("navigation_comparison"), "comparison_id", "trained_on", "tested_on")
    groups: dict[tuple[str, str, str], list[tuple[int, dict[str, Any]]]] = {}
    for each in runs:
        own = [value for (batch, scene, _), value in per_row.items() if (batch, scene) == (each.batch_id, each.scene_id)]
        assert len(own) == each.episodes
        key = NAME, each.trained_on, each.scene_id.split("/")[0]
        groups.setdefault(key, []).extend((each.seed, value) for value in own)
    assert found.keys() == groups.keys()
    for key, group in groups.items():
        row, values = found[key], [value for _, value in group]
        seeds = {seed for seed, _ in group}
        shares = [np.mean([value["success"] for own, value in group if own == seed]) for seed in seeds]
        assert (row["n"], row["seeds"], row["architecture"]) == (len(group), len(seeds), "small")
        assert row["episodes"] * row["seeds"] == row["n"]
        assert (row["least_sr"], row["greatest_sr"]) == pytest.approx((min(shares), max(shares)))
        for name, of in (("sr", "success"), ("spl", "spl"), ("sel", "sel"), ("el", "episode_length"),
                         ("curvature_turning_angle_per_m", "curvature_turning_angle_per_m")):  # fmt: skip
            assert row[name] == pytest.approx(np.mean([float(value[of]) for value in values]))
        for end in (row["sr_low"], row["sr_high"]):  # Wilson's ends p solve |sr - p| = z sqrt(p (1 - p) / n)
            if 0 < end < 1:
                assert abs(row["sr"] - end) == pytest.approx(1.96 * math.sqrt(end * (1 - end) / len(group)), rel=1e-6)
        looked = [value["found"] for value in values if value["found"] is not None]
        assert row["found_share"] == (pytest.approx(np.mean(looked)) if looked else None)
    asked = database.ask("navigation_comparison_tests")
    assert (
        len(asked) == len(tests) == 2 * len({key[2] for key in groups}) * math.comb(len({each.trained_on for each in runs}), 2) * bool(runs)
    )
    for test in asked:
        sides = []
        for label in (test["first"], test["second"]):
            own = {
                (e.scene_id, e.seed): e.batch_id for e in runs if e.trained_on == label and e.scene_id.startswith(f"{test['tested_on']}/")
            }
            sides.append({(scene, seed, episode): float(value[test["measure"]]) for (scene, seed), batch in own.items()
                          for (of, where, episode), value in per_row.items() if (of, where) == (batch, scene)})  # fmt: skip
        assert sides[0].keys() == sides[1].keys()
        differences = {key: sides[0][key] - sides[1][key] for key in sides[0]}
        assert test["pairs"] == len(differences)
        assert test["difference"] == pytest.approx(np.mean(list(differences.values())), abs=1e-12)
        wins = sum(value > 0 for value in differences.values()), sum(value < 0 for value in differences.values())
        assert (test["only_first"], test["only_second"]) == wins
        for name, at in (("scene", 0), ("seed", 1)):
            units = {key[at] for key in differences}
            sums = [sum(value for key, value in differences.items() if key[at] == unit) for unit in units]
            assert test[f"{name}s"] == len(units)
            assert test[f"p_value_by_{name}"] == (pytest.approx(sign_flips(sums, generator(), 1)) if len(units) > 1 else None)
        if test["measure"] == "success":
            assert test["p_value"] == pytest.approx(binomtest(wins[0], sum(wins)).pvalue if sum(wins) else 1.0)
        else:
            assert test["p_value"] == pytest.approx(sign_flips(list(differences.values()), generator(), 1))
    database.fill(*runs, *rows, *[dataclasses.replace(model, is_withdrawn=True) for model in models[:1]], *models[1:], *tests)
    assert database.ask("navigation_comparison") == database.ask("navigation_comparison_tests") == []


def test_who_was_not_in_the_same_episodes_is_not_compared() -> None:
    def row(batch: str, episode: str) -> Trajectory:
        made: Trajectory = sample(Trajectory, batch_id=batch, scene_id="gamma/one", episode_id=episode)
        return made

    runs = [sample(ComparedRun, comparison_id=NAME, trained_on=name, seed=0, scene_id="gamma/one", batch_id=name, episodes=1)
            for name in ("alpha", "beta")]  # fmt: skip
    with pytest.raises(InputError, match="were not in the same episodes of gamma"):
        run(compared_batches=runs, trajectories=[row("alpha", "0000"), row("beta", "0001")], context=CONTEXT, config=FEW)
    with pytest.raises(InputError, match="beta: has 0 trajectories in gamma/one, and 1 episodes were to be done"):
        run(compared_batches=runs, trajectories=[row("alpha", "0000")], context=CONTEXT, config=FEW)
