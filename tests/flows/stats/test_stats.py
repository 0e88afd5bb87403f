"""The report: what it asks, what it says, what it looks like as a file."""

from __future__ import annotations

import base64
import hashlib
import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from flows.cli import cli
from flows.stats import STAGES, ShownScenes, answers_of, draw_charts, picture_scene_of, report_queries, stage_table, write_report
from flows.stats.queries import _ORDERS as ORDERS
from schemas.capture import Scene, Shell
from schemas.errors import InputError
from schemas.optimization import Placement
from tasks.geometry.transforms import matrix
from tasks.shell import room_shell
from tasks.stats import collisions, contact_sheets, scenes, thumbnails, words
from tasks.stats.columns import GRIDS
from tasks.stats.scenes import PictureConfig, RoomOutline
from tasks.stats.style import INK
from tests.conftest import REPOSITORY
from tests.furnished import furnished_lake, solid
from tests.samples import fingerprint, sample, stage_run
from tests.tasks.test_stats_charts import texts
from warehouse.lake import Lake
from warehouse.questions.views import views
from warehouse.release import make_release

CHARTS = 16
"""Charts over all scenes of a lake in which there is something of everything but releases and drawn scenes."""
OBJECTS = 6
"""Objects in the gallery of candidates: a scene has one of each category."""
IMAGES = 2 * 6 + 2 * 2 + OBJECTS
"""Of each of two scenes six pictures and two thumbnails; of each object its candidate. Charts are part of the page."""
SMALL = PictureConfig(width=120, height=84, oversampling=1)


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return furnished_lake(tmp_path_factory.mktemp("furnished") / "lake")


@pytest.fixture(scope="module")
def report(lake: Lake, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("report")
    return write_report(lake, folder / "report.html", pictures=folder / "pictures", look=SMALL, workers=1).path


@pytest.mark.whole
def test_charts_of_a_lake_are_named_after_views_and_the_same_twice(lake: Lake) -> None:
    answers = answers_of(lake.snapshot())
    drawn, again = draw_charts(answers), draw_charts(answers)
    assert drawn == again
    assert len(drawn) == CHARTS
    assert {chart.source for chart in drawn} <= {view.name for view in views()}
    assert len({chart.name for chart in drawn}) == len(drawn)
    for chart in drawn:
        assert chart.png.startswith(b"\x89PNG")
        assert texts(chart.svg)
        assert "prefers-color-scheme: dark" in chart.svg
        assert INK.light not in chart.svg.partition("</style>")[2]  # all colors are variables
        assert chart.alt.endswith(".")
        assert not re.search(rb"tIME|date:|Software", chart.png)


@pytest.mark.slow
@pytest.mark.whole
def test_a_report_draws_no_raster_that_it_does_not_show(report: Path, lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(contact_sheets, "_as_png", refused)
    monkeypatch.setattr(words, "_png", refused)
    drawn = draw_charts(answers_of(lake.snapshot()), rasters=False)
    assert [chart.png for chart in drawn] == [b""] * CHARTS
    assert [(chart.name, chart.svg) for chart in drawn] == [
        (chart.name, chart.svg) for chart in draw_charts(answers_of(lake.snapshot()), rasters=True)
    ]  # asked for one way, then the other: neither is taken for the other
    written = write_report(lake, tmp_path / "report.html", look=SMALL, workers=1)
    assert written.pictures == ()
    assert written.path.read_bytes() == report.read_bytes()


def refused(*_: object) -> bytes:
    raise AssertionError("a raster that nobody asked for")


def test_an_empty_lake_has_nothing_to_draw(tmp_path: Path) -> None:
    reader = Lake.open(tmp_path / "none").snapshot()
    assert draw_charts(answers_of(reader)) == []
    assert stage_table(reader) == "no stage has run"


class Page(HTMLParser):
    """Ids, links, images and text of a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.charts: list[str] = []
        self.tags: list[str] = []
        self.text = ""
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.tags.append(tag)
        if given.get("id"):
            self.ids.append(str(given["id"]))
        if tag == "a":
            self.links.append(str(given["href"]))
        if tag == "svg":
            self.charts.append(str(given["aria-label"]))
        if tag == "img":
            self.images.append(given)

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_report_is_one_file_that_refers_to_nothing_outside(report: Path) -> None:
    html = report.read_text()
    page = Page(html)
    assert len(page.ids) == len(set(page.ids))
    assert all(link.startswith("#") and link[1:] in page.ids for link in page.links)
    assert len(page.images) == IMAGES
    assert len(page.charts) == CHARTS + 2 * 3, "of each scene its loss curve, floor plan and heat map"
    assert all(page.charts)
    assert all(str(image["src"]).startswith("data:image/") and image["alt"] for image in page.images)
    assert not {"link", "iframe", "object", "embed"} & set(page.tags)
    assert not re.search(r"(?:src|href)=\"(?!data:|#)|@import|url\((?!data:|#)", re.sub(r"data:[^\"]*", "data:", html))
    assert len(html) < 10e6
    assert page.tags.count("h1") == 1


def test_the_report_lets_its_own_script_and_style_run_alone(report: Path) -> None:
    html = report.read_text()
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', html)
    rules = dict(rule.split(" ", 1) for rule in policy.split("; "))
    for tag, rule in (("script", "script-src"), ("style", "style-src-elem")):
        (content,) = re.findall(rf"<{tag}>(.*?)</{tag}>", html, re.DOTALL)
        assert rules[rule] == f"'sha256-{base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()}'"
    assert "unsafe" not in rules["script-src"]
    assert rules["default-src"] == "'none'"
    assert not re.search(r"<[^>]* on[a-z]+=", html), "a policy of hashes stops handlers in attributes"


def test_the_report_says_what_the_views_say(report: Path, lake: Lake) -> None:
    page = Page(report.read_text())
    answers = answers_of(lake.snapshot())
    for view in views():
        assert f"sql-{view.name}" in page.ids
        assert view.question in page.text
    for row in answers.rows["scene_objects.pictured"].to_pylist():
        assert row["instance_id"] in page.text
    assert "28.8 m²" in page.text  # 12.8 + 16
    assert "1 → 0" in page.text  # pairs deeper than 2 mm before and after
    assert "4 of 5, 80%" in page.text  # free objects that stay within 5 cm; one of six is fixed
    assert "80% (16.7% fixed)" in page.text
    assert "free objects stable at 5 cm; 2 fixed" in page.text
    assert "0003 book, 50.0 cm" in page.text
    assert "<nothing> carries it" in page.text
    assert "13 of 14" in page.text  # exports
    assert "determinant is 0; remove the line to have it estimated" in page.text
    assert "no view; shape by category" in page.text
    assert "up is <missing>" in page.text
    assert "CC-BY-4.0" in page.text
    assert f"Snapshot {lake.snapshot().snapshot_id} of " in page.text


def test_a_scene_has_a_picture_before_and_one_after_its_optimization(report: Path) -> None:
    page = Page(report.read_text())
    images = {str(image["alt"]): str(image["src"]) for image in page.images}
    for scene in ("demo/room_0", "demo/room_1"):
        before, after = (images[f"{name} of {scene} seen with what collides marked"] for name in ("Proposed", "Optimized"))
        assert before != after
        assert any(alt.startswith(f"Collision loss of {scene} over 2 steps: 250 mm at the start, 0 mm") for alt in page.charts)


def test_a_scene_has_a_heat_map_and_its_figure(report: Path) -> None:
    page = Page(report.read_text())
    maps = [alt for alt in page.charts if "to its replica" in alt]
    assert maps == [f"Distance of the scan of demo/room_{number} to its replica, from above" for number in (0, 1)]
    drawn = [part for part in report.read_text().split("<svg ") if "to its replica, from above" in part.partition(">")[0]]
    assert len({re.findall(r'<image[^>]*href="([^"]*)"', part)[0] for part in drawn}) == 2, "each has cells of its own"
    text = " ".join(page.text.split())
    assert "F-score at 5 cm0.750" in text
    assert "F-score at 5 cm0.875" in text
    assert "median F-score of scenes' objects at 5 cm0.812" in text


def test_the_picture_before_shows_the_proposed_poses_and_the_one_after_the_optimized(lake: Lake) -> None:
    reader = lake.snapshot()
    placements = reader.rows(Placement, "demo/room_0")
    room = reader.rows(Shell, "demo/room_0")[0]
    shell = {name: [part] for name, part in room_shell(room)}
    parts = [solid(int(placement.instance_id)) for placement in placements]
    pictures = picture_scene_of(lake, reader.snapshot_id, "demo/room_0", SMALL)

    def expected(phase: str, pairs: list[tuple[str, str]]) -> bytes:
        objects, optimized = (
            {
                placement.instance_id: [part.copy().apply_transform(matrix(getattr(placement, f"{name}_pose")))]
                for placement, part in zip(placements, parts, strict=True)
            }
            for name in (phase, "optimized")
        )
        camera = scenes.best_corner(
            list(optimized.values()), [part for of in shell.values() for part in of], RoomOutline.of_room(room), SMALL
        )
        return collisions.marked_picture(objects, shell, pairs, RoomOutline.of_room(room), camera, SMALL)

    assert pictures.before == expected("proposed", [("0000", "0001")])
    assert pictures.after == expected("optimized", [])


def test_the_report_tells_nothing_of_the_machine(report: Path, lake: Lake) -> None:
    html = report.read_text()
    for secret in ("secret-host", "secret folder", "/srv", lake.address, str(Path.home()) + "/"):
        assert secret not in html


@pytest.mark.whole
def test_the_same_snapshot_gives_the_same_report_and_pictures(report: Path, lake: Lake, tmp_path: Path) -> None:
    again = write_report(lake, tmp_path, pictures=tmp_path / "pictures", look=SMALL, workers=1).path
    assert again == tmp_path / "report.html"
    assert again.read_bytes() == report.read_bytes()
    made = sorted(path.name for path in (tmp_path / "pictures").iterdir())
    assert len(made) == 2 * (CHARTS + 2)  # the galleries, too
    for name in made:
        assert (tmp_path / "pictures" / name).read_bytes() == (report.parent / "pictures" / name).read_bytes()


@pytest.mark.slow
def test_any_number_of_workers_gives_the_same_report(report: Path, lake: Lake, tmp_path: Path) -> None:
    told: list[str] = []
    again = write_report(lake, tmp_path / "a.html", look=SMALL, workers=2, advance=told.append).path
    assert again.read_bytes() == report.read_bytes()
    shown = answers_of(lake.snapshot()).rows["instances.gallery"].to_pylist()
    objects = {f"{row['scene_id']}/{row['instance_id']}" for row in shown}
    assert sorted(told) == sorted(["demo/room_0", "demo/room_1", *objects])


@pytest.mark.whole
def test_after_a_new_scene_only_that_scene_is_drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also the gallery's objects, whose categories are more frequent then, are not drawn again. No worker is started where all is known."""
    monkeypatch.setenv("METASCENES_CACHE", str(tmp_path / "cache"))
    lake = furnished_lake(tmp_path / "lake", scenes=1, objects=3)
    write_report(lake, tmp_path / "a.html", look=SMALL, workers=1)
    furnished_lake(tmp_path / "lake", scenes=2, objects=3)
    drawn: list[str] = []
    pictures, thumbnail = scenes.picture_scene, thumbnails.object_thumbnail

    def counted(*arguments: Any, **named: Any) -> Any:
        drawn.append("scene")
        return pictures(*arguments, **named)

    monkeypatch.setattr(scenes, "picture_scene", counted)
    monkeypatch.setattr(thumbnails, "object_thumbnail", lambda *a, **k: drawn.append("object") or thumbnail(*a, **k))
    grown = write_report(lake, tmp_path / "b.html", look=SMALL, workers=1)
    assert sorted(grown.answers.scenes.pictured) == ["demo/room_0", "demo/room_1"]
    shown = grown.answers.rows["instances.gallery"].to_pylist()
    fresh = {(row["asset_blob"], str(row["scale"])) for row in shown if row["scene_id"] == "demo/room_1" and row["asset_blob"]}
    assert drawn.count("scene") == 1
    assert drawn.count("object") <= len(fresh)
    monkeypatch.setattr("flows.run.pool.WorkerPool", refused)
    again = write_report(lake, tmp_path / "c.html", look=SMALL, workers=2)
    assert again.path.read_bytes() == grown.path.read_bytes()


def test_an_empty_lake_has_a_report(tmp_path: Path) -> None:
    page = Page(write_report(Lake.open(tmp_path / "none"), tmp_path / "report.html").path.read_text())
    assert "A lake without a snapshot" in page.text
    assert page.images == page.charts == []
    assert page.tags.count("table") == page.tags.count("caption") == 1, "the paper's minutes alone: tables without rows are left out"
    assert [link for link in page.links if not link.startswith("#sql-")] == ["#time", "#failures", "#citing", "#sql"]
    assert "No stage failed." in page.text
    assert not (tmp_path / "none").exists()


@pytest.mark.whole
def test_more_scenes_than_are_pictured_are_counted(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flows.stats.queries.PICTURED_SCENES", 1)
    page = Page(write_report(lake, tmp_path / "report.html", look=SMALL, workers=1).path.read_text())
    assert "The first 1 of 2 scenes are pictured" in page.text
    assert not any("of demo/room_1 seen" in str(image["alt"]) for image in page.images)
    assert any("of demo/room_1, small" in str(image["alt"]) for image in page.images)


def test_a_snapshot_that_is_not_there_is_refused(lake: Lake, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no snapshot 99"):
        write_report(lake, tmp_path / "report.html", 99)
    assert not (tmp_path / "report.html").exists()


@pytest.mark.whole
def test_a_scene_that_cannot_be_pictured_costs_its_pictures_only(tmp_path: Path) -> None:
    lake = furnished_lake(tmp_path / "lake", scenes=2, objects=2)
    blob = lake.snapshot().arrow("scenes", "demo/room_0")["mesh_blob"][0].as_py()
    found = next((tmp_path / "lake").rglob(blob))
    found.chmod(0o644)
    found.write_bytes(b"no GLB")
    page = Page(write_report(lake, tmp_path / "report.html", look=SMALL, workers=1).path.read_text())
    assert "No pictures:" in page.text
    alts = [str(image["alt"]) for image in page.images]
    for scene, large, small in (("demo/room_0", 0, 0), ("demo/room_1", 6, 2)):
        assert sum(f"of {scene} seen" in alt for alt in alts) == large
        assert sum(f"of {scene}, small" in alt for alt in alts) == small
    assert page.text.count("No pictures:") == 2  # in the gallery and on the card


def test_a_scene_that_is_not_in_the_snapshot_is_refused(lake: Lake) -> None:
    with pytest.raises(InputError, match="is not in the snapshot"):
        picture_scene_of(lake, 1, "demo/nowhere", SMALL)


TIMED = [stage for stage in STAGES if stage not in ("annotation", "training", "evaluation", "robot", "comparison", "indexing", "rescans")]
"""Stages of which the lake of these tests has runs."""


def test_the_table_of_stage_times_is_in_the_order_of_the_data_path(lake: Lake) -> None:
    lines = stage_table(lake.snapshot()).splitlines()
    assert lines[0].split() == ["stage", "scenes", "runs", "total", "s", "median", "s", "p95", "s", "s", "per", "object"]
    assert [line.split()[0] for line in lines[1:]] == [*TIMED, "all"]
    # two scenes of 6 objects: 0.5 and 1.5 s of capture
    assert lines[1].split() == ["capture", "2", "2", "2.00", "1.00", "1.45", "0.167"]
    assert float(lines[-1].split()[1]) == pytest.approx(sum(float(line.split()[3]) for line in lines[1:-1]))


def test_loading_the_flow_loads_no_heavy_package() -> None:
    code = (
        "import sys, flows.stats; "
        "print(sorted({'prefect', 'matplotlib', 'open3d', 'trimesh', 'duckdb', 'deltalake', 'wordcloud', 'jinja2'} & sys.modules.keys()))"
    )
    root = REPOSITORY
    environment = {**os.environ, "PYTHONPATH": str(root)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=root, env=environment, check=True)
    assert done.stdout.strip() == "[]"


def metascenes(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(argument) for argument in arguments], catch_exceptions=True)


def test_the_command_says_what_it_would_write_and_writes_nothing(lake: Lake, tmp_path: Path) -> None:
    out = tmp_path / "deep" / "report.html"
    asked = ("stats", "--lake", lake.address, "--out", out, "--pictures", tmp_path / "p", "--dry-run")
    said = json.loads(metascenes(*asked, "--json").output)
    assert said == {
        "dry_run": True, "snapshot_id": lake.snapshot().snapshot_id, "scenes": 2, "report": str(out),
        "pictures_folder": str(tmp_path / "p"),
    }  # fmt: skip
    assert f"would write {out} on snapshot {said['snapshot_id']} with 2 scenes" in metascenes(*asked).output
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
@pytest.mark.whole
def test_a_report_on_a_release_names_it(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    for number, name in enumerate(("ours/a", "theirs/a")):
        row = sample(Scene, scene_id=name, dataset=name.partition("/")[0], mesh_blob=lake.blobs.put(b"none", "glb"))
        lake.stage_rows(stage_run(name, "capture", fingerprint(name)), {"scenes": [row], "shells": [], "instances": []})
        lake.commit()
        if not number:
            make_release(lake, "v1")
    text = {}
    for name, options in {"release": ["--release", "v1"], "newest": []}.items():
        out = tmp_path / f"{name}.html"
        assert metascenes("stats", "--lake", lake.address, "--out", out, *options).exit_code == 0
        text[name] = Page(out.read_text()).text
    assert "Snapshot 1 of " in text["release"]
    assert "released as v1. A release is kept for good" in " ".join(text["release"].split())
    assert 'metascenes sql --release v1 "SELECT' in text["release"]
    assert "ours" in text["release"]
    assert "theirs" not in text["release"]
    assert 'metascenes sql --snapshot 2 "SELECT' in text["newest"]
    assert "--release v1" not in text["newest"]
    for name in ("ours", "theirs"):
        assert f'<td>{name}</td><td class="n">1</td>' in (tmp_path / "newest.html").read_text(), "a scene of each dataset"


def test_the_command_refuses_an_unknown_release(lake: Lake, tmp_path: Path) -> None:
    refused = metascenes("stats", "--lake", lake.address, "--release", "v9", "--out", tmp_path / "r.html")
    assert isinstance(refused.exception, InputError)
    assert "v9" in str(refused.exception)
    both = metascenes("stats", "--lake", lake.address, "--release", "v9", "--snapshot", 1, "--stages")
    assert isinstance(both.exception, InputError)
    assert list(tmp_path.iterdir()) == []


def test_the_command_gives_stage_times_as_json_in_the_order_of_the_data_path(lake: Lake) -> None:
    rows = json.loads(metascenes("stats", "--lake", lake.address, "--stages", "--json").output)
    assert [row["stage"] for row in rows] == [
        stage for stage in STAGES if stage not in ("annotation", "training", "evaluation", "robot", "comparison", "indexing", "rescans")
    ]
    assert rows[0]["total_seconds"] == 2.0


@pytest.mark.whole
def test_tables_that_are_cut_say_of_how_many_rows(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("flows.stats.queries.ROW_LIMIT", 3)
    monkeypatch.setattr("flows.stats.queries.TIMELINE_RUNS", 5)
    answers = answers_of(lake.snapshot())
    checks = lake.snapshot().arrow("export_checks").num_rows
    with lake.snapshot().connect() as connection:
        counted = {view: connection.sql(f"SELECT count(*) FROM {view}").fetchall()[0][0] for view in ORDERS}
    assert checks > 3
    assert answers.totals == {view: count for view, count in counted.items() if count > 3}
    assert {view: answers.rows[view].num_rows for view in ORDERS} == {view: min(count, 4) for view, count in counted.items()}
    assert answers.rows["run_timeline.binned"]["runs"].to_pylist().count(0) < len(answers.rows["run_timeline.binned"])
    assert sum(answers.rows["run_timeline.binned"]["runs"].to_pylist()) == 18


def test_every_table_of_the_report_has_an_order_and_says_how_often_something_was_refused() -> None:
    assert set(ORDERS) == set(GRIDS) - {"stage_timing"}
    for view, column in (("unstable_objects", "problem"), ("stability", "refused"), ("density_check", "without_verdict")):
        assert column in {name for name, _, _ in GRIDS[view][1]}


def test_names_of_scenes_are_values_in_what_the_report_asks(lake: Lake) -> None:
    evil = "demo/x'); DROP VIEW scenes; --"
    with lake.snapshot().connect() as connection:
        asked = report_queries(ShownScenes((evil,), (evil,)))
        assert connection.sql(asked["scene_objects.pictured"]).fetchall() == []
        assert connection.sql(asked["instances.gallery"]).fetchall() == []
        assert connection.sql("SELECT count(*) FROM scenes").fetchall() == [(2,)]


@pytest.mark.whole
def test_a_report_is_written_whole_or_not_at_all(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "report.html"
    out.write_text("an older one")

    def torn(descriptor: int) -> None:
        os.truncate(descriptor, 100)
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", torn)
    with pytest.raises(OSError, match="No space"):
        write_report(lake, out, look=SMALL, workers=1)
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]
    assert out.read_text() == "an older one"
