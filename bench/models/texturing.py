"""The benchmark of textures: layouts of xatlas and Smart UV side by side, and baked colors held against what is true.

Objects with known colors are scanned by the virtual scanner and baked onto their own geometry: from poses as they are and colors without
noise, from the scanner's images at true poses, and from all that a scan has wrong, its poses too.
"""

from __future__ import annotations

import dataclasses
import time
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.goals import goal
from bench.machine import machine
from bench.shelves import models_in
from bench.tables import add_row, goals_table, headline, table_of
from schemas.errors import InputError
from tasks.furniture import CATEGORIES, generate
from tasks.geometry.meshes import Surface, surface_of
from tasks.geometry.rendering import Camera, RayScene, in_picture, reach
from tasks.geometry.transforms import look_at
from tasks.scanner import ScannerConfig
from tasks.scanner.route import plan_views, targets_of
from tasks.scanner.scenery import Paint, scenery_of
from tasks.scanner.sensor import LIGHT, color_camera, depth_camera, drift, shoot
from tasks.texturing.baking import Atlas, BakeConfig, Baked, atlas_of, baked
from tasks.texturing.charts import chart_figures
from tasks.texturing.twin import own_colors, textured_mesh
from tasks.texturing.unwrapping import SmartUvUnwrapper, Unwrapper, XatlasUnwrapper, unwrapped
from tasks.texturing.views import ColorView

if TYPE_CHECKING:
    import trimesh
    from rich.console import Console

Array = NDArray[np.float64]

BAKED = ("aws_ChairA_01", "aws_NightStand_01", "aws_Sofa_01", "aws_Trash_01")
"""Models of the library that are scanned and baked: cloth, wood and metal, with pictures on all of them."""

DRAWN = ("chair", "bookshelf")
"""Categories of the generator that are, plain but for their parts: without pictures, an error is one of place."""

KINDS = ("exact", "noisy", "drifting")
"""How a scan is wrong: not at all; noise, exposure and depth; and poses, too."""

EXACT_LEVELS, DRIFTING_LEVELS = 8.0, 16.0
"""Mean error of seen texels, of 255, that is still no stain: images show a pixel for one or two texels of a picture."""

_FLOOR_M = 5.0
_MOST_VIEWS = 60


@dataclasses.dataclass(frozen=True)
class TexturingBench:
    """What is measured. library: folder of GLB files; None measures none. blender: interpreter with bpy, or a blender binary; without one
    xatlas stands alone. models: of the generator, per category. pictures: folder for pictures of what was baked; None draws none."""

    library: str | None = None
    blender: str = ""
    models: int = 1
    bakes: bool = True
    pictures: str | None = None
    seed: int = 0


def steps_of(config: TexturingBench) -> int:
    """Assets that will be laid out and baked, for a progress bar."""
    return len(CATEGORIES) * config.models + len(models_in(config.library or None)) + (len(_scanned(config)) if config.bakes else 0)


def run_texturing_bench(config: TexturingBench, advance: Callable[[], None]) -> dict[str, Any]:
    """Figures of every layout and of everything baked, and goals."""
    tools: list[Unwrapper] = [XatlasUnwrapper()]
    tools += [SmartUvUnwrapper(program=config.blender)] if config.blender else []
    layouts, bakes = [], []
    for source, name, surface in _assets(config):
        layouts += [laid_out(source, name, surface, tool) for tool in tools]
        advance()
    for name, parts in _scanned(config) if config.bakes else []:
        bakes += scanned_and_baked(name, parts, config)
        advance()
    goals = [*_layout_goals(layouts), *_bake_goals(bakes)]
    return {"machine": machine(), "seed": config.seed, "layouts": layouts, "bakes": bakes, "goals": goals}


def laid_out(source: str, name: str, surface: Surface, tool: Unwrapper) -> dict[str, Any]:
    """Figures of an asset's layout by a tool, or why there is none."""
    row: dict[str, Any] = {"source": source, "name": name, "tool": tool.kind, "faces": len(surface.faces)}
    try:
        layout = unwrapped(tool, surface.vertices, surface.faces)
        figures = chart_figures(layout.vertices, layout.faces, layout.uv)
    except (InputError, ValueError) as error:
        return row | {"problem": str(error)}
    return row | {"problem": "", "seconds": layout.seconds} | dataclasses.asdict(figures)


def scanned_and_baked(name: str, parts: Sequence[trimesh.Trimesh], config: TexturingBench) -> list[dict[str, Any]]:
    """Color errors of an object that was scanned and baked, a row for every way in which a scan is wrong. parts: +Z up [m], z = 0 below."""
    surface = surface_of(parts)
    layout = unwrapped(XatlasUnwrapper(), surface.vertices, surface.faces)
    settings = BakeConfig()
    atlas = atlas_of(layout.vertices, layout.faces, layout.uv, settings)
    scene = RayScene([*parts, _floor()])
    rows, images, truth = [], {}, np.zeros((len(atlas.points), 3))
    walk = ObjectWalk.around(parts, config.seed)
    for kind in KINDS:
        views = walk.scan(kind, config.seed)
        if kind == "exact":
            truth = _lit(atlas, own_colors(parts, atlas.texels), views, scene)
        clock = time.monotonic()
        result = baked(atlas, views, scene, settings)
        seconds = time.monotonic() - clock
        plain = baked(atlas, views, scene, dataclasses.replace(settings, solves_gains=False))
        figures = _errors(atlas, result, truth) | {"mean_without_gains": _errors(atlas, plain, truth)["mean"]}
        rows.append({"name": name, "kind": kind, "views": len(views), "seconds": seconds} | figures)
        images[kind] = result.image
    if config.pictures is not None:
        meshes = [list(parts), *([textured_mesh(surface.vertices, layout, images[kind], 95)] for kind in KINDS)]
        draw(Path(config.pictures) / f"{name}.png", meshes, surface)
    return rows


@dataclasses.dataclass(frozen=True)
class ObjectWalk:
    """Where somebody goes who scans an object on a floor. poses: camera to world, 4x4 each [m]."""

    parts: list[trimesh.Trimesh]
    poses: list[Array]

    @staticmethod
    def around(parts: Sequence[trimesh.Trimesh], seed: int) -> ObjectWalk:
        """The walk that the scanner plans."""
        settings, rng = ScannerConfig(view_limit=_MOST_VIEWS), np.random.default_rng(seed)
        scenery = scenery_of([("floor", _floor()), *((f"object|object|{index}", part) for index, part in enumerate(parts))])
        targets = targets_of(scenery, settings.target_spacing_m, settings.target_least, rng)
        return ObjectWalk(scenery.parts, plan_views(RayScene(scenery.parts), scenery, targets, settings, rng))

    def scan(self, kind: str, seed: int) -> list[ColorView]:
        """Images that are taken on the way, with what is wrong with scans of a kind."""
        settings = ScannerConfig(color_width=640, color_height=480)
        if kind == "exact":
            settings = dataclasses.replace(settings, color_noise=0.0, exposure_spread=0.0, depth_noise_m=0.0, depth_noise_per_m=0.0)
        rng, scene = np.random.default_rng([seed, zlib.crc32(kind.encode())]), RayScene(self.parts)
        offs = drift(len(self.poses), settings, rng) if kind == "drifting" else [np.eye(4)] * len(self.poses)
        paint, views = Paint(scene), []
        for pose, off in zip(self.poses, offs, strict=True):
            shot = shoot(scene, paint, pose, pose @ off, settings, rng)
            color, depth = partial(np.asarray, shot.color), partial(np.divide, shot.depth, np.float32(1000.0), dtype=np.float32)
            views.append(ColorView(color_camera(shot.pose, settings), color, depth_camera(shot.pose, settings), depth))
        return views


def _lit(atlas: Atlas, own: NDArray[np.uint8], views: Sequence[ColorView], scene: RayScene) -> Array:
    """What the scanner's camera would show of each texel without noise, shape (t, 3): its color in the scanner's light, on the side that
    most images see."""
    votes = np.zeros(len(atlas.points))
    for view in views:
        index = np.flatnonzero(in_picture(view.camera, atlas.points))
        away = view.camera.pose[:3, 3] - atlas.points[index]
        clear = reach(view.camera, atlas.points[index], scene) >= np.linalg.norm(away, axis=1) - BakeConfig().touch_m
        votes[index[clear]] += np.sign(np.einsum("tk,tk->t", away[clear], atlas.normals[index[clear]]))
    normals = np.where(votes < 0, -1.0, 1.0)[:, None] * atlas.normals
    light = 0.62 + 0.26 * np.maximum(normals @ LIGHT, 0.0) + 0.12 * (0.5 + 0.5 * normals[:, 0])  # as the scanner's camera has it
    return np.asarray(np.clip(own * light[:, None], 0.0, 255.0))


def _errors(atlas: Atlas, result: Baked, truth: Array) -> dict[str, Any]:
    """Share of texels that were seen, and how far their colors are off [levels of sRGB]."""
    rows, columns = atlas.texels.row, atlas.texels.column
    seen = result.seen[rows, columns]
    off = result.image[rows, columns].astype(np.float64) - truth
    size = np.abs(off[seen]).mean(axis=1)
    hidden = np.abs(off[~seen]).mean() if (~seen).any() else 0.0
    middle, worst = np.quantile(size, [0.5, 0.9]) if len(size) else (np.nan, np.nan)
    return {
        "texels": len(seen), "side_px": atlas.shape[0], "seen_share": result.seen_share, "looks": result.looks,
        "mean": float(size.mean()), "median": float(middle), "p90": float(worst), "bias": float(off[seen].mean()),
        "mean_hidden": float(hidden), "gain_spread": float(result.gains.std()),
    }  # fmt: skip


def draw(path: Path, rows: Sequence[Sequence[trimesh.Trimesh]], surface: Surface) -> None:
    """Draw an object's versions side by side, from before and from behind."""
    from PIL import Image

    low, high = surface.bounds
    center, far = (low + high) / 2, 1.5 * float(np.linalg.norm(high - low))
    pictures = []
    for turn in (0.6, 0.6 + np.pi):
        eye = center + far * np.array([0.8 * np.cos(turn), 0.8 * np.sin(turn), 0.5])
        camera = Camera.with_fov(look_at(eye, center), 480, 400, 0.8)
        pictures.append(np.concatenate([RayScene(parts).render(camera, shade=False).color for parts in rows], axis=1))
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(np.concatenate(pictures)).save(path)


def _floor() -> trimesh.Trimesh:
    import trimesh

    floor = trimesh.creation.box((_FLOOR_M, _FLOOR_M, 0.1))
    floor.apply_translation([0.0, 0.0, -0.0501])
    return floor


def _assets(config: TexturingBench) -> Iterator[tuple[str, str, Surface]]:
    """Source, name and surface of every asset that is laid out."""
    for model in models_in(config.library or None):
        yield "others", model.made.asset.name, surface_of(model.parts())
    for category in CATEGORIES:
        for number in range(config.models):
            drawn = generate(category, None, np.random.default_rng([config.seed, number, zlib.crc32(category.encode())]))
            yield "generator", f"{category} {number}", surface_of(drawn.parts)


def _scanned(config: TexturingBench) -> list[tuple[str, list[trimesh.Trimesh]]]:
    """What is scanned and baked: name, and parts with their colors."""
    made = [(model.stem, model.parts()) for model in models_in(config.library or None) if model.stem in BAKED]
    drawn = [(category, generate(category, None, np.random.default_rng(config.seed)).parts) for category in DRAWN]
    return made + drawn


def _layout_goals(layouts: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    goals = []
    for tool in dict.fromkeys(row["tool"] for row in layouts):
        of = [row for row in layouts if row["tool"] == tool]
        laid = [row for row in of if not row["problem"]]
        goals.append(goal(f"{tool}: share of assets that are laid out", len(laid) / len(of), ">=", 0.99))
        clear = np.mean([row["overlap"] <= 1e-3 for row in laid])
        goals.append(goal(f"{tool}: share of layouts in which at most 0.1 % overlap", float(clear), ">=", 0.95))
    pairs = paired(layouts)
    if pairs:
        fewer = float(np.mean([smart["charts"] <= plain["charts"] for plain, smart in pairs]))
        goals.append(goal("share of assets of which smart_uv makes no more charts than xatlas", fewer, ">=", 0.5))
    return goals


def _bake_goals(bakes: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    worst = {kind: max((row["mean"] for row in bakes if row["kind"] == kind), default=None) for kind in KINDS}
    if not bakes:
        return []
    return [
        goal("largest mean error of what was baked from exact images", worst["exact"], "<=", EXACT_LEVELS),
        goal("largest mean error of what was baked from drifting poses", worst["drifting"], "<=", DRIFTING_LEVELS),
    ]


def paired(layouts: Sequence[Mapping[str, Any]]) -> list[tuple[Mapping[str, Any], Mapping[str, Any]]]:
    """Layouts of one asset by xatlas and by Smart UV, where both made one."""
    by = {(row["source"], row["name"], row["tool"]): row for row in layouts if not row["problem"]}
    other = SmartUvUnwrapper.kind
    return [(row, by[s, n, other]) for (s, n, tool), row in by.items() if tool == XatlasUnwrapper.kind and (s, n, other) in by]


_COLUMNS = ("charts", "stretch_l2", "stretch_linf", "angle_distortion", "coverage", "overlap", "seam_ratio", "seconds")


def print_texturing(report: Mapping[str, Any], console: Console) -> None:
    """Print the report as tables: layouts by source and tool, and everything that was baked."""
    console.print(headline(report["machine"], report["seed"], 1))
    table = table_of(
        "layouts: medians of assets", ("", False), ("tool", False), ("assets", True), *((name.replace("_", " "), True) for name in _COLUMNS)
    )
    for source in dict.fromkeys(row["source"] for row in report["layouts"]):
        for tool in dict.fromkeys(row["tool"] for row in report["layouts"]):
            of = [row for row in report["layouts"] if (row["source"], row["tool"], row["problem"]) == (source, tool, "")]
            if of:
                add_row(table, source, tool, str(len(of)), *(f"{np.median([row[name] for row in of]):.4g}" for name in _COLUMNS))
    console.print(table)
    for row in report["layouts"]:
        if row["problem"]:
            console.print(f"{row['name']} by {row['tool']}: {row['problem']}", markup=False)
    figures = ("views", "side_px", "seen_share", "looks", "mean", "median", "p90", "bias", "mean_hidden", "mean_without_gains", "seconds")
    baked_table = table_of(
        "baked: errors in levels of sRGB", ("object", False), ("scan", False), *((name.replace("_", " "), True) for name in figures)
    )
    for row in report["bakes"]:
        add_row(baked_table, row["name"], row["kind"], *(f"{row[name]:.3g}" for name in figures))
    console.print(baked_table)
    console.print(goals_table(report["goals"]))
