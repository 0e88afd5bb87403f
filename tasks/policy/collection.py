"""What a dataset has to learn navigation from: walks along its episodes, by split, and scenes to look at and to act in."""

from __future__ import annotations

import dataclasses
import hashlib
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from schemas.candidates import Asset
from schemas.capture import Instance, RoomSurface, Scene, Shell
from schemas.errors import InputError
from schemas.lineage.licenses import of_asset, stated
from schemas.navigation import Episode, Navmesh, Split
from schemas.optimization import Placement
from tasks.evaluation.measures import path_finder
from tasks.navigation import room_name, split_of
from tasks.policy.corrections import TrainingScene
from tasks.policy.demonstrations import AgentWalk, WalkConfig, chosen, walk_of
from tasks.stage import Context

READS = ("assets", "episodes", "instances", "navmeshes", "placements", "scenes", "shells", "splits", "surfaces")


R = TypeVar("R")


class EpisodeDataset(Protocol):
    """A dataset; see `tasks.training.dataset.Dataset`."""

    def rows(self, record: type[R]) -> Iterator[R]:
        """Rows of a record type, in the order of its key."""
        ...


@dataclasses.dataclass(frozen=True)
class VisibleScene:
    """Rows of a scene that say how it looks. shell: None where there is none."""

    shell: Shell | None
    surfaces: tuple[RoomSurface, ...]
    placements: tuple[Placement, ...]
    instances: tuple[Instance, ...]


@dataclasses.dataclass(frozen=True)
class CollectedWalks:
    """Walks by split, those of a scene together. looks: Rows of all scenes in use. assets: That these hold, by id. courses: Training
    scenes to act in. license: Of scans and assets, each once. left_out: Episodes that were no walks, by reason."""

    train: list[AgentWalk]
    test: list[AgentWalk]
    looks: Mapping[str, VisibleScene]
    assets: Mapping[str, Asset]
    courses: Mapping[str, TrainingScene]
    license: str
    left_out: Mapping[str, int]


def collected(dataset: EpisodeDataset, context: Context, config: WalkConfig, test_share: float) -> CollectedWalks:
    """The episodes of a dataset as walks, by the split of their room.

    `test_share`: of the rooms, where the dataset has no row of a room in `splits`.

    Raises:
        InputError: there is none in a training room, or a navmesh cannot be used.
    """
    scenes = {scene.scene_id: scene for scene in dataset.rows(Scene)}
    splits = {row.room_id: row.split for row in dataset.rows(Split)}
    meshes = {(mesh.scene_id, mesh.agent): mesh for mesh in dataset.rows(Navmesh)}
    shells = {shell.scene_id: shell for shell in dataset.rows(Shell)}
    walks: dict[str, list[AgentWalk]] = {"train": [], "test": []}
    courses: dict[str, TrainingScene] = {}
    left_out: Counter[str] = Counter()
    for scene_id, episodes in _by_scene(dataset.rows(Episode)):
        if scene_id not in scenes:
            left_out["their scene is not in the lake"] += len(episodes)
            continue
        room = scenes[scene_id].room_id
        split = splits.get(room) or split_of(room, test_share)
        some = chosen(episodes, config.train_episodes if split == "train" else config.test_episodes)
        for agent in sorted({episode.agent for episode in some}):
            own = [episode for episode in some if episode.agent == agent]
            mesh = meshes.get((scene_id, agent))
            if mesh is None or mesh.navmesh_blob not in context.blobs:
                left_out["their navmesh is not in the lake"] += len(own)
                continue
            finder = path_finder(context.blobs[mesh.navmesh_blob], f"{scene_id} {mesh.navmesh_blob[:12]}.navmesh")
            made = [walk_of(episode, room, finder, config) for episode in own]
            left_out["their actions lead elsewhere on the navmesh"] += made.count(None)
            walks[split] += [walk for walk in made if walk is not None]
            if split == "train" and scene_id not in courses:
                courses[scene_id] = TrainingScene(scene_id, room, tuple(own), finder)
    if not walks["train"]:
        problem = "has none in a training room" if not +left_out else f"has none that can be used: {_said(+left_out)}"
        raise InputError("train navigation", "episodes", problem, "run the stage navigation on rooms of the split 'train'")
    used = {walk.scene_id for part in walks.values() for walk in part}
    looks, assets = _looks(dataset, used, shells)
    scans = {name: scene.license for name, scene in scenes.items()}
    licenses = {stated(scans[name]) for name in used} | {of_asset(a.license, a.source, scans) for a in assets.values()}
    return CollectedWalks(
        walks["train"], walks["test"], looks, assets, {name: course for name, course in courses.items() if name in used},
        ", ".join(sorted(licenses)), +left_out,
    )  # fmt: skip


def held_out(walks: Sequence[AgentWalk], share: float) -> tuple[list[AgentWalk], list[AgentWalk]]:
    """Walks to learn from, and those of a share of the rooms, drawn by the rooms' names, to choose the best weights by.

    At least one room is held out where there are two. Rooms of one name are one: a scan's replica and the room itself are on one side.
    """
    rooms = sorted({room_name(walk.room_id) for walk in walks}, key=lambda room: hashlib.sha256(f"validation {room}".encode()).digest())
    count = min(max(round(share * len(rooms)), 1), len(rooms) - 1) if share > 0 else 0
    held = {*rooms[:count]}
    sides: tuple[list[AgentWalk], list[AgentWalk]] = ([], [])
    for walk in walks:
        sides[room_name(walk.room_id) in held].append(walk)
    return sides


def spread(walks: Sequence[AgentWalk], count: int) -> list[AgentWalk]:
    """So many of some walks, evenly spread; all where there are no more."""
    if len(walks) <= count:
        return list(walks)
    return [walks[place * len(walks) // count] for place in range(count)]


def _by_scene(rows: Iterator[Any]) -> Iterator[tuple[str, list[Any]]]:
    """Rows of one scene after another."""
    scene, part = "", list[Any]()
    for row in rows:
        if part and row.scene_id != scene:
            yield scene, part
            part = []
        scene = row.scene_id
        part.append(row)
    if part:
        yield scene, part


def _looks(dataset: EpisodeDataset, used: set[str], shells: Mapping[str, Shell]) -> tuple[dict[str, VisibleScene], dict[str, Asset]]:
    """Rows of scenes that say how they look, and the assets in them by id."""
    parts: dict[type, defaultdict[str, list[Any]]] = {}
    records: tuple[type[Any], ...] = (RoomSurface, Placement, Instance)
    for record in records:
        parts[record] = defaultdict(list)
        for row in dataset.rows(record):
            if row.scene_id in used:
                parts[record][row.scene_id].append(row)
    looks = {name: VisibleScene(shells.get(name), *(tuple(rows[name]) for rows in parts.values())) for name in sorted(used)}
    named = {placement.asset_id for rows in looks.values() for placement in rows.placements}
    return looks, {asset.asset_id: asset for asset in dataset.rows(Asset) if asset.asset_id in named}


def _said(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{count} left out: {reason}" for reason, count in sorted(counts.items()))
