"""The statistics: gathers what the views say and what scenes look like, draws it, writes the report."""

from __future__ import annotations

import dataclasses
import os
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow as pa

from schemas.candidates import Asset
from schemas.capture import Instance, Room, Scene
from schemas.errors import InputError, LakeError
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Contact, Placement
from schemas.tables import TABLES
from warehouse.views import views

if TYPE_CHECKING:
    import trimesh

    from tasks.stats.scenes import PictureConfig, ScenePictures
    from tasks.stats.style import Picture
    from warehouse.lake import Lake
    from warehouse.snapshot import Reader

STAGES: tuple[str, ...] = tuple(dict.fromkeys(table.stage for table in TABLES.values() if table.stage))
"""Stages in the order of the data path."""

PICTURED_SCENES = 10
"""Scenes with pictures: about 0.35 MB each, so that the report can still be mailed."""


def write_report(
    lake: Lake,
    out: Path,
    snapshot_id: int | None = None,
    *,
    pictures: Path | None = None,
    look: PictureConfig | None = None,
    workers: int | None = None,
    advance: Callable[[str], None] | None = None,
) -> Path:
    """Write the report on a snapshot, the newest by default, and return its path.

    `out` is the HTML file; in a folder, it is `report.html`. `pictures` is a folder that gets every chart as SVG and PNG.
    `look` says how scenes are pictured, `workers` how many processes do it (one per core by default);
    `advance` is told each scene that was pictured. The same snapshot gives the same bytes.

    Raises:
        InputError: there is no such snapshot.
    """
    from tasks.stats.report import Query, ReportContent, render_report
    from tasks.stats.scenes import PictureConfig

    look = look or PictureConfig()
    reader = lake.snapshot(snapshot_id)
    answers = answers_of(reader)
    charts = draw_charts(answers)
    scenes = [row.scene_id for row in reader.rows(Scene)][:PICTURED_SCENES]
    content = ReportContent(
        answers=answers,
        queries=[Query(view.name, view.question, view.note, view.query) for view in views()],
        pictures=charts,
        scenes=_picture_scenes(lake, reader.snapshot_id, scenes, look, workers, advance),
        picture_size=(look.width, look.height),
        stages=STAGES,
        snapshot_id=reader.snapshot_id,
        snapshot_time=f"{reader.snapshot.created_at:%Y-%m-%d %H:%M} UTC" if reader.snapshot else "",
        code_version=_code_version(),
    )
    path = out / "report.html" if out.is_dir() or not out.suffix else out
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(render_report(content), encoding="utf-8")
    if pictures is not None:
        pictures.mkdir(parents=True, exist_ok=True)
        for chart in charts:
            (pictures / f"{chart.name}.svg").write_text(chart.svg, encoding="utf-8")
            (pictures / f"{chart.name}.png").write_bytes(chart.png)
    return path


def stage_table(reader: Reader) -> str:
    """Times per stage as plain text for a terminal."""
    from tasks.stats import grids

    with reader.connect() as connection:
        return grids.stage_table(connection.sql("SELECT * FROM stage_timing").to_arrow_table(), STAGES)


def answers_of(reader: Reader) -> dict[str, pa.Table]:
    """Rows of every view, by name."""
    with reader.connect() as connection:
        return {view.name: connection.sql(f'SELECT * FROM "{view.name}"').to_arrow_table() for view in views()}


def draw_charts(answers: Mapping[str, pa.Table]) -> list[Picture]:
    """All charts that have something to show, in the order of the report."""
    from tasks.stats import charts, words

    counts = answers["category_counts"]
    drawn = [
        charts.per_scene(answers["objects_per_scene"], "objects", "objects"),
        charts.per_scene(answers["categories_per_scene"], "categories", "categories"),
        words.word_cloud(dict(zip(counts["category"].to_pylist(), counts["objects"].to_pylist(), strict=True))),
        charts.volume_boxes(answers["volume_by_category"], answers["volume_outliers"]),
        charts.candidate_bars(answers["candidate_wins"]),
        charts.deep_pair_counts(answers["collision_loss"]),
        charts.stability_bars(answers["stability"]),
        charts.navigable_bars(answers["navigability"]),
        charts.stage_bars(answers["stage_timing"], STAGES),
        charts.scene_bars(_of_scenes(answers), STAGES),
    ]
    return [chart for chart in drawn if chart is not None]


def picture_scene_of(lake: Lake, snapshot_id: int, scene_id: str, look: PictureConfig) -> ScenePictures:
    """Pictures of a scene in a snapshot. Runs in a worker process.

    Raises:
        LakeError: the scene is not there, or one of its meshes cannot be read.
    """
    from tasks.meshes import load_glb
    from tasks.replica import placed_parts, room_shell
    from tasks.stats.charts import loss_curve
    from tasks.stats.collisions import colliding_pairs, marked_picture
    from tasks.stats.scenes import Outline, best_corner, picture_scene

    reader = lake.snapshot(snapshot_id)
    found = reader.rows(Scene, scene_id)
    if not found:
        raise InputError("scenes", scene_id, "is not in the snapshot", "run its capture stage")
    scan = load_glb(lake.blobs[found[0].mesh_blob], f"{scene_id} scan")
    rooms = reader.rows(Room, scene_id)
    placements = reader.rows(Placement, scene_id)
    assets = {asset.asset_id: asset for asset in reader.rows_by_key(Asset, sorted({p.asset_id for p in placements}))}
    blobs = {p.instance_id: lake.blobs[assets[p.asset_id].mesh_blob] for p in placements}
    objects = {p.instance_id: placed_parts(p, blobs[p.instance_id]) for p in placements}
    shell = {name: [part] for name, part in room_shell(rooms[0])} if rooms else {}
    outline = Outline.of_room(rooms[0]) if rooms else Outline.of_parts(scan)
    walls = [part for parts in shell.values() for part in parts]
    pictures = picture_scene(scan, walls, list(objects.values()), outline, look)
    if not placements:
        return pictures
    contacts = reader.rows(Contact, scene_id)
    camera = best_corner(list(objects.values()), walls, outline, look)
    proposed = {p.instance_id: placed_parts(p, blobs[p.instance_id], "proposed") for p in placements}
    return dataclasses.replace(
        pictures,
        before=marked_picture(proposed, shell, colliding_pairs(contacts, "proposed"), outline, camera, look),
        after=marked_picture(objects, shell, colliding_pairs(contacts, "optimized"), outline, camera, look),
        loss_curve=loss_curve(reader.arrow("optimization_steps", scene_id), placements[0].method, scene_id),
        plan=_plan(lake, reader, scene_id, objects, rooms[0]) if rooms else None,
    )


def _plan(lake: Lake, reader: Reader, scene_id: str, objects: Mapping[str, Sequence[trimesh.Trimesh]], room: Room) -> bytes | None:
    """The floor plan of a scene for the agent with the most episodes; None without a navmesh."""
    from tasks.stats.plans import floor_plan

    episodes = reader.rows(Episode, scene_id)
    count = Counter(episode.agent for episode in episodes)
    navmesh = min(reader.rows(Navmesh, scene_id), key=lambda row: (-count[row.agent], row.agent), default=None)
    if navmesh is None:
        return None
    names = {row.instance_id: f"{row.category} {row.instance_id}" for row in reader.rows(Instance, scene_id)}
    own = [episode for episode in episodes if episode.agent == navmesh.agent]
    return floor_plan(lake.blobs[navmesh.navmesh_blob], own, objects, names, room)


def _picture_scenes(
    lake: Lake,
    snapshot_id: int,
    scenes: Sequence[str],
    look: PictureConfig,
    workers: int | None,
    advance: Callable[[str], None] | None,
) -> dict[str, ScenePictures | str]:
    """Pictures per scene, or why there are none. One worker means this process."""
    count = workers or min(os.cpu_count() or 1, len(scenes), 4)
    call: Callable[..., ScenePictures] = _call_here
    if count <= 1 or len(scenes) <= 1:
        return {scene: _picture_or_reason(call, lake, snapshot_id, scene, look, advance) for scene in scenes}
    from flows.pool import WorkerPool

    with WorkerPool(count) as pool, ThreadPoolExecutor(count) as threads:
        made = threads.map(lambda scene: _picture_or_reason(pool.call, lake, snapshot_id, scene, look, advance), scenes)
        return dict(zip(scenes, made, strict=True))


def _call_here(function: Callable[..., ScenePictures], *arguments: object) -> ScenePictures:
    return function(*arguments)


def _picture_or_reason(
    call: Callable[..., ScenePictures],
    lake: Lake,
    snapshot_id: int,
    scene: str,
    look: PictureConfig,
    advance: Callable[[str], None] | None,
) -> ScenePictures | str:
    """A scene that cannot be pictured costs its pictures, not the report."""
    from flows.pool import WorkerLost

    try:
        return call(picture_scene_of, lake, snapshot_id, scene, look)
    except (LakeError, WorkerLost, OSError, KeyError, ValueError) as error:
        return f"{type(error).__name__}: {error}" if not isinstance(error, LakeError) else str(error)
    finally:
        if advance is not None:
            advance(scene)


def _of_scenes(answers: Mapping[str, pa.Table]) -> pa.Table:
    """Runs of scenes, without those of batches."""
    import pyarrow.compute as pc

    runs = answers["current_runs"]
    return runs.filter(pc.is_in(runs["scene_id"], value_set=answers["objects_per_scene"]["scene_id"].combine_chunks()))


def _code_version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("metascenes")
    except PackageNotFoundError:
        return "(not installed)"
