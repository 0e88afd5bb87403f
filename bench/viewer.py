"""The benchmark of the viewer: how long until a scene is seen, drawn without a graphics processor, and how it follows the hand."""

from __future__ import annotations

import dataclasses
import json
import shutil
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bench.goals import goal
from bench.machine import machine
from bench.samples import fingerprint, sample, stage_run
from bench.tables import add_row, goals_table, headline, table_of
from schemas.candidates import Asset, Candidate
from schemas.capture import Instance, Scene, Shell
from schemas.errors import InputError
from schemas.machine.environment import child_environment
from schemas.optimization import Placement
from schemas.selection import Selection
from tasks.candidates.assets import make_asset
from tasks.candidates.procedural import Procedural
from tasks.furniture import CATEGORIES, generate
from tasks.geometry.meshes import dump_glb, dump_points
from tasks.geometry.transforms import flat, matrix, transform_points, translation
from warehouse.lake import Lake

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page
    from rich.console import Console

MOST_SECONDS = 3.0
"""Until a scene is seen whole."""

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-background-networking", "--no-first-run")
WINDOW = {"width": 1280, "height": 800}
MOVES = 30
OBJECT_POINTS = 500
_PATIENCE_S = 120.0


@dataclasses.dataclass(frozen=True)
class ViewerBench:
    """What is measured. lake: whose first scene is shown; None makes one of so many points and objects, the latter with so many
    candidates each, in `slots`. pages: how often it is opened."""

    lake: str | None = None
    points: int = 200_000
    objects: int = 40
    pages: int = 5
    seed: int = 0
    slots: int = 1


def run_viewer_bench(config: ViewerBench, advance: Callable[[], None]) -> dict[str, Any]:
    """Figures of every page that was opened, each with an empty cache, and what is wanted of them. The first one waits for the server,
    too, which has just been started."""
    with tempfile.TemporaryDirectory() as folder, browser_without_gpu() as browser:
        address = config.lake or made_lake(Path(folder) / "lake", config).address
        with _served(address) as page:
            rows = []
            for _ in range(config.pages):
                rows.append(_opened(browser, page))
                advance()
    seconds = [row["seconds"] for row in rows]
    goals = [goal("median seconds until the scene is seen whole", statistics.median(seconds), "<=", MOST_SECONDS)]
    return {"machine": machine(), "config": dataclasses.asdict(config), "pages": rows, "goals": goals}


def made_lake(folder: Path, config: ViewerBench) -> Lake:
    """A lake with one furnished scene: a floor with so many scanned points that is not flat, and models of the furniture generator.

    The first candidate of an object is the model that stands for it; the others are those of the objects after it.
    """
    rng, lake = np.random.default_rng(config.seed), Lake.open(folder)
    side = int(np.ceil(config.objects**0.5)) * 1.6 + 0.8
    ring, scene_id = ((0.0, 0.0), (side, 0.0), (side, side), (0.0, side)), "bench/room"
    assets = [_model(lake, index, config.seed) for index in range(config.objects)]
    instances, candidates, selections, placements = [], [], [], []
    columns = int(np.ceil(config.objects**0.5))
    for index, asset in enumerate(assets):
        pose = flat(translation((1.2 + 1.6 * (index % columns), 1.2 + 1.6 * (index // columns), 0.0)))
        of = {"scene_id": scene_id, "instance_id": f"{index:04d}"}
        instances.append(
            sample(
                Instance, **of, category=asset.category, is_structure=False, mesh_blob=None, view_blob=None, hidden_m=None,
                box_pose=flat(translation((0.0, 0.0, asset.extents[2] / 2)) @ matrix(pose)), box_size=asset.extents,
                points_blob=lake.blobs.put(_points(asset, matrix(pose), rng), "ply"),
            )
        )  # fmt: skip
        for slot in range(1, config.slots + 1):
            offer = {"slot": slot, "asset_id": assets[(index + slot - 1) % len(assets)].asset_id}
            candidates.append(sample(Candidate, **of, **offer, outcome="filled", is_fallback=False))
            selections.append(sample(Selection, **of, **offer, rank=slot, score=1 / slot, pose=pose, scale=(1.0, 1.0, 1.0)))
        poses = {"proposed_pose": pose, "optimized_pose": pose, "settled_pose": pose}
        placements.append(sample(Placement, **of, **poses, asset_id=asset.asset_id, scale=(1.0, 1.0, 1.0), remains=None))
    shell = sample(
        Shell, scene_id=scene_id, floor_polygon=ring, height_m=2.5, interior_walls=(), openings=None, slopes=None, lintels=None,
        walls=tuple((*a, *b) for a, b in zip(ring, ring[1:] + ring[:1], strict=True)),
    )  # fmt: skip
    scan = lake.blobs.put(_scan(config.points, side, rng), "glb")
    capture = {
        "scenes": [sample(Scene, scene_id=scene_id, room_id=scene_id, mesh_blob=scan, vertex_count=config.points)],
        "shells": [shell], "rooms": [], "surfaces": [], "frames": [], "instances": instances, "masks": [],
    }  # fmt: skip
    rest = ("supports", "contacts", "optimization_steps", "optimizations", "certificates")
    written: dict[str, Mapping[str, list[Any]]] = {
        "capture": capture,
        "candidates": {"candidates": candidates, "assets": [asset for i, asset in enumerate(assets) if asset not in assets[:i]]},
        "selection": {"selections": selections},
        "optimization": {"placements": placements, **{table: [] for table in rest}},
    }
    for stage, rows in written.items():
        lake.stage_rows(stage_run(scene_id, stage, fingerprint(stage)), rows)
    lake.commit("a scene for the viewer")
    return lake


def _model(lake: Lake, index: int, seed: int) -> Asset:
    """An asset of the furniture generator, its files in the lake."""
    category = CATEGORIES[index % len(CATEGORIES)]
    model = generate(category, None, np.random.default_rng([seed, index]))
    made = make_asset(
        model.parts, provider=Procedural.kind, name=f"{category} {index}", category=category, source="furniture generator",
        license="CC0-1.0", pieces=model.pieces,
    )  # fmt: skip
    for name, data in made.files.items():
        lake.blobs.put(data, name.rpartition(".")[2])
    return made.asset


def _points(asset: Asset, pose: NDArray[np.float64], rng: np.random.Generator) -> bytes:
    """What the scan has of an object: points in its box, PLY."""
    points = rng.uniform((-0.5, -0.5, 0.0), (0.5, 0.5, 1.0), (OBJECT_POINTS, 3)) * np.array(asset.extents)
    return dump_points(transform_points(points, pose), np.full((OBJECT_POINTS, 3), 120, dtype=np.uint8))


def _scan(points: int, side: float, rng: np.random.Generator) -> bytes:
    """A floor as a scanner sees it: a grid of vertices with noise and colors, twice as many faces, GLB."""
    import trimesh

    edge = round(points**0.5)
    x, y = np.meshgrid(np.linspace(0, side, edge), np.linspace(0, side, edge), indexing="ij")
    vertices = np.column_stack([x.ravel(), y.ravel(), rng.normal(0.0, 0.004, edge**2)])
    corner = (np.arange(edge - 1)[:, None] * edge + np.arange(edge - 1)).ravel()
    faces = np.concatenate(
        [
            np.column_stack([corner, corner + edge, corner + 1]),
            np.column_stack([corner + 1, corner + edge, corner + edge + 1]),
        ]
    )
    colors = np.column_stack([rng.integers(90, 200, (edge**2, 3)), np.full(edge**2, 255)]).astype(np.uint8)
    return dump_glb([trimesh.Trimesh(vertices, faces, vertex_colors=colors, process=False)])


@contextmanager
def browser_without_gpu() -> Iterator[Browser]:
    """A browser without a graphics processor.

    Raises:
        InputError: there is none on this machine, or nothing to drive it by.
    """
    path = next((place for name in BROWSERS if (place := shutil.which(name))), None)
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        raise InputError("metascenes bench view", "playwright", "is not installed", "`make test` installs it") from error
    if path is None:
        raise InputError("metascenes bench view", "chromium", "is not on this machine", "apt-get install chromium")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, args=list(FLAGS), env=dict(child_environment()))
        yield started
        started.close()


@contextmanager
def _served(lake: str) -> Iterator[str]:
    """The address of `metascenes view` on a lake."""
    command = [sys.executable, "-m", "flows.cli", "view", "--lake", lake, "--no-browser", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            line = process.stdout.readline() if process.stdout else ""
            if not line:
                raise InputError("metascenes view", lake, "does not serve; it says why above")
            yield str(json.loads(line)["address"])
        finally:  # also where what was done with it failed
            process.send_signal(signal.SIGINT)


def _opened(browser: Browser, address: str) -> dict[str, Any]:
    """One page: seconds until scan and replica are drawn, what came over the wire, and how it follows clicks and the hand."""
    context = browser.new_context(viewport=WINDOW)  # type: ignore[arg-type]
    page, sizes = context.new_page(), list[int]()
    page.on("response", lambda answer: sizes.append(int(answer.headers.get("content-length", 0))))
    begun = time.perf_counter()
    page.goto(address)
    wait_for(page, "Boolean(document.documentElement?.dataset.ready)")
    seconds = time.perf_counter() - begun
    begun = time.perf_counter()
    page.locator("[data-instance]").first.click()
    wait_for(page, "Boolean(document.querySelector('.pane code'))")
    facts = time.perf_counter() - begun
    box = page.locator(".view").bounding_box() or {"x": 0, "y": 0, "width": 2, "height": 2}
    x, y = box["x"] + box["width"] * 0.7, box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    drawn, begun = page.evaluate("view.state.drawings"), time.perf_counter()
    for move in range(MOVES):
        page.mouse.move(x + 4 * move, y)
    turning = time.perf_counter() - begun
    drawings = page.evaluate("view.state.drawings") - drawn
    page.mouse.up()
    heap = page.evaluate("performance.memory?.usedJSHeapSize ?? 0")
    context.close()
    return {
        "seconds": seconds, "mb": sum(sizes) / 1e6, "click_ms": 1000 * facts, "turning_s": turning, "turning_drawings": drawings,
        "heap_mb": heap / 1e6,
    }  # fmt: skip


def wait_for(page: Page, condition: str) -> None:
    """Until a condition holds. Polled, since the page lets nobody make code of text."""
    from playwright.sync_api import Error

    end = time.perf_counter() + _PATIENCE_S
    while time.perf_counter() < end:
        try:
            if page.evaluate(condition):
                return
        except Error as error:  # the address with the token leads on to the page
            if "context was destroyed" not in str(error):
                raise
        page.wait_for_timeout(10)
    raise InputError(page.url, condition, f"does not hold after {_PATIENCE_S:g} s")


def print_viewer_report(report: Mapping[str, Any], console: Console) -> None:
    """The report as tables."""
    config = report["config"]
    console.print(headline(report["machine"], config["seed"], 1), soft_wrap=True)
    what = config["lake"] or f"{config['points']:,} points and {config['objects']} objects"
    columns = ("page", "until seen whole [s]", "over the wire [MB]", "click to facts [ms]", "drawings a second in a turn", "heap [MB]")
    title = f"pages of {what}, each with an empty cache, drawn by the processor"
    table = table_of(title, *((column, True) for column in columns))
    for number, row in enumerate(report["pages"], 1):
        rate = row["turning_drawings"] / row["turning_s"]
        cells = [f"{row['seconds']:.2f}", f"{row['mb']:.1f}", f"{row['click_ms']:.0f}", f"{rate:.1f}", f"{row['heap_mb']:.0f}"]
        add_row(table, str(number), *cells)
    console.print(table)
    console.print(goals_table(report["goals"]))
