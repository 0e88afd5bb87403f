"""Charts in a page: what is said of their marks, ids that no other chart has, and the same picture with and without tips."""

from __future__ import annotations

import html
import io
import re
import xml.etree.ElementTree as ET

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from tasks.micro_scenes import charts as micro_scenes
from tasks.stats import charts, counts, timelines, tips, words
from tasks.stats.axes import category_axis
from tasks.stats.page.inline import inlined
from tasks.stats.style import Picture, canvas, chart, in_style

SVG = "{http://www.w3.org/2000/svg}"


@in_style
def bars_of(texts: list[str], with_tips: bool = True) -> Picture:
    axes = canvas(2.0)
    axes.barh(np.arange(len(texts)), np.arange(1, len(texts) + 1))
    category_axis(axes, [str(at) for at in range(len(texts))])
    if with_tips:
        tips.lines(axes, texts)
    return chart(axes, "bars", "Bars", "Bars of <so> & so.")


def told(svg: str) -> list[str]:
    """What is said of the marks of an SVG, in the order in which they are drawn."""
    found = [group.find(f"{SVG}title") for group in ET.fromstring(svg).iter(f"{SVG}g") if group.get("class") == "tip"]
    return [title.text or "" for title in found if title is not None]


@settings(max_examples=15, deadline=None)
@given(
    texts=st.lists(st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=12), min_size=1, max_size=4)
)
def test_any_text_is_said_of_its_mark_as_it_is(texts: list[str]) -> None:
    drawn = bars_of(texts)
    assert told(drawn.svg) == texts
    part = inlined(drawn)
    assert [html.unescape(text) for text in re.findall(r"<title>([^<]*)</title>", part)] == texts


def test_tips_change_nothing_that_is_drawn() -> None:
    with_tips, without = (Image.open(io.BytesIO(bars_of(["a", "b"], tips).png)) for tips in (True, False))
    assert with_tips.size == without.size
    assert with_tips.tobytes() == without.tobytes()


def test_an_area_lies_over_its_line() -> None:
    """The middle of the second bar is in the second area, which reaches over the whole width of the axes."""
    root = ET.fromstring(bars_of(["first", "second"]).svg)
    areas = [group for group in root.iter(f"{SVG}g") if group.get("class") == "tip"]
    boxes = []
    for group in areas:
        (path,) = group.findall(f"{SVG}path")
        points = np.array(re.findall(r"(-?[\d.]+) (-?[\d.]+)", path.get("d", "")), dtype=float)
        boxes.append((points.min(axis=0), points.max(axis=0)))
    (low_a, high_a), (low_b, high_b) = boxes
    assert high_a[1] == pytest.approx(low_b[1])  # the first category is above, y points down
    assert (low_a[0], high_a[0]) == pytest.approx((low_b[0], high_b[0]))
    assert high_a[0] - low_a[0] > 200


def test_charts_in_one_page_share_no_id_and_refer_to_their_own() -> None:
    rows = pa.table({"scene_id": ["a", "b"], "agent": ["x", "x"], "navigable_share": [0.5, 0.25]})
    wins = pa.table({"slot": [1], "provider": ["p"], "filled": [4], "wins": [3]})
    drawn = [charts.navigable_bars(rows), charts.candidate_bars(wins), words.word_cloud({"chair": 2, "table": 1})]
    parts = [inlined(picture) for picture in drawn if picture is not None]
    assert len(parts) == 3
    ids = [name for part in parts for name in re.findall(r' id="([^"]*)"', part)]
    assert len(ids) == len(set(ids)) > 0
    for part in parts:
        own = set(re.findall(r' id="([^"]*)"', part))
        assert {name for pair in re.findall(r'url\(#([^)"]+)\)|href="#([^"]+)"', part) for name in pair if name} == own
        assert not re.search(r"<style|<metadata|<!--|prefers-color-scheme", part)
        root = ET.fromstring(
            part.replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" ', 1)
        )
        assert root.get("aria-label") in {picture.alt for picture in drawn if picture is not None}
        assert root.get("tabindex") == "0"


def test_marks_say_the_numbers_of_their_rows() -> None:
    floors = pa.table({"scene_id": ["a", "b"], "agent": ["x", "x"], "navigable_share": [0.5, 0.25]})
    wins = pa.table({"slot": [1, 2], "provider": ["p", "q"], "filled": [4, 2], "wins": [3, 0]})
    timing = pa.table({"stage": ["capture"], "median_seconds": [1.5], "p95_seconds": [2.25]})
    runs = pa.table({"scene_id": ["a", "a"], "stage": ["capture", "exports"], "seconds": [1.0, 3.0]})
    many = pa.table({"objects": [3, 4], "scenes": [20, 1]})
    rooms = pa.table({"category": ["chair", "chair", "lamp"], "room_type": ["office", "bedroom", "office"], "objects": [3, 1, 2]})
    small = pa.table({"category": ["mug"], "room_type": ["office"], "large_category": ["desk"], "objects": [2]})
    said = {
        counts.room_map(rooms): ["chair, office: 3, 75%", "chair, bedroom: 1, 25%", "lamp, office: 2, 100%"],
        micro_scenes.room_type_map(small): ["mug, office: 100%"],
        charts.navigable_bars(floors): ["b: 25% of the floor", "a: 50% of the floor"],
        charts.candidate_bars(wins): ["slot 1, p: 3 ranked first of 4 filled", "slot 2, q: 0 ranked first of 2 filled"],
        timelines.stage_bars(timing, ("capture",)): ["capture: median 1.50 s, 95th percentile 2.25 s"],
        timelines.scene_bars(runs, 1, ("capture", "exports")): ["a, capture: 1.0 s of 4.0 s", "a, exports: 3.0 s of 4.0 s"],
        counts.per_scene(many, pa.table({}), "objects", "objects"): ["3 objects: 20 scenes", "4 objects: 1 scene"],
    }
    for drawn, texts in said.items():
        assert drawn is not None
        assert sorted(told(drawn.svg)) == sorted(texts)
    cloud = words.word_cloud({"mug & <saucer>": 2, "lamp": 1})
    assert cloud is not None
    assert sorted(told(cloud.svg)) == ["lamp: 1 object", "mug & <saucer>: 2 objects"]
