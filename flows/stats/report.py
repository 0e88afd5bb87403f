"""The report of a snapshot: all that it says is gathered, drawn and written."""

from __future__ import annotations

import dataclasses
import itertools
import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

import pyarrow as pa

from flows.stats.queries import Answers, answers_of
from flows.stats.scenes import Job, carried_out, drive_still_of, picture_scene_of, strip_of, thumbnails_of, walk_strip_of
from schemas.files import write_whole
from schemas.tables import TABLES
from warehouse.questions.views import asked_by, views

if TYPE_CHECKING:
    from tasks.films.drives import DriveStill
    from tasks.films.walks import WalkStrip
    from tasks.stats.scenes import PictureConfig, ScenePictures
    from tasks.stats.style import Picture
    from tasks.stats.thumbnails import CandidateStrip, SceneTile
    from warehouse.lake import Lake
    from warehouse.tables.snapshot import Reader

STAGES: tuple[str, ...] = tuple(dict.fromkeys(table.stage for table in TABLES.values() if table.stage))
"""Stages in the order of the data path."""


@dataclasses.dataclass(frozen=True)
class Written:
    """A report that was written: its file, the files of its pictures, what it is about, and the pictures themselves, where asked for."""

    path: Path
    files: tuple[Path, ...]
    snapshot_id: int
    answers: Answers
    pictures: tuple[Picture, ...]


def report_path(out: Path) -> Path:
    """The file that a report is written to: `out`, or `report.html` in it when it is a folder."""
    return out / "report.html" if out.is_dir() or not out.suffix else out


def write_report(
    lake: Lake,
    out: Path,
    snapshot_id: int | None = None,
    *,
    pictures: Path | None = None,
    rasters: bool = False,
    pages: Path | None = None,
    look: PictureConfig | None = None,
    workers: int | None = None,
    advance: Callable[[str], None] | None = None,
    expect: Callable[[int], None] | None = None,
) -> Written:
    """Write the report on a snapshot, the newest by default.

    `out` is the HTML file; in a folder, it is `report.html`. `pictures` is a folder that gets every chart and both galleries as
    SVG and PNG; `rasters` asks for them without a folder: the report itself needs no PNG of a chart. `pages` is a folder that
    gets every pictured scene as a page in 3D (`metascenes view`), to which the report links. `look` says how scenes are pictured,
    `workers` how many processes do it (one per core by default); `advance` is told each scene and object that was
    pictured, `expect` how many there will be. The same snapshot and releases give the same bytes.

    Raises:
        InputError: there is no such snapshot.
    """
    from tasks.stats.page.report import Query, ReportContent, render_report
    from tasks.stats.scenes import PictureConfig

    look = look or PictureConfig()
    reader = lake.snapshot(snapshot_id)
    answers = answers_of(reader)
    rasters = rasters or pictures is not None
    charts: list[Picture] = []
    pictured = _pictured(
        lake, reader.snapshot_id, answers, look, pages, workers, advance, expect,
        meanwhile=lambda: charts.extend(draw_charts(answers, rasters)),
    )  # fmt: skip
    path = report_path(out)
    content = ReportContent(
        answers=answers.rows,
        totals=answers.totals,
        queries=[Query(view.name, view.question, view.note, view.query) for view in views()],
        pictures=charts,
        scenes=pictured.scenes,
        tiles=pictured.tiles,
        strips=pictured.strips,
        walks=pictured.walks,
        drives=pictured.drives,
        picture_size=(look.width, look.height),
        stages=STAGES,
        snapshot_id=reader.snapshot_id,
        snapshot_time=f"{reader.snapshot.created_at:%Y-%m-%d %H:%M} UTC" if reader.snapshot else "",
        releases=[release.name for release in reader.releases if release.snapshot_id == reader.snapshot_id],
        code_version=_code_version(),
        pages={scene: quote(Path(os.path.relpath(page, path.parent)).as_posix()) for scene, page in pictured.pages.items()},
    )
    write_whole(path, render_report(content).encode())
    drawn = [*charts, *_sheets(answers, pictured.tiles, pictured.strips)] if rasters else []
    files = []
    if pictures is not None:
        for chart in drawn:
            for suffix, data in (("svg", chart.svg.encode()), ("png", chart.png)):
                files.append(pictures / f"{chart.name}.{suffix}")
                write_whole(files[-1], data)
    return Written(path, tuple(files), reader.snapshot_id, answers, tuple(drawn))


def stage_table(reader: Reader) -> str:
    """Times per stage as plain text for a terminal."""
    from tasks.stats import grids

    return grids.stage_table(_stage_timing(reader), STAGES)


def stage_rows(reader: Reader) -> list[dict[str, Any]]:
    """Times per stage as rows of `stage_timing`, in the order of the data path."""
    from tasks.stats.grids import place

    return sorted(_stage_timing(reader).to_pylist(), key=lambda row: place(row["stage"], STAGES))


def _stage_timing(reader: Reader) -> pa.Table:
    with reader.connect(names=asked_by("stage_timing")) as connection:
        return connection.sql("SELECT * FROM stage_timing").to_arrow_table()


def draw_charts(answers: Answers, rasters: bool = True) -> list[Picture]:
    """All charts that have something to show, in the order of the report; without `rasters`, as SVG alone."""
    from flows.stats.pictures import remembered
    from tasks.micro_scenes import charts as micro_scenes
    from tasks.stats import charts, counts, timelines, volumes, words
    from tasks.stats.style import only_vectors

    rows = answers.rows
    frequent, categories = rows["category_counts"], rows["headline"]["categories"][0].as_py()
    names = frequent["category"].to_pylist()
    runs = rows.get("run_timeline.binned", rows["run_timeline"])
    timed = rows["stage_timing"].num_rows and rows["headline"]["scenes"][0].as_py()
    workers = rows["run_timeline.workers"]["workers"][0].as_py()
    asked: list[tuple[Callable[..., Picture | None], tuple[Any, ...]]] = [
        (counts.per_scene, (rows["objects_per_scene.histogram"], rows["objects_per_scene.listed"], "objects", "objects")),
        (counts.per_scene, (rows["categories_per_scene.histogram"], rows["categories_per_scene.listed"], "categories", "categories")),
        (words.word_cloud, (dict(zip(names, frequent["objects"].to_pylist(), strict=True)),)),
        (counts.category_bars, (frequent, categories)),
        (counts.room_map, (rows["category_by_room_type"],)),
        (micro_scenes.pair_map, (rows["micro_scene_pairs"],)),
        (micro_scenes.room_type_map, (rows["micro_scene_by_room_type"],)),
        (micro_scenes.drawn_layouts, (rows["synthesis_layouts"],)),
        (volumes.volume_boxes, (rows["volume_by_category"], rows["volume_outliers"])),
        (volumes.volume_boxes, (rows["solid_volume_by_category"], rows["solid_volume_outliers"], "solid", "solid_volume_by_category")),
        (charts.candidate_bars, (rows["candidate_wins"],)),
        (charts.deep_pair_counts, (rows["collision_loss.worst"],)),
        (charts.stability_bars, (rows["stability"],)),
        (charts.navigable_bars, (rows["navigability"],)),
        (timelines.stage_bars, (rows["stage_timing"], STAGES)),
        (timelines.scene_bars, (rows["scene_timing.slowest"], timed, STAGES)),
        (timelines.run_gantt, (runs, rows["run_timeline.pauses"], workers, STAGES)),
        (counts.growth, (rows["dataset_growth"],)),
    ]
    with nullcontext() if rasters else only_vectors():
        drawn = [remembered([draw.__module__, draw.__name__, rasters, *arguments], partial(draw, *arguments)) for draw, arguments in asked]
    return [chart for chart in drawn if chart is not None]


@dataclasses.dataclass(frozen=True)
class _Pictured:
    """What workers drew: scenes by id, or why not; both galleries, stills of walks and of carts, and the files of scenes in 3D."""

    scenes: dict[str, ScenePictures | str]
    tiles: list[SceneTile]
    strips: list[CandidateStrip]
    walks: list[WalkStrip]
    drives: list[DriveStill]
    pages: dict[str, Path]


def _pictured(
    lake: Lake, snapshot_id: int, answers: Answers, look: PictureConfig, pages: Path | None, workers: int | None,
    advance: Callable[[str], None] | None, expect: Callable[[int], None] | None, meanwhile: Callable[[], None],
) -> _Pictured:  # fmt: skip
    """Pictures of the first scenes, both galleries, stills of walks and of carts, and the files of scenes in 3D, without those that cannot
    be made; `meanwhile` is called while workers draw."""
    from flows.progress import Progress
    from flows.stats.pictures import forget_old
    from flows.view.standalone import write_page_of
    from tasks.stats.thumbnails import scene_tile

    shown = answers.scenes
    jobs: dict[Any, Job] = {scene: (picture_scene_of, (lake, snapshot_id, scene, look)) for scene in shown.pictured}
    jobs |= {scene: (thumbnails_of, (lake, snapshot_id, scene)) for scene in shown.gallery if scene not in jobs}
    objects = itertools.groupby(answers.rows["instances.gallery"].to_pylist(), lambda row: (row["scene_id"], row["instance_id"]))
    strips = {f"{scene}/{instance}": list(rows) for (scene, instance), rows in objects}
    jobs |= {name: (strip_of, (lake, rows)) for name, rows in strips.items()}
    walks = {"walk {batch_id} {scene_id} {episode_id}".format(**row): row for row in answers.rows["trajectory_metrics.shown"].to_pylist()}
    jobs |= {name: (walk_strip_of, (lake, snapshot_id, row)) for name, row in walks.items()}
    drives = {"drive {batch_id} {scene_id} {episode_id}".format(**row): row for row in answers.rows["robot_runs.shown"].to_pylist()}
    jobs |= {name: (drive_still_of, (lake, snapshot_id, row)) for name, row in drives.items()}
    files = _page_files(shown.pictured, pages) if pages is not None else {}
    anew: dict[Any, Job] = {f"page {scene}": (write_page_of, (lake, snapshot_id, scene, file)) for scene, file in files.items()}
    if expect is not None:
        expect(len(jobs) + len(anew))
    with Progress("pictures", len(jobs) + len(anew), lines=True) as progress:

        def tell(name: str) -> None:
            progress.advance(name)
            if advance is not None:
                advance(name)

        made = carried_out(jobs, workers, tell, meanwhile, anew)
    forget_old()
    tiles = [scene_tile(scene, made[scene]) for scene in shown.gallery]
    objects_shown, walks_shown, drives_shown = (
        [made[name] for name in names if not isinstance(made[name], str)] for names in (strips, walks, drives)
    )
    linked = {scene: file for scene, file in files.items() if isinstance(made[f"page {scene}"], int)}
    return _Pictured({scene: made[scene] for scene in shown.pictured}, tiles, objects_shown, walks_shown, drives_shown, linked)


def _page_files(scenes: Iterable[str], folder: Path) -> dict[str, Path]:
    """Where the pages of scenes in 3D are written, by scene."""
    from flows.view.bundle import client_file
    from tasks.exports.bodies import stem

    client_file("view.html")  # before workers are started: it may not have been built
    return {scene: folder / f"{stem(scene)}.html" for scene in scenes}


def _sheets(answers: Answers, tiles: Sequence[SceneTile], strips: Sequence[CandidateStrip]) -> list[Picture]:
    """The galleries as one picture each."""
    from tasks.stats.contact_sheets import candidate_sheet, scene_sheet

    sheets = (scene_sheet(tiles, answers.rows["headline"]["scenes"][0].as_py()), candidate_sheet(strips))
    return [sheet for sheet in sheets if sheet is not None]


def _code_version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("metascenes")
    except PackageNotFoundError:
        return "(not installed)"
