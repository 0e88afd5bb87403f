"""The benchmark of policies: cameras, steps, policies in held-out rooms, datasets held against each other, kills. All of it is kept."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.goals import goal
from bench.machine import machine
from bench.policy.acting import EXPERT, FACING, RANDOM, acted_figures, acted_runs, acting_in, failures, points_between
from bench.policy.compared import ComparisonBench, measure_comparison
from bench.policy.datasets import check_house
from bench.policy.frames import FramesBench, measure_frames
from bench.policy.killed import ADVANCES, KillsBench, measure_kills
from bench.policy.rooms import PolicyRooms, make_rooms
from bench.policy.steps import StepsBench, measure_steps
from bench.policy.trainings import BLIND, DAGGER, SENSING, SMALL, USUAL, PolicyTraining, trained_variants, variant_row
from schemas.errors import InputError
from schemas.navigation import Episode

FRAMES, STEPS, LOOP, COMPARED, KILLED = "frames", "steps", "loop", "compared", "killed"

PARTS = (FRAMES, STEPS, LOOP, COMPARED, KILLED)
"""What can be measured: pictures, steps of environments, policies in held-out rooms, what datasets are worth to them, and what kills
leave."""

ROOMS = {"train": 60, "test": 15}
"""Rooms that are wanted, by split."""

COMPARED_ROOMS = 24
"""Of each dataset that is learned from, at most: a replica costs a minute."""

SEEDS = 3
FOUND_IN_VIEW, FOUND, SPL_POINTS, ACCURACY, BLIND_POINTS = 60.0, 40.0, 10.0, 85.0, 15.0
"""What is wanted of the agent [%]: targets found when they are in view at the start, and of all; points that SPL is below that; right
actions; points above who does not see."""


@dataclasses.dataclass(frozen=True)
class PolicyBench:
    """What is measured. folder: of rooms, models and trajectories, from which the same command goes on. rooms: that are generated; a fifth
    of them is held out. seeds: trainings of each variant. steps: of each training before corrections; 0 for the system's own. variants: of
    `VARIANTS`. realdata: folder with the AWS small house, for pictures; None for none. parts: of `PARTS`. episodes: of a room to learn
    from; a held-out one has half as many. max_steps: that an agent may take; 0 for the evaluation's own."""

    folder: Path
    rooms: int = 75
    seeds: int = SEEDS
    steps: int = 0
    variants: tuple[str, ...] = USUAL
    seed: int = 0
    processes: int = 1
    realdata: Path | None = None
    parts: tuple[str, ...] = PARTS
    episodes: int = 100
    max_steps: int = 0

    @property
    def data(self) -> PolicyRooms:
        """Rooms that are learned from and acted in."""
        return PolicyRooms(self.folder, self.rooms, self.seed, self.episodes)

    @property
    def frames(self) -> FramesBench:
        """What is measured of cameras."""
        return FramesBench(realdata=None if self.realdata is None else str(self.realdata), seed=self.seed)

    @property
    def comparison(self) -> ComparisonBench | None:
        """What is compared, if the house is named in which policies are tested."""
        if self.realdata is None:
            return None
        rooms = min(self.rooms, COMPARED_ROOMS)
        return ComparisonBench(self.folder, self.realdata, rooms, self.seeds, self.steps, self.seed, self.processes, self.episodes)

    @property
    def trainings(self) -> list[PolicyTraining]:
        """What is trained."""
        return [PolicyTraining(name, seed, self.steps, self.episodes) for name in self.variants for seed in range(self.seeds)]

    @property
    def advances(self) -> int:
        """How often the benchmark advances."""
        loop = self.rooms + 2 * len(self.trainings) + self.seeds + len((EXPERT, FACING))
        compared = 1 if self.comparison is None else self.comparison.advances
        counts = {FRAMES: self.frames.scenes, STEPS: 1, LOOP: loop, COMPARED: compared, KILLED: ADVANCES}
        return sum(counts[part] for part in self.parts)


def run_policy_bench(config: PolicyBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """The report. `advance` is told each part of it that is done.

    Raises:
        InputError: the house is not where it should be, no room is learned from, or a training fails.
        LakeError: a command of those that are killed fails by itself.
    """
    if LOOP in config.parts and config.rooms < 2:
        raise InputError("bench policy", "--rooms", f"{config.rooms}: one is held out, and none is left to learn from", "ask for 2 or more")
    if COMPARED in config.parts and config.realdata is not None:
        check_house(config.realdata)
    parts: dict[str, dict[str, Any]] = {}
    if FRAMES in config.parts:
        parts[FRAMES] = measure_frames(config.frames, partial(advance, "pictures"))
    if STEPS in config.parts:
        parts[STEPS] = measure_steps(StepsBench(seed=config.seed))
        advance("steps of environments")
    if LOOP in config.parts:
        parts[LOOP] = measure_loop(config, advance)
    if COMPARED in config.parts:
        parts[COMPARED] = measure_compared(config, advance)
    if KILLED in config.parts:
        parts[KILLED] = measure_kills(KillsBench(config.folder, seed=config.seed), advance)
    return {
        "machine": machine(), "seed": config.seed, "processes": config.processes, "parts": parts,
        "goals": [row for part in parts.values() for row in part["goals"]],
    }  # fmt: skip


def measure_loop(config: PolicyBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """Figures of policies that act in rooms that none learned from, beside chance and experts."""
    data = config.data
    make_rooms(data, config.processes, advance)
    variants = []
    for variant in trained_variants(data.lake, config.trainings, config.processes):
        variants.append(variant)
        advance(f"{variant.training.name} {variant.training.seed}, trained")
    runs = []
    for run in acted_runs(data, acting_in(variants, config.seeds), config.max_steps, config.processes):
        runs.append(run)
        advance(f"{run.policy.name} {run.policy.seed} in held-out rooms")
    figures = acted_figures(data, runs, config.max_steps)
    trainings = [variant_row(data.lake, variant) for variant in variants]
    rooms = {"train": data.count - len(data.tested), "test": len(data.tested)}
    failed = failures(runs)
    return {
        "rooms": rooms, "episodes": episodes_of(data), "lake": data.lake.address, "seeds": config.seeds,
        "figures": figures, "trainings": trainings, "accuracy": accuracy_of(trainings), "failed": failed,
        "goals": loop_goals(rooms, config.seeds, figures, accuracy_of(trainings), failed),
    }  # fmt: skip


def measure_compared(config: PolicyBench, advance: Callable[[str], None]) -> dict[str, Any]:
    """What datasets are worth, or that the house is not named in which this is measured."""
    if config.comparison is None:
        advance("not compared")
        return {"missing": "METASCENES_REALDATA or --realdata names the folder with the house to be tested in", "goals": []}
    return measure_comparison(config.comparison, advance)


def episodes_of(data: PolicyRooms) -> dict[str, int]:
    """Episodes by split."""
    splits = [row.split for row in data.lake.snapshot().rows(Episode)]
    return {split: splits.count(split) for split in ROOMS}


def accuracy_of(trainings: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """Shares of right actions by variant, means over seeds: `accuracy`, with `low` and `high` of single seeds, and the `majority`'s."""
    figures = {}
    for name in dict.fromkeys(row["name"] for row in trainings):
        own = [row for row in trainings if row["name"] == name and row["accuracy"] is not None]
        if own:
            values = [row["accuracy"] for row in own]
            majority = [row["majority"] for row in own if row["majority"] is not None]
            figures[name] = {
                "accuracy": float(np.mean(values)), "low": min(values), "high": max(values),
                "majority": float(np.mean(majority)) if majority else None,
            }  # fmt: skip
    return figures


def agent_of(names: Mapping[str, Any]) -> str | None:
    """Whom goals are of: the policy that is corrected, else the one that senses as much, else the plain one; None without any."""
    return next((name for name in (DAGGER, SENSING, f"{SMALL}-{DAGGER}", SMALL) if name in names), None)


def loop_goals(
    rooms: Mapping[str, int], seeds: int, figures: Mapping[str, Any], accuracy: Mapping[str, Any], failed: Sequence[str]
) -> list[dict[str, Any]]:
    """What figures of policies are held against."""
    goals = [
        goal("rooms to learn from", rooms["train"], ">=", ROOMS["train"]),
        goal("held-out rooms", rooms["test"], ">=", ROOMS["test"]),
        goal("seeds of each training", seeds, ">=", SEEDS),
        goal("rooms in which somebody could not act", len(failed), "<=", 0),
    ]
    agent = agent_of(figures)
    if agent is None:
        return goals
    own = figures[agent]
    spl = 100 * (own["found"] - own["found_spl"]) if own["found"] else None  # who finds nothing is no measure of ways
    goals += [
        goal(f"targets that {agent} finds when they are in view at the start [%]", _percent(own["found_in_view"]), ">=", FOUND_IN_VIEW),
        goal(f"targets that {agent} finds [%]", _percent(own["found"]), ">=", FOUND),
        goal(f"points that the SPL of {agent} is below that", spl, "<=", SPL_POINTS),
        goal(f"right actions of {agent} in held-out rooms [%]", _percent(accuracy.get(agent, {}).get("accuracy")), ">", ACCURACY),
    ]
    for blind in (name for name in figures if name.startswith(BLIND)):
        if own["found"] is not None and figures[blind]["found"] is not None:
            above, apart = points_between(figures, agent, blind)
            goals += [
                goal(f"points that {agent} finds more than {blind}", above, ">=", BLIND_POINTS),
                goal(f"points between the intervals of {agent} and {blind}", apart, ">", 0.0),
            ]
    if RANDOM in figures and figures[RANDOM]["found"] is not None and own["found"] is not None:
        goals.append(goal(f"points between the intervals of {agent} and {RANDOM}", points_between(figures, agent, RANDOM)[1], ">", 0.0))
    return goals


def _percent(share: float | None) -> float | None:
    return None if share is None else 100 * share
