"""The benchmark of the viewer: its scene is as large as it says, and every figure is of a page that was drawn."""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from bench.annotating import print_annotating_report, run_annotating_bench
from bench.viewer import BROWSERS, ViewerBench, made_lake, print_viewer_report, run_viewer_bench
from flows.view import bundle
from flows.view.scene import Scenes
from schemas.capture import Scene
from schemas.errors import InputError
from tasks.geometry.meshes import surface_of_glb


def test_the_scene_has_as_many_points_and_objects_as_asked_for(tmp_path: Path) -> None:
    lake = made_lake(tmp_path / "lake", ViewerBench(points=2500, objects=7))
    (scene,) = lake.snapshot().rows(Scene)
    assert len(surface_of_glb(lake.blobs[scene.mesh_blob]).vertices) == 2500
    objects = Scenes(lake).shown(scene.scene_id).document["objects"]
    assert len([row for row in objects if row["placed"]]) == 7
    assert len({tuple(row["placed"]["poses"]["optimized"]) for row in objects}) == 7


@pytest.mark.whole
@pytest.mark.browser
@pytest.mark.skipif(not bundle.is_built(), reason="`make client` has not been run")
@pytest.mark.slow
def test_every_page_has_its_figures() -> None:
    if not any(map(shutil.which, BROWSERS)):
        pytest.skip("no chromium on this machine; apt-get install chromium")
    pages: list[None] = []
    report = run_viewer_bench(ViewerBench(points=2500, objects=3, pages=2), lambda: pages.append(None))
    assert len(pages) == len(report["pages"]) == 2
    for row in report["pages"]:
        assert row["seconds"] > 0
        assert row["turning_drawings"] > 0
        assert row["mb"] > bundle.BUILT.joinpath("view.js").stat().st_size / 1e6, "the cache was empty"
    said = io.StringIO()
    print_viewer_report(report, Console(file=said, width=140))
    assert "2,500 points and 3 objects" in said.getvalue()
    assert "median seconds until the scene is seen whole" in said.getvalue()


@pytest.mark.whole
@pytest.mark.browser
@pytest.mark.skipif(not bundle.is_built(), reason="`make client` has not been run")
@pytest.mark.slow
def test_every_annotation_page_has_its_figures() -> None:
    if not any(map(shutil.which, BROWSERS)):
        pytest.skip("no chromium on this machine; apt-get install chromium")
    report = run_annotating_bench(ViewerBench(points=2500, objects=11, pages=1), lambda: None)
    (row,) = report["pages"]
    assert 0 < row["usable_s"] <= row["seconds"]
    assert row["kept_ms"] > 0
    assert row["settled_s"] > 0
    assert row["dragging_fps"] > 0
    said = io.StringIO()
    print_annotating_report(report, Console(file=said, width=140))
    assert "2,500 points and 11 objects" in said.getvalue()
    assert {one["wanted"] for one in report["goals"]} == {"<= 3", "< 100", "< 1"}


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.browser
@pytest.mark.skipif(not bundle.is_built(), reason="`make client` has not been run")
@pytest.mark.parametrize("bench", [run_viewer_bench, run_annotating_bench])
def test_a_page_that_fails_ends_the_bench(bench: Callable[[ViewerBench, Callable[[], None]], dict[str, Any]]) -> None:
    """The server is ended, too: nothing waits for it."""
    if not any(map(shutil.which, BROWSERS)):
        pytest.skip("no chromium on this machine; apt-get install chromium")

    def fail() -> None:
        raise InputError("page", "condition", "does not hold")

    with pytest.raises(InputError, match="does not hold"):
        bench(ViewerBench(points=2500, objects=11, pages=1), fail)


def test_a_lake_of_somebodys_is_not_annotated_by_a_benchmark() -> None:
    with pytest.raises(InputError, match="--annotate"):
        run_annotating_bench(ViewerBench(lake="demo/lake"), lambda: None)
