"""Rooms that policies learn in and are tried in: generated, with navmeshes and episodes, as lakes like anybody's, kept in a folder."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.replicas import as_drawn
from bench.rooms import generated_scene
from bench.samples import fingerprint, sample, stage_run
from bench.selection.trainings import mapped
from flows.run.fingerprints import code_fingerprint, digest
from schemas.candidates import Candidate
from schemas.errors import InputError
from tasks import navigation
from tasks.navigation import NavigationConfig
from tasks.stage import Context
from warehouse.lake import Lake

STAGES = {
    "capture": ("scenes", "shells", "instances"), "candidates": ("candidates", "assets"), "optimization": ("placements",),
    "navigation": ("navmeshes", "episodes", "splits"),
}  # fmt: skip
"""What of a room is kept, by the stage that would have written it."""

TEST_SHARE = 0.2
"""Of the rooms, which are held out: 4:1, as printed in the supplementary."""

ANEW = 1_000_003
"""Added to the seed of a room whose objects leave the agent no floor, until they leave it some: a tenth do not."""

TRIES = 20

NOTE = "rooms of the benchmark of policies"
"""Of commits."""

ROOMS_PER_COMMIT = 8
"""A commit takes one to two seconds, whatever it holds."""


@dataclasses.dataclass(frozen=True)
class PolicyRooms:
    """A data set in a folder: a lake of rooms to learn from and of rooms that are held out, to act in. count: Of all of them.
    episodes: At most, of a room to learn from; one that is held out has half as many, as printed in the supplementary."""

    folder: Path
    count: int
    seed: int
    episodes: int = 100

    @property
    def mark(self) -> str:
        """What rooms and episodes follow from, code and all."""
        here = Path(__file__)
        makers = [here, *(here.parents[1] / f"{name}.py" for name in ("rooms", "replicas", "perturbation", "samples"))]
        own = [path.read_text() for path in makers]
        modules = sorted({line.split()[1] for text in own for line in text.splitlines() if line.startswith("from tasks.")})
        code = [code_fingerprint(module) for module in (*modules, "tasks.captions", "tasks.navigation")]
        return digest(*own, *code, str(self.count), str(self.seed), str(self.episodes))

    @property
    def tested(self) -> frozenset[int]:
        """Numbers of the rooms that are held out: a fifth, drawn by the seed; at least one."""
        order = np.random.default_rng([self.seed, self.count]).permutation(self.count)
        return frozenset(order[: max(1, round(TEST_SHARE * self.count))].tolist())

    @property
    def held_out(self) -> list[str]:
        """Scenes of the rooms that are held out."""
        return [room_name(number) for number in sorted(self.tested)]

    @property
    def lake(self) -> Lake:
        """The lake of all rooms, where models are trained and policies act."""
        return Lake.open(self.folder / f"rooms-{self.mark[:16]}" / "lake")


def room_name(number: int) -> str:
    """Scene of a room."""
    return f"bench/room_{number:04d}"


def make_rooms(rooms: PolicyRooms, processes: int, advance: Callable[[str], None]) -> None:
    """Make the rooms that the folder lacks, by so many processes; each stays where it is once it is made.

    Raises:
        InputError: a room leaves the agent no floor, however it is furnished.
    """
    lake = rooms.lake
    known = {scene for (scene, stage), state in lake.history().items() if stage == "navigation" and state.done}
    lacking = [number for number in range(rooms.count) if room_name(number) not in known]
    for number in sorted({*range(rooms.count)} - {*lacking}):
        advance(room_name(number))
    with mapped(processes) as spread:
        for done, number in enumerate(spread(partial(make_room, rooms), lacking), start=1):
            advance(room_name(number))
            if done % ROOMS_PER_COMMIT == 0:
                lake.commit(NOTE)
    lake.commit(NOTE)


def make_room(rooms: PolicyRooms, number: int) -> int:
    """Furnish a room, find its episodes, and leave all of it staged; its number.

    Raises:
        InputError: it leaves the agent no floor, however it is furnished.
    """
    is_test = number in rooms.tested
    episodes = rooms.episodes // 2 if is_test else rooms.episodes
    # the split is stated: by the hash of its name, few rooms would be on sides by chance
    config = NavigationConfig(train_episodes=episodes, test_episodes=episodes, test_share=float(is_test))
    for attempt in range(TRIES):
        drawn = as_drawn(generated_scene(number, rooms.count, rooms.seed + ANEW * attempt, shares=()))
        rows, blobs = with_episodes(*drawn, rooms.seed, config)
        if rows["episodes"]:
            stage_room(rooms.lake, rows, blobs, rooms.mark)
            return number
    problem = f"room {number} of {rooms.count} leaves the agent no floor in {TRIES} draws"
    raise InputError("bench policy", "--rooms", problem, "give another --seed")


def with_episodes(
    rows: Mapping[str, list[Any]], blobs: Mapping[str, bytes], seed: int, config: NavigationConfig
) -> tuple[dict[str, list[Any]], dict[str, bytes]]:
    """Rows of a room up to the navigation stage and those of that stage, and the blobs that they name."""
    scene_id = rows["scenes"][0].scene_id
    context = Context(scene_id, "navigation", seed, blobs, defaultdict(dict))
    outcome = navigation.run(**{table: rows[table] for table in navigation.STAGE.reads}, context=context, config=config)
    return {**rows, **outcome.rows}, {**blobs, **outcome.blobs}


def stage_room(lake: Lake, rows: Mapping[str, list[Any]], blobs: Mapping[str, bytes], mark: str) -> None:
    """Leave a room with its episodes staged in a lake. mark: What the rows follow from."""
    scene_id = rows["scenes"][0].scene_id
    candidates = [
        sample(Candidate, scene_id=scene_id, instance_id=row.instance_id, slot=1, outcome="filled", asset_id=row.asset_id)
        for row in rows["placements"]
    ]
    for name, data in blobs.items():
        lake.blobs.put(data, name.split(".", 1)[1])
    above: list[str] = []
    for stage, tables in STAGES.items():
        print_ = fingerprint(scene_id, stage, mark)
        lake.stage_rows(stage_run(scene_id, stage, print_, *above), {table: {**rows, "candidates": candidates}[table] for table in tables})
        above = [f"{stage}={print_}"]
