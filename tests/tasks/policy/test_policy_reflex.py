"""Agents that run against something turn aside, farther each time, and step on; who does not is left alone."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from schemas.evaluation import ACTIONS
from tasks.evaluation.configuration import EvaluationConfig
from tasks.navigation.follower import FollowedPath, replay
from tasks.policy.actions import FORWARD, LEFT, RIGHT, STOP
from tasks.policy.reflex import FORGOTTEN, MOST_TURNS, Reflex
from tasks.policy.rollout import rolled_out
from tests.tasks.policy.policies import MODELS, TINY
from tests.tasks.policy.rooms import navigated
from tests.tasks.policy.test_policy_rollout import Reciting, world_in

STILL = np.zeros((1, 2, 2, 3), dtype=np.uint8)


def wants(*actions: int, other: int = RIGHT) -> np.ndarray:
    """Logits of agents, each of which wants an action most and another one second most."""
    return np.array([[3.0 if a == action else 2.0 if a == other else 0.0 for a in range(len(ACTIONS))] for action in actions], np.float32)


def drawn(number: int) -> np.ndarray:
    return np.full((1, 2, 2, 3), number % 251, dtype=np.uint8)


def test_who_runs_against_something_turns_to_the_likelier_side_one_turn_more_each_time_and_steps_on() -> None:
    reflex, seen, done = Reflex(1), 0, ""
    for _ in range(30):  # no step forward leads anywhere, each turn shows something else
        action = int(reflex.chosen(wants(FORWARD), drawn(seen))[0])
        seen += action != FORWARD
        done += {FORWARD: "f", RIGHT: "r", LEFT: "l", STOP: "s"}[action]
    assert done == "frfrrfrrrfrrrrfrrrrrfrrrrrfrrr", "no more than MOST_TURNS"


class Corner:
    """A stand-in for a place that one gets out of to one side only: pictures are of heading and place, and four headings are blocked."""

    def __init__(self) -> None:
        self.heading, self.out = 0, 0

    def picture(self) -> np.ndarray:
        return np.full((1, 2, 2, 3), (12 * self.out + self.heading) % 251, dtype=np.uint8)

    def do(self, action: int) -> None:
        if action == LEFT:
            self.heading = (self.heading + 1) % 12
        elif action == RIGHT:
            self.heading = (self.heading - 1) % 12
        elif action == FORWARD and not (self.heading <= 3 or self.heading >= 9):
            self.out += 1


def test_a_policy_that_always_steps_forward_comes_out_of_a_corner() -> None:
    corner, reflex = Corner(), Reflex(1)
    for _ in range(60):
        corner.do(int(reflex.chosen(wants(FORWARD), corner.picture())[0]))
    assert corner.out > 20, "and goes on straight where nothing is in its way"


def test_a_policy_that_turns_back_at_once_comes_out_all_the_same() -> None:
    """It wants to face what it runs against: heading 0."""
    corner, reflex = Corner(), Reflex(1)
    for _ in range(200):
        wanted = FORWARD if corner.heading == 0 else RIGHT if corner.heading <= 6 else LEFT
        corner.do(int(reflex.chosen(wants(wanted), corner.picture())[0]))
    assert corner.out >= 1


@given(st.lists(st.integers(0, 3), min_size=1, max_size=60))
def test_nothing_changes_for_who_always_sees_something_else_and_stopping_is_never_kept_from_anybody(
    steps: list[int],
) -> None:
    free, held = Reflex(1), Reflex(1)
    for number, wanted in enumerate(steps):
        assert free.chosen(wants(wanted), drawn(number))[0] == wanted
        acted = int(held.chosen(wants(wanted), STILL)[0])
        assert acted == wanted or (wanted != STOP and acted in (LEFT, RIGHT, FORWARD))
        assert (acted == STOP) == (wanted == STOP)


@given(st.integers(0, 10**6), st.integers(2, 6))
def test_each_has_a_reflex_of_its_own_and_keeps_it_when_others_go(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    together, alone = Reflex(n), [Reflex(1) for _ in range(n)]
    going = np.arange(n)
    for _ in range(40):
        pictures = rng.integers(0, 2, (n, 1, 1, 1), dtype=np.uint8)
        logits = rng.normal(size=(n, 4)).astype(np.float32) + 2.0 * np.eye(4, dtype=np.float32)[FORWARD]
        acted = together.chosen(logits[going], pictures[going])
        assert acted.tolist() == [int(alone[a].chosen(logits[a : a + 1], pictures[a : a + 1])[0]) for a in going]
        if len(going) > 1 and rng.random() < 0.1:
            kept = np.sort(rng.permutation(len(going))[: len(going) - 1])
            together.keep(kept)
            going = going[kept]


def test_it_turns_no_farther_than_around_and_forgets() -> None:
    reflex, still = Reflex(1), drawn(1)
    turns, longest = 0, 0
    for _ in range(120):
        acted = int(reflex.chosen(wants(FORWARD), still)[0])
        turns = turns + 1 if acted in (LEFT, RIGHT) else 0
        longest = max(longest, turns)
    assert longest == MOST_TURNS
    for step in range(FORGOTTEN + 2):
        assert int(reflex.chosen(wants(FORWARD), drawn(2 + step))[0]) in (FORWARD, RIGHT)
    before = drawn(99)
    reflex.chosen(wants(FORWARD), before)
    assert [int(reflex.chosen(wants(FORWARD), picture)[0]) for picture in (before, drawn(98), drawn(97))] == [RIGHT, FORWARD, FORWARD]


class Pushing(Reciting):
    """Always wants to step forward."""

    def wanted(self) -> np.ndarray:
        return np.full(len(self.going), FORWARD)

    def did(self, actions: np.ndarray) -> None:
        assert actions.shape == (len(self.going),)


def test_a_policy_turns_aside_unless_it_is_told_not_to_and_who_sees_nothing_never_does() -> None:
    world, episodes = world_in(navigated()), navigated()[0]["episodes"]

    def acted(*, aside: bool, blind: bool = False) -> list[FollowedPath]:
        actor = Pushing(episodes)
        actor.config = MODELS["blind"] if blind else TINY
        config = EvaluationConfig(max_steps=80, turns_aside=aside)
        done = rolled_out(world, actor, episodes, config)  # type: ignore[arg-type]
        paths = [
            replay(attempt.actions, world.start(episode), episode.start_yaw_radians, world.finder, config.motion)
            for attempt, episode in zip(done, episodes, strict=True)
        ]
        assert all({*attempt.actions} == {"forward"} for attempt in done) == (blind or not aside)
        return paths

    pushed, aside = acted(aside=False), acted(aside=True)
    assert sum(path.collisions for path in aside) < 0.3 * sum(path.collisions for path in pushed)
    assert all(turned.length > path.length for turned, path in zip(aside, pushed, strict=True))
    assert [path.poses.tolist() for path in acted(aside=True, blind=True)] == [path.poses.tolist() for path in pushed]
