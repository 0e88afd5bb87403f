"""Episodes of a snapshot and the scenes that they are in, read when they are needed."""

from __future__ import annotations

import dataclasses
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

from schemas.candidates import Asset
from schemas.capture import Instance, RoomSurface, Shell
from schemas.errors import InputError
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Placement
from schemas.record import arrow_to_rows
from schemas.wording import meant
from tasks.settings import fields_of, nearest
from tasks.simulation.configuration import SimulationConfig
from tasks.simulation.world import World, world_of
from warehouse.lake import Lake
from warehouse.release import snapshot_of
from warehouse.tables.snapshot import Reader

KEPT = 256
"""Scenes that are kept ready: some megabytes each, so a gigabyte or so at most."""

SPLITS = ("train", "test")


class Worlds:
    """Scenes of a snapshot, ready to act in: read when they are asked for, the last few kept."""

    def __init__(self, lake: Lake, reader: Reader, agent: str, reach_m: float) -> None:
        self._lake, self._reader, self._agent, self._reach = lake, reader, agent, reach_m
        self._kept: OrderedDict[str, World] = OrderedDict()

    def world(self, scene_id: str) -> World:
        """A scene.

        Raises:
            InputError: there is no such scene, or it lacks what an agent needs.
        """
        if scene_id not in self._kept:
            self._kept[scene_id] = self._read(scene_id)
            if len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(scene_id)
        return self._kept[scene_id]

    def _read(self, scene_id: str) -> World:
        read = self._reader
        shells = read.rows(Shell, scene_id)
        navmeshes = [row for row in read.rows(Navmesh, scene_id) if row.agent == self._agent]
        if not navmeshes:
            raise InputError(self._lake.address, scene_id, "there is no navmesh of it", "`metascenes run` makes it")
        placements = read.rows(Placement, scene_id)
        assets = read.rows_by_key(Asset, sorted({row.asset_id for row in placements}))
        episodes = read.matching("episodes", {"scene_id": [scene_id], "agent": [self._agent]})
        return world_of(
            scene_id, shells[0] if shells else None, read.rows(RoomSurface, scene_id), placements, assets, read.rows(Instance, scene_id),
            navmeshes[0], arrow_to_rows(episodes, Episode), self._lake.blobs, self._reach,
        )  # fmt: skip


_SHARED: WeakValueDictionary[tuple[str, int, str, float], Worlds] = WeakValueDictionary()
"""Scenes by lake, snapshot, agent and reach: environments of a process share them, as long as one is there."""


@dataclasses.dataclass(frozen=True)
class Selected:
    """Which episodes of a lake are meant.

    scenes: Of these scenes; all when empty. split: Of rooms to train on or to test on; None for both. agent: Of this agent, by the name
    in `navmeshes`; None where there is one only. snapshot, release: Of this snapshot, or of the one that a release names; the last
    otherwise. categories: What targets may be, in the order of their numbers; None for all categories of the agent's episodes in the
    snapshot, sorted, whichever scenes and split are meant.
    """

    scenes: tuple[str, ...] = ()
    split: str | None = "train"
    agent: str | None = None
    snapshot: int | None = None
    release: str | None = None
    categories: tuple[str, ...] | None = None


class EpisodeScenes:
    """Episodes by number, the targets' categories, and scenes as they are needed. One reader for all environments of a process.

    names: Scene and episode of every episode, sorted. categories: What targets can be, by number. world: A scene by name, ready to act
    in.
    """

    def __init__(self, lake: str | Path, selected: Selected, config: SimulationConfig) -> None:
        """
        Args:
            lake: Address of the lake.
            selected: Which of its episodes.
            config: Camera and robot.

        Raises:
            InputError: there is no lake, no such scene, or no episode of what is asked for.
        """
        self.config = config
        self._lake = Lake.existing(lake)
        self._reader = self._lake.snapshot(snapshot_of(self._lake, selected.release, selected.snapshot))
        self.address, self.snapshot_id = self._lake.address, self._reader.snapshot_id
        rows = self._reader.matching("episodes", {}, ["agent", "split", "category"]).to_pylist()
        self.agent = self._agent(selected, {row["agent"] for row in rows})
        rows = [row for row in rows if row["agent"] == self.agent]
        categories = sorted({row["category"] for row in rows})
        chosen = self._chosen(rows, selected)
        self.names: tuple[tuple[str, str], ...] = tuple((row["scene_id"], row["episode_id"]) for row in chosen)
        self.categories = tuple(dict.fromkeys(selected.categories)) if selected.categories else tuple(categories)
        self._number = {category: number for number, category in enumerate(self.categories)}
        unknown = sorted({row["category"] for row in chosen} - self._number.keys())
        if unknown:
            problem, remedy = f"{unknown[0]!r} is a target and not among them", f"name all of {', '.join(categories)}, or leave it out"
            raise InputError(self.address, "categories", problem, remedy)
        key = (self.address, self.snapshot_id, self.agent, config.reach_m)
        self._worlds = _SHARED.get(key) or Worlds(self._lake, self._reader, self.agent, config.reach_m)
        _SHARED[key] = self._worlds
        self.world = self._worlds.world

    def _agent(self, selected: Selected, agents: set[str]) -> str:
        """The agent whose episodes are meant."""
        if not agents:
            raise InputError(self.address, "episodes", "the lake has none", "`metascenes run` makes them")
        if selected.agent is None and len(agents) == 1:
            return next(iter(agents))
        if selected.agent not in agents:
            problem = f"there is no {selected.agent!r}" if selected.agent else "there are several"
            raise InputError(self.address, "agent", problem, f"name one of {', '.join(sorted(agents))}")
        return selected.agent

    def _chosen(self, rows: list[dict[str, Any]], selected: Selected) -> list[dict[str, Any]]:
        """Rows of the scenes and the split that are meant."""
        if selected.split is not None and selected.split not in SPLITS:
            raise InputError(self.address, "split", f"there is no {selected.split!r}", f"it is {' or '.join(SPLITS)}, or None for both")
        known = {row["scene_id"] for row in rows}
        for scene in selected.scenes:
            if scene not in known:
                is_there = self._reader.matching("scenes", {"scene_id": [scene]}, ["scene_id"]).num_rows
                problem = f"{scene} has no episodes" if is_there else f"there is no {scene}"
                raise InputError(self.address, "scenes", problem, f"{meant(scene, sorted(known))}there are {', '.join(sorted(known)[:20])}")
        wanted = [row for row in rows if not selected.scenes or row["scene_id"] in selected.scenes]
        chosen = [row for row in wanted if selected.split in (None, row["split"])]
        if not chosen:
            other = ", ".join(sorted({row["split"] for row in wanted}))
            raise InputError(self.address, "split", f"no episode of these scenes is of {selected.split}", f"they are of {other}")
        return chosen

    def episode(self, scene_id: str, episode_id: str) -> Episode:
        """An episode by name.

        Raises:
            InputError: there is no such scene or episode.
        """
        episodes = self.world(scene_id).episodes
        if episode_id not in episodes:
            raise InputError(self.address, f"{scene_id} episode {episode_id}", "there is no such episode", f"it has {len(episodes)}")
        return episodes[episode_id]

    def number(self, category: str) -> int:
        """The number of a target's category."""
        return self._number[category]


def configured(environment: str, settings: Mapping[str, Any]) -> SimulationConfig:
    """Settings by name as a config.

    Raises:
        InputError: there is no such setting, or it cannot have that value.
    """
    for name in settings:
        if name not in fields_of(SimulationConfig):
            raise InputError(environment, name, "there is no such setting", nearest(name, fields_of(SimulationConfig), "there are"))
    try:
        return SimulationConfig(**settings)
    except ValueError as error:
        raise InputError(environment, *str(error).split(": ", 1)) from error


def named(scenes: str | Sequence[str]) -> tuple[str, ...]:
    """Scenes as a tuple; a single one may stand alone."""
    return (scenes,) if isinstance(scenes, str) else tuple(scenes)
