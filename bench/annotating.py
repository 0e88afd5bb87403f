"""The benchmark of the annotation page: until an object can be worked on, until its pose is kept, until it has settled."""

from __future__ import annotations

import dataclasses
import json
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

from bench.goals import goal
from bench.machine import machine
from bench.tables import add_row, goals_table, headline, table_of
from bench.viewer import MOST_SECONDS, MOVES, WINDOW, ViewerBench, browser_without_gpu, made_lake, wait_for
from flows.inputs.annotation import BatchPlan, create_batch
from schemas.errors import InputError

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page
    from rich.console import Console

MOST_DRAG_MS = 100.0
"""From letting go of an object until the server has its pose."""

MOST_SETTLE_S = 1.0
BATCH, ANNOTATOR = "bench", "ada"
SLOTS = 10
_REACH_M = 1.0  # along its handle an object is felt for so far
_RELEASED = "addEventListener('pointerup', () => { window.released = performance.now(); }, true)"
_KEPT_MS = """() => {
    const isOfDrag = ({ name, startTime }) => name.includes("api/drafts/") && startTime >= released;
    const sent = performance.getEntriesByType("resource").filter(isOfDrag);
    return sent.length ? sent[0].responseEnd - released : null;
}"""


def run_annotating_bench(config: ViewerBench, advance: Callable[[], None]) -> dict[str, Any]:
    """Figures of every page that was opened, each with an empty cache, and what is wanted of them.

    Of settling the first page is left out: the server may still be compiling.

    Raises:
        InputError: the bench is to open a lake of somebody's: it would leave answers there.
    """
    if config.lake is not None:
        raise InputError("metascenes bench view", "--lake", "cannot be given with --annotate", "drafts would stay in it")
    config = dataclasses.replace(config, slots=SLOTS)
    with tempfile.TemporaryDirectory() as folder, browser_without_gpu() as browser:
        lake = made_lake(Path(folder) / "lake", config)
        create_batch(lake, BatchPlan(BATCH, (ANNOTATOR,)), Path(folder) / "work")
        rows = []
        with _served(lake.address) as address:
            for _ in range(config.pages):
                rows.append(_opened(browser, address))
                advance()
    settled = [row["settled_s"] for row in rows][1:] or [rows[0]["settled_s"]]
    goals = [
        goal("median seconds until the scene is seen whole", statistics.median(row["seconds"] for row in rows), "<=", MOST_SECONDS),
        goal("median ms from a drag's end until its pose is kept", statistics.median(row["kept_ms"] for row in rows), "<", MOST_DRAG_MS),
        goal("median seconds until an object has settled", statistics.median(settled), "<", MOST_SETTLE_S),
    ]
    return {"machine": machine(), "config": dataclasses.asdict(config), "pages": rows, "goals": goals}


@contextmanager
def _served(lake: str) -> Iterator[str]:
    """The annotator's address of `metascenes annotate serve` on a lake."""
    command = [sys.executable, "-m", "flows.cli", "annotate", "serve", BATCH, "--lake", lake, "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            line = process.stdout.readline() if process.stdout else ""
            if not line:
                raise InputError("metascenes annotate serve", lake, "does not serve; it says why above")
            yield str(json.loads(line)["addresses"][ANNOTATOR]["address"])
        finally:  # also where what was done with it failed
            process.send_signal(signal.SIGINT)


def _opened(browser: Browser, address: str) -> dict[str, Any]:
    """One page: seconds until its first object can be worked on and until all is drawn, and how it follows the hand and settles."""
    context = browser.new_context(viewport=WINDOW)  # type: ignore[arg-type]
    page = context.new_page()
    begun = time.perf_counter()
    page.goto(address)
    wait_for(page, "Boolean(window.annotate?.stage.replica?.shown.get(annotate.draft?.row.instance_id))")
    usable = time.perf_counter() - begun
    wait_for(page, "Boolean(document.documentElement.dataset.shown)")
    seconds = time.perf_counter() - begun
    page.evaluate(_RELEASED)
    page.keyboard.press("w")
    turning = _rate(page, lambda move: page.mouse.move(900 + 3 * move, 120))
    start = _handle(page)
    dragging = _rate(page, lambda move: page.mouse.move(start[0] + 2 * move, start[1]))
    wait_for(page, f"({_KEPT_MS})() !== null")
    kept = page.evaluate(_KEPT_MS)
    wait_for(page, "annotate.state.saved === 'saved' && Boolean(annotate.figures)")
    begun = time.perf_counter()
    page.keyboard.press("l")
    wait_for(page, "document.querySelector('.status').textContent.startsWith('Settled')")
    settled = time.perf_counter() - begun
    context.close()
    return {"usable_s": usable, "seconds": seconds, "kept_ms": kept, "settled_s": settled, "turning_fps": turning, "dragging_fps": dragging}


def _rate(page: Page, move: Callable[[int], None]) -> float:
    """Drawings a second while the pointer is drawn from its place through moves with a pressed button."""
    move(0)
    page.mouse.down()
    drawn, begun = page.evaluate("annotate.state.drawings"), time.perf_counter()
    for number in range(MOVES):
        move(number)
    drawings, seconds = page.evaluate("annotate.state.drawings") - drawn, time.perf_counter() - begun
    page.mouse.up()
    return float(drawings / seconds)


def _handle(page: Page) -> tuple[float, float]:
    """Where on the page the handle along x is [px].

    Raises:
        InputError: it is nowhere.
    """
    steps = 50
    for step in range(1, steps):
        x = step / steps * _REACH_M
        project = "(x) => { const [px, py, pz] = annotate.state.transform.position; return annotate.stage.project([px + x, py, pz]); }"
        place = page.evaluate(project, x)
        page.mouse.move(place["x"], place["y"])
        if page.evaluate("annotate.stage.gizmo.axis") == "X":
            return float(place["x"]), float(place["y"])
    raise InputError("metascenes bench view", "--annotate", "finds no handle at the object")


def print_annotating_report(report: Mapping[str, Any], console: Console) -> None:
    """The report as tables."""
    config = report["config"]
    console.print(headline(report["machine"], config["seed"], 1), soft_wrap=True)
    columns = ("page", "first object [s]", "all [s]", "drag to kept [ms]", "settled [s]", "drawings a second: in a turn", "in a drag")
    title = (
        f"annotation pages of {config['points']:,} points and {config['objects']} objects, each with an empty cache, drawn by the processor"
    )
    table = table_of(title, *((column, True) for column in columns))
    for number, row in enumerate(report["pages"], 1):
        cells = [f"{row['usable_s']:.2f}", f"{row['seconds']:.2f}", f"{row['kept_ms']:.0f}", f"{row['settled_s']:.2f}"]
        add_row(table, str(number), *cells, f"{row['turning_fps']:.1f}", f"{row['dragging_fps']:.1f}")
    console.print(table)
    console.print(goals_table(report["goals"]))
