"""What a policy learns from: windows of walks, last actions that are not told, weights of stops, and pictures within bounds."""

from __future__ import annotations

import dataclasses
import pickle
from collections import Counter

import numpy as np
import pytest

from tasks.policy.actions import START, STOP, UNKNOWN, UNTOLD
from tasks.policy.augmentation import PictureAugmentation
from tasks.policy.demonstrations import AgentWalk
from tasks.policy.model.objective import PolicyBatchConfig, PolicyObjective, Windows, cross_entropy, seen_on, together
from tasks.policy.model.shapes import vocabulary_of
from tasks.policy.store import Store
from tests.tasks.policy.policies import MODELS, TINY, drawn_network
from tests.tasks.policy.rooms import Compass, walks

torch = pytest.importorskip("torch")

PLAIN = PictureAugmentation(0, 0, 0, 0, 1.0, 0, 0, 0)
DATA = walks()
GOALS = vocabulary_of(walk.category for walk in DATA.train)


def store(made=None, **changes) -> Store:
    given = {
        "walks": DATA.train if made is None else made, "render": Compass(), "model": TINY, "augmentation": PLAIN, "memory": {},
        "megabytes": 64, "part_steps": 5, "seed": 0, **changes,
    }  # fmt: skip
    return Store(**given)


def objective(visited=(), config=None, model=TINY, shown=None, held=None) -> PolicyObjective:
    made = shown or store(model=model)
    rest = store(list(visited), model=model)
    return PolicyObjective(made, rest, DATA.test if held is None else held, model, config or PolicyBatchConfig(windows=32), GOALS, 7)


def test_windows_show_what_was_seen_and_what_was_right() -> None:
    """Every step of a batch is found on the walk that it is of: its picture, right action, last action, and the goal."""
    made = objective(config=PolicyBatchConfig(windows=64, last_dropout=0.0, time_shift=0, unknown_share=0.0))
    batch = {name: values.numpy() for name, values in made.batch(3).items()}
    compass, found = Compass(), Counter()
    seen = {walk.name: compass("", walk.poses) for walk in DATA.train}
    for row in range(64):
        size = int((batch["targets"][row] != UNKNOWN).sum())
        first, goal = int(batch["times"][row, 0]), GOALS[int(batch["goals"][row])]
        pictures = batch["pictures"][batch["places"][row, :size]]
        assert (batch["owner"][batch["places"][row, :size]] == row).all()
        fitting = [
            walk.name
            for walk in DATA.train
            if walk.category == goal
            and walk.targets[first : first + size].tolist() == batch["targets"][row, :size].tolist()
            and walk.last[first : first + size].tolist() == batch["last"][row, :size].tolist()
            and np.array_equal(seen[walk.name][first : first + size], pictures)
        ]
        assert fitting
        assert batch["times"][row, :size].tolist() == list(range(first, first + size))
        assert (batch["last"][row, size:] == START).all()
        found[fitting[0]] += 1
    assert len(found) > 4


def test_every_step_is_in_as_many_windows_as_any_other() -> None:
    windows = Windows(DATA.train, 4)
    counts = [np.zeros(len(walk), dtype=int) for walk in DATA.train]
    sizes = set()
    for place in range(len(windows)):
        number, first, end = windows.at(place)
        counts[number][first:end] += 1
        sizes.add(end - first)
    assert {int(count) for part in counts for count in part} == {4}
    assert sizes == {1, 2, 3, 4}
    assert len(Windows([], 4)) == 0


def test_a_batch_follows_from_seed_and_step_wherever_it_is_made() -> None:
    made = objective(shown=store(augmentation=PictureAugmentation()))
    other = pickle.loads(pickle.dumps(objective(shown=store(augmentation=PictureAugmentation()))))
    for step in (9, 0, 4):
        assert all(torch.equal(values, other.batch(step)[name]) for name, values in made.batch(step).items())
    assert not torch.equal(made.batch(0)["targets"], made.batch(1)["targets"])
    changed = dataclasses.replace(made, seed=8)
    assert not torch.equal(made.batch(0)["targets"], changed.batch(0)["targets"])


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_so_many_last_actions_are_not_told(share: float) -> None:
    made = objective(config=PolicyBatchConfig(windows=200, last_dropout=share))
    batch = made.batch(0)
    counts = batch["targets"] >= 0
    goal_tokens = (batch["last"] != UNTOLD)[counts].float().mean()
    assert float(goal_tokens) == pytest.approx(1 - share, abs=0.06)


def test_steps_are_counted_from_anywhere_and_some_goals_are_hidden() -> None:
    batch = objective(config=PolicyBatchConfig(windows=300, time_shift=1000, unknown_share=0.3)).batch(0)
    counts = batch["targets"] >= 0
    first = batch["times"][:, 0]
    assert (batch["times"] - first[:, None])[counts].max() == TINY.window - 1
    assert (int(first.min()) < 100, int(first.max()) > 900) == (True, True)
    assert float((batch["goals"] == 0).float().mean()) == pytest.approx(0.3, abs=0.08)


def test_stops_weigh_as_much_as_is_said() -> None:
    logits = torch.randn(2, 3, 4, generator=torch.Generator().manual_seed(0))
    targets = torch.tensor([[0, STOP, 1], [2, 2, UNKNOWN]])
    each = -logits.log_softmax(-1).gather(-1, targets.clamp(min=0)[..., None])[..., 0]
    weights = torch.tensor([[1.0, 3.0, 1.0], [1.0, 1.0, 0.0]])
    assert float(cross_entropy(logits, targets, 3.0)) == pytest.approx(float((each * weights).sum() / weights.sum()))
    assert float(cross_entropy(logits, targets, 1.0)) == pytest.approx(float(each[targets >= 0].mean()))
    more = torch.autograd.functional.jacobian(lambda values: cross_entropy(values, targets, 9.0), logits)
    assert float(more[1, 2].abs().max()) == 0.0


def test_filled_up_steps_teach_nothing() -> None:
    module, rng = drawn_network(TINY, GOALS), np.random.default_rng(0)
    parts = [
        {
            "pictures": rng.integers(0, 256, (size, 16, 16, 3), dtype=np.uint8), "last": rng.integers(0, 6, size), "times": np.arange(size),
            "goals": np.array(1), "targets": rng.integers(0, 4, size),
        }
        for size in (2, 4)
    ]  # fmt: skip
    batch = {name: torch.from_numpy(values) for name, values in together(parts, 4).items()}
    odd = dict(batch)
    odd["places"], odd["last"], odd["times"] = batch["places"].clone(), batch["last"].clone(), batch["times"].clone()
    odd["places"][0, 2:], odd["last"][0, 2:], odd["times"][0, 2:] = 5, 2, 99
    with torch.no_grad():
        losses = [float(cross_entropy(module(each), batch["targets"], 3.0)) for each in (batch, odd)]
    assert losses[0] == losses[1]


def test_own_walks_have_their_share_once_there_are_some() -> None:
    visited = [dataclasses.replace(walk, category="nowhere") for walk in DATA.train[:6]]
    made = objective(visited, PolicyBatchConfig(windows=40, unknown_share=0.0, corrected_share=0.25))
    assert int((made.batch(0)["goals"] == 0).sum()) == 10
    assert int((objective((), PolicyBatchConfig(windows=40, unknown_share=0.0)).batch(0)["goals"] == 0).sum()) == 0


def test_pictures_in_memory_keep_within_bounds_and_all_scenes_have_their_turn() -> None:
    long = [AgentWalk(f"a/{n}", f"a/{n}", "0000", "chair", np.zeros((500, 3)), np.zeros(500, int), np.zeros(500, int)) for n in range(7)]
    compass = Compass()
    made = store(long, render=compass, megabytes=1, part_steps=3)  # a scene has 384 kB: two are in a megabyte
    parts = [tuple(made.part(step)) for step in range(24)]
    assert all(parts[step] == parts[step - step % 3] for step in range(24))
    assert sorted(number for step in range(0, 12, 3) for number in parts[step]) == list(range(7))
    assert sorted(number for step in range(12, 24, 3) for number in parts[step]) == list(range(7))
    assert parts[0] != parts[12] or parts[3] != parts[15]
    assert max(map(len, parts)) == 2
    for step in range(12):
        for number in made.part(step):
            made.of(number)
            assert sum(seen.nbytes for kept in made._kept.values() for part in kept.values() for seen in part) <= 1 << 20
    assert compass.calls == 7 * 500
    assert store(long, megabytes=64).part(0) != store(long, megabytes=64, seed=1).part(0)


def test_validation_is_of_all_steps_and_nothing_is_drawn() -> None:
    made, module = objective(), drawn_network(TINY, GOALS)
    value = made.validate(module)
    assert value == made.validate(module)
    assert 0.0 <= value <= 1.0
    assert objective(held=[]).validate(module) is None
    blind = MODELS["blind"]
    assert objective(model=blind).validate(drawn_network(blind, GOALS)) is not None
    compass = Compass()
    assert len(list(seen_on(DATA.train, store(render=compass)))) == len(DATA.train)
    assert compass.calls == sum(map(len, DATA.train))
