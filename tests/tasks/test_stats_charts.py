"""Charts: what is drawn of which rows."""

from __future__ import annotations

import itertools
import math
import re
import xml.etree.ElementTree as ET
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.stats import axes, counts, grids, losses, timelines, volumes, words
from tasks.stats.style import GRID, INK, MUTED, PAPER, SERIES, Picture, Tone

STAGES = ("capture", "captions", "optimization")


def luminance(color: str) -> float:
    """Relative luminance of a color `#rrggbb` (WCAG 2.2)."""
    channels = [int(color[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(first: str, second: str) -> float:
    high, low = sorted((luminance(first), luminance(second)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("tone", [INK, MUTED, *SERIES], ids=lambda tone: tone.role)
def test_colors_can_be_read_on_light_and_on_dark_paper(tone: Tone) -> None:
    assert contrast(tone.light, PAPER.light) >= 4.5
    assert contrast(tone.dark, PAPER.dark) >= 4.5


def test_roles_and_colors_are_distinct() -> None:
    tones = (INK, MUTED, GRID, PAPER, *SERIES)
    for field in ("role", "light", "dark"):
        assert len({getattr(tone, field) for tone in tones}) == len(tones)


def many_boxes(count: int) -> tuple[pa.Table, pa.Table]:
    """Rows of `volume_by_category` and `volume_outliers`, most frequent first, the smallest of volume zero."""
    boxes = [
        {
            "frequency_rank": rank, "category": f"category {rank}", "objects": 100 - rank,
            "whisker_low_m3": 0.0 if rank == 1 else 0.001 * rank, "q1_m3": 0.002 * rank, "median_m3": 0.003 * rank,
            "q3_m3": 0.004 * rank, "whisker_high_m3": 0.006 * rank,
        }
        for rank in range(1, count + 1)
    ]  # fmt: skip
    outliers = [{"category": f"category {rank}", "volume_m3": 2.0 * rank} for rank in range(1, count + 1)]
    return pa.Table.from_pylist(boxes), pa.Table.from_pylist(outliers)


def texts(svg: str) -> list[str]:
    """Text elements of an SVG that is well-formed."""
    root = ET.fromstring(svg)
    return ["".join(node.itertext()) for node in root.iter("{http://www.w3.org/2000/svg}text")]


def test_the_box_plot_shows_the_fifty_most_frequent_categories_on_a_logarithmic_axis() -> None:
    drawn = volumes.volume_boxes(*many_boxes(53))
    assert drawn is not None
    labels = texts(drawn.svg)
    assert [label for label in labels if label.startswith("category")] == [f"category {n} ({100 - n})" for n in range(1, 51)]
    ticks = [float(label) for label in labels if re.fullmatch(r"[0-9.]+", label)]
    steps = {round(math.log10(b / a), 6) for a, b in itertools.pairwise(ticks)}
    assert len(ticks) >= 3
    assert steps == {1.0}


def test_a_narrow_volume_axis_still_has_ticks() -> None:
    boxes = pa.Table.from_pylist(
        [
            {
                "frequency_rank": 1, "category": "mug", "objects": 3, "whisker_low_m3": 0.24, "q1_m3": 0.3, "median_m3": 0.4,
                "q3_m3": 0.5, "whisker_high_m3": 0.9,
            }
        ]
    )  # fmt: skip
    drawn = volumes.volume_boxes(boxes, pa.table({"category": pa.array([], pa.string()), "volume_m3": pa.array([], pa.float64())}))
    assert drawn is not None
    assert sum(bool(re.fullmatch(r"[0-9.]+", label)) for label in texts(drawn.svg)) >= 2


@given(counts=st.lists(st.integers(0, 500), min_size=counts.SCENE_LIMIT + 1, max_size=60))
@settings(max_examples=15, deadline=None)
def test_the_histogram_counts_every_scene_once(counts: list[int]) -> None:
    edges = axes.integer_bins(np.array(counts))
    histogram, _ = np.histogram(counts, edges)
    assert histogram.sum() == len(counts)
    assert len(edges) <= 22
    assert np.allclose(edges % 1, 0.5)  # no whole number lies on an edge


def test_few_scenes_get_a_bar_each_and_many_a_histogram() -> None:
    def labels(count: int) -> list[str]:
        scenes = pa.table({"scene_id": [f"demo/{n:03d}" for n in range(count)], "objects": list(range(count))})
        histogram = pa.table({"objects": list(range(count)), "scenes": [1] * count})
        drawn = counts.per_scene(histogram, scenes, "objects", "objects")
        assert drawn is not None
        return [label for label in texts(drawn.svg) if label.startswith("demo/")]

    assert len(labels(counts.SCENE_LIMIT)) == counts.SCENE_LIMIT
    assert labels(counts.SCENE_LIMIT + 1) == []


@given(counted=st.dictionaries(st.integers(0, 90), st.integers(1, 40), min_size=1, max_size=30))
@settings(deadline=None)
def test_the_median_of_counted_values_is_that_of_the_values(counted: dict[int, int]) -> None:
    values, times = np.array(list(counted)), np.array(list(counted.values()))
    assert counts.weighted_median(values, times) == float(np.median(np.repeat(values, times)))


def test_a_histogram_of_counted_values_says_how_many_scenes_there_are() -> None:
    histogram = pa.table({"objects": [3, 7, 20], "scenes": [30_000, 60_000, 10_000]})
    drawn = counts.per_scene(histogram, pa.table({"scene_id": [], "objects": []}), "objects", "objects")
    assert drawn is not None
    assert drawn.alt == "Objects per scene: 100000 scenes, 3 to 20 objects, median 7."


def test_the_bars_of_categories_say_of_how_many_they_are() -> None:
    rows = [{"category": f"object {n:02d}", "objects": 9000 - n, "scenes": 1000 - n} for n in range(60)]
    drawn = counts.category_bars(pa.Table.from_pylist(rows), 314)
    assert drawn is not None
    labels = texts(drawn.svg)
    assert [label for label in labels if label.startswith("object ")] == [f"object {n:02d} (9.0k)" for n in range(counts.CATEGORY_LIMIT)]
    assert any("40 most frequent of 314 categories" in label for label in labels)


CELLS = st.dictionaries(
    st.tuples(st.sampled_from([f"kind {n}" for n in range(12)]), st.sampled_from([f"room {n:02d}" for n in range(14)])),
    st.integers(1, 900),
    min_size=1,
)


@pytest.mark.whole
@given(cells=CELLS)
@settings(max_examples=20, deadline=None)
def test_the_heat_map_shows_every_object_once(cells: dict[tuple[str, str], int]) -> None:
    drawn = counts.room_map(pa.Table.from_pylist([{"category": c, "room_type": r, "objects": n} for (c, r), n in cells.items()]))
    assert drawn is not None
    labels = texts(drawn.svg)
    kinds, rooms = {c for c, _ in cells}, {r for _, r in cells}
    shown = [label for label in labels if label.startswith("room ") or label == "other types"]
    assert {label for label in labels if label.startswith("kind ")} == kinds
    assert len(shown) == min(len(rooms), counts.ROOM_TYPE_LIMIT)
    assert ("other types" in shown) == (len(rooms) > counts.ROOM_TYPE_LIMIT)
    numbers = [int(label) for label in labels if label.isdigit()]
    if max(cells.values()) * len(rooms) < 950:  # larger sums are written short
        assert sum(numbers) == sum(cells.values())


def test_counts_are_written_short() -> None:
    written = [counts.thousands(value) for value in (0, 999, 1000, 9949, 38_400, 999_999, 4_000_000, 40_000_000)]
    assert written == ["0", "999", "1.0k", "9.9k", "38k", "1000k", "4.0M", "40M"]


def release(name: str, number: int) -> dict[str, Any]:
    return {"name": name, **{column: 10 * number + place for place, column in enumerate(counts.GROWING)}}


@pytest.mark.whole
def test_growth_shows_the_newest_releases_of_many() -> None:
    def names(count: int) -> list[str]:
        drawn = counts.growth(pa.Table.from_pylist([release(f"v{n:02d}", n) for n in range(count)]))
        assert drawn is not None
        assert drawn.alt.startswith("Growth over releases")
        return [label for label in texts(drawn.svg) if re.fullmatch(r"v\d\d", label)]

    assert names(1) == ["v00"] * len(counts.GROWING)
    assert names(3) == ["v00", "v01", "v02"] * len(counts.GROWING)
    assert names(40) == [f"v{40 - counts.RELEASE_LIMIT:02d}", "v39"] * len(counts.GROWING)  # the first and the last that are drawn
    assert counts.growth(pa.table({"name": []})) is None


def bar(host: str, stage: str, begins: float, ends: float, share: float = 1.0, runs: int = 1) -> dict[str, Any]:
    return {"host": host, "stage": stage, "begins": begins, "ends": ends, "share": share, "runs": runs}


def gantt(rows: list[dict[str, Any]], pauses: list[dict[str, float]] | None = None, workers: int | None = None) -> Picture:
    schema = pa.schema([("at", pa.float64()), ("seconds", pa.float64())])
    drawn = timelines.run_gantt(
        pa.Table.from_pylist(rows), pa.Table.from_pylist(pauses or [], schema), workers or len({row["host"] for row in rows}), STAGES
    )
    assert drawn is not None
    return drawn


def test_the_timeline_names_no_machine_and_numbers_workers_by_their_first_run() -> None:
    drawn = gantt([bar("b:9", "capture", 0, 4), bar("a:7", "capture", 1, 3), bar("b:2", "captions", 4, 9), bar("b:9", "mine", 5, 6)])
    labels = texts(drawn.svg)
    assert [label for label in labels if "worker" in label] == ["host 1, worker 1", "host 1, worker 2", "host 2, worker 1"]
    assert {"capture", "captions", "mine"} <= set(labels)
    assert "optimization" not in labels
    assert "a:7" not in drawn.svg
    assert drawn.alt == "Timeline of 3 workers over 9 s, colored by stage, 4 runs."


def test_the_timeline_of_one_machine_numbers_its_workers() -> None:
    drawn = gantt([bar("vm:1", "capture", 0, 4), bar("vm:2", "captions", 1, 3)], [{"at": 3.0, "seconds": 90_000.0}])
    labels = texts(drawn.svg)
    assert [label for label in labels if "worker" in label] == ["worker 1", "worker 2"]
    assert "25 h later" in labels
    assert drawn.alt.endswith("2 runs; 1 pause left out.")


def test_a_timeline_of_more_workers_than_have_place_shows_the_busiest() -> None:
    rows = [bar(f"vm:{n}", "capture", n, n + 1 + 0.01 * n) for n in range(timelines.LANE_LIMIT + 9)]
    labels = texts(gantt(rows).svg)
    assert sum(label.startswith("worker") for label in labels) == timelines.LANE_LIMIT
    assert f"the {timelines.LANE_LIMIT} busiest of {len(rows)} workers" in labels


def test_a_binned_timeline_says_what_its_heights_are() -> None:
    rows = [
        bar("vm:1", stage, 10.0 * n, 10.0 * n + 10, share, 5) for n in range(20) for stage, share in (("capture", 0.03), ("captions", 0.05))
    ]
    drawn = gantt(rows)
    labels = texts(drawn.svg)
    assert "height: share at work, a full lane is 10%" in labels
    assert "20 bins of 10 s" in labels
    assert "200 runs put together in bins of time" in drawn.alt


@given(length=st.floats(0.01, 1e9))
def test_a_time_axis_has_a_few_round_ticks(length: float) -> None:
    assert 3.9 <= length / timelines._step(length) <= 10.1


def test_the_word_cloud_holds_every_category_larger_when_more_frequent() -> None:
    counts = {"chair": 50, "mug & <saucer>": 20, "lamp": 5, " ": 3, "gone": 0}
    cloud = words.word_cloud(counts)
    assert cloud is not None
    root = ET.fromstring(cloud.svg)
    sizes = {"".join(node.itertext()): int(node.attrib["font-size"]) for node in root.iter("{http://www.w3.org/2000/svg}text")}
    assert sizes.keys() == {"chair", "mug & <saucer>", "lamp"}
    assert sizes["chair"] > sizes["mug & <saucer>"] > sizes["lamp"]
    assert cloud == words.word_cloud(dict(reversed(counts.items())))
    assert words.word_cloud({}) is None


@pytest.mark.parametrize(
    "counts", [(200, 100, 50, 1), tuple(range(9, 0, -1)), (1000, 999, 2, 1, 1), tuple(range(100, 60, -1)), (500, *range(32, 2, -1))]
)
def test_sizes_follow_the_counts_alone(counts: tuple[int, ...]) -> None:
    """Supplementary, Fig. A4: the font size represents the total count, not the rank."""
    cloud = words.word_cloud({f"kind {n}": count for n, count in enumerate(counts)})
    assert cloud is not None
    root = ET.fromstring(cloud.svg)
    sizes = {"".join(node.itertext()): int(node.attrib["font-size"]) for node in root.iter("{http://www.w3.org/2000/svg}text")}
    largest = sizes["kind 0"]
    for n, count in enumerate(counts):
        expected = words.MIN_LETTERS_PX + (largest - words.MIN_LETTERS_PX) * count / counts[0]
        assert sizes[f"kind {n}"] == pytest.approx(expected, abs=2)


def test_equally_frequent_categories_are_equally_large() -> None:
    cloud = words.word_cloud({f"category {n}": 3 if n < 20 else 1 for n in range(40)})
    assert cloud is not None
    root = ET.fromstring(cloud.svg)
    sizes = {"".join(node.itertext()): node.attrib["font-size"] for node in root.iter("{http://www.w3.org/2000/svg}text")}
    assert len(sizes) == 40
    assert len({sizes[f"category {n}"] for n in range(20)}) == len({sizes[f"category {n}"] for n in range(20, 40)}) == 1


def test_the_loss_curve_of_many_steps_is_small_and_says_start_and_end() -> None:
    rng = np.random.default_rng(0)
    loss = np.concatenate([[0.5], rng.random(9999) * 0.4 + 0.1, [0.0]])
    steps = pa.table({"step": range(len(loss)), "loss": loss, "smallest_loss": np.minimum.accumulate(loss)})
    drawn = losses.loss_curve(steps, "released", "demo/a")
    assert drawn is not None
    assert drawn == losses.loss_curve(steps.take(rng.permutation(len(loss))), "released", "demo/a")
    assert len(drawn.svg) < 40_000
    assert "500 l at the start, 0 l in the end" in drawn.alt
    assert "0" in texts(drawn.svg)  # the axis reaches zero
    assert any("[l]" in text for text in texts(drawn.svg))
    in_depth = losses.loss_curve(steps.slice(0, 3), "default", "demo/a")
    assert in_depth is not None
    assert any("[mm]" in text for text in texts(in_depth.svg))
    assert losses.loss_curve(steps.slice(0, 0), "released", "demo/a") is None


def test_a_share_says_all_or_none_only_when_it_is() -> None:
    assert [grids.as_share(share) for share in (1.0, 0.9999, 0.985, 1 / 6, 0.0001, 0.0)] == [
        "100%",
        "99.9%",
        "98.5%",
        "16.7%",
        "0.1%",
        "0%",
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("/home/me/scans/scene0001_00/scene0001_00.txt: axisAlignment: bad", "scene0001_00.txt: axisAlignment: bad"),
        ("cannot read '/tmp/x y/lake/a.glb'", "cannot read 'a.glb'"),
        ("file:///srv/data/a.ply", "a.ply"),
        (r"C:\Users\me\scan\a.txt: gone", "a.txt: gone"),
        ("scannet/scene0001_00: 3/4 frames, 0.5 kg/m3, and/or", "scannet/scene0001_00: 3/4 frames, 0.5 kg/m3, and/or"),
        ("https://example.org/a/b.glb", "https://example.org/a/b.glb"),
    ],
)
def test_reports_name_files_without_their_folders(text: str, expected: str) -> None:
    assert grids.portable(text) == expected


@given(value=st.floats(1e-5, 1e7))
@settings(deadline=None)
def test_numbers_keep_three_digits(value: float) -> None:
    text = grids.as_number(value).replace("\u202f", "")
    assert "e" not in text
    assert float(text) == pytest.approx(value, rel=0.006 if value >= 1e-4 else 0.06)
