"""Pictures and thumbnails of scenes and of objects with their candidates, and stills of walks, from the rows and blobs of a snapshot.

Each is made in a worker process, and what cannot be pictured costs its picture, not the report.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from schemas.capture import Instance, RoomSurface, Scene, Shell
from schemas.errors import InputError, LakeError
from schemas.fidelity import SceneFidelity
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Contact, Placement

if TYPE_CHECKING:
    import trimesh

    from tasks.films.drives import DriveStill
    from tasks.films.walks import WalkStrip
    from tasks.stats.scenes import PictureConfig, RoomOutline, ScenePictures
    from tasks.stats.style import Picture
    from tasks.stats.thumbnails import CandidateStrip, CandidateTile
    from warehouse.lake import Lake
    from warehouse.tables.snapshot import Reader

R = TypeVar("R")

Job = tuple[Callable[..., Any], tuple[Any, ...]]
"""A function of this module and its arguments."""


def picture_scene_of(lake: Lake, snapshot_id: int, scene_id: str, look: PictureConfig) -> ScenePictures:
    """Pictures of a scene in a snapshot. Runs in a worker process.

    Raises:
        LakeError: the scene is not there, or one of its meshes cannot be read.
    """
    from flows.stats.pictures import remembered

    reader = lake.snapshot(snapshot_id)
    facts = ["scene", look, *_facts(reader, scene_id, (*_MODEL, *_SHOWN))]
    return remembered(facts, lambda: _pictures(lake, reader, scene_id, look))


_MODEL = ("scenes", "shells", "surfaces", "placements")
"""Tables that say what stands where."""

_SHOWN = ("contacts", "optimization_steps", "navmeshes", "episodes", "instances", "scene_fidelity")
"""Tables of what else is pictured."""


def _facts(reader: Reader, scene_id: str, tables: Sequence[str]) -> list[Any]:
    """All rows that the pictures of a scene are drawn from; meshes are named by the hash of their content."""
    facts: list[Any] = [reader.arrow(table, scene_id) for table in tables]
    placed = {p.asset_id for p in reader.rows(Placement, scene_id)}
    return [*facts, [(asset.asset_id, asset.mesh_blob) for asset in reader.rows_by_key(Asset, sorted(placed))]]


def _pictures(lake: Lake, reader: Reader, scene_id: str, look: PictureConfig) -> ScenePictures:
    from tasks.replica import placed_parts
    from tasks.stats.collisions import colliding_pairs, marked_picture
    from tasks.stats.losses import loss_curve
    from tasks.stats.scenes import best_corner, picture_scene
    from tasks.stats.style import only_vectors

    model = SceneModel.of(lake, reader, scene_id)
    objects, placements = model.objects, model.placements
    camera = best_corner(list(objects.values()) or [[part] for part in model.scan], model.walls, model.outline, look)
    pictures = picture_scene(model.scan, model.walls, list(objects.values()), model.outline, look, camera)
    with only_vectors():
        plan = _plan(lake, reader, scene_id, objects, model.room) if model.room and placements else None
        pictures = dataclasses.replace(pictures, plan=plan, heat=_heat(lake, reader, scene_id, model.room))
    if not placements or placements[0].method == "imported":  # a finished dataset states one pose: there is no before
        return pictures
    contacts = reader.rows(Contact, scene_id)
    with only_vectors():
        curve = loss_curve(reader.arrow("optimization_steps", scene_id), placements[0].method, scene_id)
    proposed = {p.instance_id: placed_parts(p, model.blobs[p.instance_id], "proposed") for p in placements}
    return dataclasses.replace(
        pictures,
        before=marked_picture(proposed, model.shell, colliding_pairs(contacts, "proposed"), model.outline, camera, look),
        after=marked_picture(objects, model.shell, colliding_pairs(contacts, "optimized"), model.outline, camera, look),
        loss_curve=curve,
    )


def thumbnails_of(lake: Lake, snapshot_id: int, scene_id: str) -> tuple[bytes, bytes]:
    """Small JPEGs of a scan and of its replica. Runs in a worker process.

    Raises:
        LakeError: the scene is not there, or one of its meshes cannot be read.
    """
    from flows.stats.pictures import remembered
    from tasks.stats.scenes import corner_pair
    from tasks.stats.thumbnails import SCENE_LOOK

    reader = lake.snapshot(snapshot_id)

    def draw() -> tuple[bytes, bytes]:
        model = SceneModel.of(lake, reader, scene_id)
        return corner_pair(model.scan, model.walls, list(model.objects.values()), model.outline, SCENE_LOOK)

    return remembered(["thumbnails", SCENE_LOOK, *_facts(reader, scene_id, _MODEL)], draw)


def strip_of(lake: Lake, rows: Sequence[Mapping[str, Any]]) -> CandidateStrip:
    """An object of the gallery with its candidates. Runs in a worker process.

    `rows` are those of the query `instances.gallery` of one object. A candidate that cannot be pictured says so.
    """
    from tasks.stats.thumbnails import CandidateStrip

    first, chosen = rows[0], _chosen(rows)
    # all as they would stand beside the chosen one, whose front is seen
    ahead = next((_heading(row).T for row in rows if row["slot"] == chosen), np.eye(3))
    return CandidateStrip(
        scene_id=first["scene_id"],
        instance_id=first["instance_id"],
        category=first["category"],
        crop=_crop(lake, first),
        origin=first["origin"] or "",
        tiles=tuple(_tile(lake, row, chosen, ahead @ _heading(row)) for row in rows),
    )


def walk_strip_of(lake: Lake, snapshot_id: int, row: Mapping[str, Any]) -> WalkStrip:
    """Stills of a trajectory, a row of the query `trajectory_metrics.shown`. Runs in a worker process.

    Raises:
        LakeError: the scene lacks what an agent needs, or cannot be drawn.
    """
    from flows.stats.pictures import remembered
    from tasks.films.walks import STRIP_LOOK

    reader = lake.snapshot(snapshot_id)
    done = reader.matching("trajectories", {name: [row[name]] for name in ("batch_id", "scene_id", "episode_id")})
    facts = ["walk", STRIP_LOOK, row, done, *_facts(reader, row["scene_id"], (*_MODEL, "instances", "navmeshes"))]
    return remembered(facts, lambda: _walk_strip(lake, reader, row))


def _walk_strip(lake: Lake, reader: Reader, row: Mapping[str, Any]) -> WalkStrip:
    from flows.outputs.films import scenes_of
    from tasks.films.first_person import first_person
    from tasks.films.frames import stills
    from tasks.films.third_person import ThirdPerson
    from tasks.films.walks import STRIP_LOOK, WalkStrip
    from tasks.stats.photographs import developed

    walk, room, world = scenes_of(lake, reader, row, STRIP_LOOK)
    views = first_person(world, walk.poses, walk.camera)
    shown = stills(ThirdPerson(room, walk, STRIP_LOOK.room), views, walk, STRIP_LOOK)
    picture = developed(shown.astype(np.float32), STRIP_LOOK.room)
    done = walk.trajectory
    names = (done.policy, done.run_name, walk.outcome, done.scene_id, done.episode_id, done.category)
    return WalkStrip(*names, walk.ending, picture)


def drive_still_of(lake: Lake, snapshot_id: int, row: Mapping[str, Any]) -> DriveStill:
    """The end of a robot run, a row of the query `robot_runs.shown`. Runs in a worker process.

    Raises:
        LakeError: the scene cannot be drawn.
    """
    from flows.stats.pictures import remembered
    from tasks.films.walks import STRIP_LOOK

    reader = lake.snapshot(snapshot_id)
    done = reader.matching("robot_runs", {name: [row[name]] for name in ("batch_id", "scene_id", "episode_id")})
    facts = ["drive", STRIP_LOOK, row, done, *_facts(reader, row["scene_id"], _MODEL)]
    return remembered(facts, lambda: _drive_still(lake, reader, row))


def _drive_still(lake: Lake, reader: Reader, row: Mapping[str, Any]) -> DriveStill:
    from flows.outputs.drives import filmed_drive
    from tasks.films.drives import DriveStill, drive_frame
    from tasks.films.third_person import ThirdPerson
    from tasks.films.walks import FilmLook
    from tasks.stats.photographs import developed

    look = FilmLook()
    filmed, room, plan = filmed_drive(lake, reader, row, (look.room.height, look.room.height))
    last = filmed.steps[-1]
    third = ThirdPerson(room, filmed, look.room).picture(len(filmed.steps) - 1)
    picture = developed(drive_frame(third, plan.picture(last), filmed, last, look).astype(np.float32), look.room)
    run = filmed.run
    names = (run.policy, run.run_name, run.setup, run.outcome, run.scene_id, run.episode_id, run.category)
    return DriveStill(*names, filmed.ending, picture)


def carried_out(
    jobs: Mapping[Any, Job], workers: int | None, advance: Callable[[str], None], meanwhile: Callable[[], None] | None = None,
    anew: Mapping[Any, Job] | None = None,
) -> dict[Any, Any]:  # fmt: skip
    """The result of each job by its key; of one that failed the reason, a text. One worker means this process.

    What is remembered is looked up here: no worker is started for it. `meanwhile` is called once, while workers are at theirs. `anew` are
    jobs of which nothing is remembered.
    """
    made = {key: known for key, job in jobs.items() if (known := _remembered(job)) is not None}
    for key in made:
        advance(str(key))
    left = {**(anew or {}), **{key: job for key, job in jobs.items() if key not in made}}
    made |= _drawn(left, min(workers or min(os.cpu_count() or 1, 4), len(left)), advance, meanwhile)
    return {key: made[key] for key in (*jobs, *(anew or ()))}


def _remembered(job: Job) -> Any:
    """The result of a job of which all is remembered, else None."""
    from flows.stats.pictures import NotDrawnYet, only_remembered

    function, arguments = job
    try:
        with only_remembered():
            return function(*arguments)
    except (*_UNREADABLE, NotDrawnYet):  # a worker tries again, and says why
        return None


def _drawn(jobs: Mapping[Any, Job], count: int, advance: Callable[[str], None], meanwhile: Callable[[], None] | None) -> dict[Any, Any]:
    """The result of each job, or the reason why there is none, by `count` workers."""
    if count <= 1:
        if meanwhile is not None:
            meanwhile()
        return {key: _result_or_reason(_call_here, key, job, advance) for key, job in jobs.items()}
    from flows.run.pool import WorkerPool

    with WorkerPool(count) as pool, ThreadPoolExecutor(count) as threads:
        made = threads.map(lambda entry: _result_or_reason(pool.call, entry[0], entry[1], advance), jobs.items())
        if meanwhile is not None:
            meanwhile()
        return dict(zip(jobs, made, strict=True))


@dataclasses.dataclass(frozen=True)
class SceneModel:
    """A scene as meshes in the world frame [m]: its scan, its room and what was placed in it, by name."""

    scan: list[trimesh.Trimesh]
    room: Shell | None
    placements: list[Placement]
    blobs: Mapping[str, bytes]
    objects: Mapping[str, list[trimesh.Trimesh]]
    shell: Mapping[str, list[trimesh.Trimesh]]
    outline: RoomOutline

    @property
    def walls(self) -> list[trimesh.Trimesh]:
        """All parts of the room's shell."""
        return [part for parts in self.shell.values() for part in parts]

    @staticmethod
    def of(lake: Lake, reader: Reader, scene_id: str) -> SceneModel:
        """The meshes of a scene of a snapshot.

        Raises:
            InputError: the snapshot has no such scene.
        """
        from tasks.geometry.meshes import load_glb
        from tasks.replica import placed_parts
        from tasks.shell import room_shell
        from tasks.stats.scenes import RoomOutline
        from tasks.surfaces import textured

        scenes = reader.rows(Scene, scene_id)
        if not scenes:
            raise InputError("scenes", scene_id, "is not in the snapshot", "run its capture stage")
        scan = load_glb(lake.blobs[scenes[0].mesh_blob], f"{scene_id} scan")
        shells = reader.rows(Shell, scene_id)
        placements = reader.rows(Placement, scene_id)
        assets = {asset.asset_id: asset for asset in reader.rows_by_key(Asset, sorted({p.asset_id for p in placements}))}
        blobs = {p.instance_id: lake.blobs[assets[p.asset_id].mesh_blob] for p in placements}
        objects = {p.instance_id: placed_parts(p, blobs[p.instance_id]) for p in placements}
        bare = room_shell(shells[0]) if shells else []
        shell = {name: [part] for name, part in textured(bare, reader.rows(RoomSurface, scene_id), lake.blobs)}
        outline = RoomOutline.of_room(shells[0]) if shells else RoomOutline.of_parts(scan)
        return SceneModel(scan, shells[0] if shells else None, placements, blobs, objects, shell, outline)


def _plan(lake: Lake, reader: Reader, scene_id: str, objects: Mapping[str, Sequence[trimesh.Trimesh]], room: Shell) -> Picture | None:
    """The floor plan of a scene for the agent with the most episodes; None without a navmesh."""
    from tasks.stats.plans import floor_plan

    episodes = reader.rows(Episode, scene_id)
    count = Counter(episode.agent for episode in episodes)
    navmesh = min(reader.rows(Navmesh, scene_id), key=lambda row: (-count[row.agent], row.agent), default=None)
    if navmesh is None:
        return None
    names = {row.instance_id: f"{row.category} {row.instance_id}" for row in reader.rows(Instance, scene_id)}
    own = [episode for episode in episodes if episode.agent == navmesh.agent]
    return floor_plan(lake.blobs[navmesh.navmesh_blob], own, objects, names, room, scene_id)


def _heat(lake: Lake, reader: Reader, scene_id: str, room: Shell | None) -> Picture | None:
    """The heat map of a scene; None where its fidelity was not measured."""
    from tasks.fidelity.marked_points import read_marked
    from tasks.stats.heat_maps import heat_map

    rows = reader.rows(SceneFidelity, scene_id)
    if not rows:
        return None
    return heat_map(read_marked(lake.blobs[rows[0].distances_blob], f"{scene_id} distances.ply"), room, scene_id)


def _crop(lake: Lake, row: Mapping[str, Any]) -> bytes | None:
    """How the scan shows an object: its best view, else its faces of the scan; None where there is neither."""
    from flows.stats.pictures import remembered
    from tasks.geometry.meshes import load_glb
    from tasks.stats.thumbnails import OBJECT_PX, fitted, object_thumbnail

    for name, drawn in (
        (row["view_blob"], lambda data: fitted(data, (OBJECT_PX, OBJECT_PX))),
        (row["mesh_blob"], lambda data: object_thumbnail(load_glb(data))),
    ):
        if name is not None:
            try:
                made: bytes = remembered(["crop", name], partial(_of_blob, lake, name, drawn))
                return made
            except _UNREADABLE:
                continue
    return None


def _of_blob(lake: Lake, name: str, drawn: Callable[[bytes], bytes]) -> bytes:
    return drawn(lake.blobs[name])


def _chosen(rows: Iterable[Mapping[str, Any]]) -> int | None:
    """The slot of what was placed, the better ranked one when two slots hold it; where nothing was, of what ranks first."""
    ranked = sorted(rows, key=lambda row: (row["rank"] or math.inf, row["slot"]))
    placed = [row["slot"] for row in ranked if row["asset_id"] is not None and row["asset_id"] == row["placed_asset_id"]]
    first = [row["slot"] for row in ranked if row["rank"] == 1 and row["placed_asset_id"] is None]
    return next(iter(placed + first), None)


def _heading(row: Mapping[str, Any]) -> NDArray[np.float64]:
    """How a candidate is turned onto its instance, (3, 3); not at all when it was not aligned."""
    return np.eye(3) if row["pose"] is None else np.array(row["pose"], dtype=np.float64).reshape(4, 4)[:3, :3]


def _tile(lake: Lake, row: Mapping[str, Any], chosen: int | None, turn: NDArray[np.float64]) -> CandidateTile:
    from flows.stats.pictures import remembered
    from tasks.geometry.meshes import load_glb
    from tasks.stats.thumbnails import CandidateTile, object_thumbnail

    note, picture = row["reason"] or "", None
    if row["asset_blob"] is not None:
        blob, scale = row["asset_blob"], row["scale"] or (1.0, 1.0, 1.0)
        try:  # by content: the same asset, as large and turned alike, looks the same in every scene and beside any others
            picture = remembered(
                ["tile", blob, scale, turn.tolist()],
                lambda: object_thumbnail(load_glb(lake.blobs[blob], row["asset_name"]), scale, turn),
            )
        except _UNREADABLE as error:
            note = _reason(error)
    return CandidateTile(
        slot=row["slot"],
        provider=row["provider"],
        score=row["score"],
        is_chosen=row["slot"] == chosen,
        is_fallback=row["is_fallback"],
        is_filled=row["outcome"] == "filled",
        note=note,
        picture=picture,
    )


_UNREADABLE = (LakeError, OSError, KeyError, ValueError)


def _reason(error: Exception) -> str:
    return str(error) if isinstance(error, LakeError) else f"{type(error).__name__}: {error}"


def _call_here(function: Callable[..., R], *arguments: Any) -> R:
    return function(*arguments)


def _result_or_reason(call: Callable[..., Any], key: Any, job: Job, advance: Callable[[str], None]) -> Any:
    from flows.run.pool import WorkerLost

    function, arguments = job
    try:
        return call(function, *arguments)
    except (*_UNREADABLE, WorkerLost) as error:
        return _reason(error)
    finally:
        advance(str(key))
