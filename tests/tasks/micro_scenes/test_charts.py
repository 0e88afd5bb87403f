"""Charts of micro-scenes: what is drawn of which rows."""

from __future__ import annotations

import io
import math
import random
from collections import Counter, defaultdict
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from PIL import Image

from tasks.micro_scenes import charts as micro_scenes
from tests.tasks.test_stats_charts import texts

KINDS = [f"kind_{n}" for n in range(9)]
LARGE = [f"large_{n:02d}" for n in range(14)]
TYPES = ["bedroom", "kitchen", "office", "unknown"]


@pytest.mark.parametrize("count", [6, 120])
def test_the_map_of_pairs_shows_every_object_once(count: int) -> None:
    chance = random.Random(count)
    pairs = {(chance.choice(LARGE), chance.choice(KINDS)): chance.randint(1, 60) for _ in range(count)}
    drawn = micro_scenes.pair_map(pa.Table.from_pylist([{"large_category": a, "category": b, "objects": n} for (a, b), n in pairs.items()]))
    assert drawn is not None
    labels = texts(drawn.svg)
    larges, smalls = {a for a, _ in pairs}, {b for _, b in pairs}
    shown = [label for label in labels if label.startswith("large ")]
    assert {label for label in labels if label.startswith("kind ")} == {name.replace("_", " ") for name in smalls}
    assert len(shown) == (len(larges) if len(larges) <= micro_scenes.LARGE_LIMIT else micro_scenes.LARGE_LIMIT - 1)
    assert ("others" in labels) == (len(larges) > micro_scenes.LARGE_LIMIT)
    assert sum(int(label) for label in labels if label.isdigit()) == sum(pairs.values())  # none is as large as to be written short
    assert max(pairs.values()) == int(drawn.alt.rstrip(".").rpartition(" ")[2])


@pytest.mark.parametrize("count", [5, 30])
def test_the_map_of_room_types_has_a_panel_for_what_stands_in_two_kinds(count: int) -> None:
    chance = random.Random(count)
    draw = chance.choice
    cells = {(draw(TYPES), draw(LARGE[:3]), draw(KINDS)): chance.randint(1, 50) ** 2 for _ in range(count)}
    cells["unknown", LARGE[3], KINDS[0]] = cells["office", LARGE[3], KINDS[1]] = 9999  # in no two kinds that somebody knows
    rows = [{"room_type": t, "large_category": a, "category": b, "objects": n} for (t, a, b), n in cells.items()]
    drawn = micro_scenes.room_type_map(pa.Table.from_pylist(rows))
    assert drawn is not None
    labels = texts(drawn.svg)
    known: dict[str, set[str]] = defaultdict(set)
    objects: Counter[str] = Counter()
    for (room_type, large, _), count in cells.items():
        objects[large] += count
        known[large] |= {room_type} - {"unknown"}
    compared = [name for name in sorted(objects, key=lambda name: (-objects[name], name)) if len(known[name]) > 1]
    panels = ["all large objects", *(name.replace("_", " ") for name in compared[: micro_scenes.PANEL_LIMIT - 1])]
    assert [label for label in labels if label in panels] == panels
    assert not {name.replace("_", " ") for name in set(LARGE) - {*compared}} & set(labels)
    shares = [label for label in labels if label.endswith("%")]
    assert Counter(shares) == Counter(text for panel in panels for text in percentages(cells, panel.replace(" ", "_")))


def percentages(cells: dict[tuple[str, str, str], int], large: str) -> list[str]:
    """Shares of a panel as they are written."""
    of = {key: count for key, count in cells.items() if large in ("all_large_objects", key[1])}
    whole: Counter[str] = Counter()
    part: Counter[tuple[str, str]] = Counter()
    for (room_type, _, small), count in of.items():
        whole[room_type] += count
        part[room_type, small] += count
    shares = [count / whole[room_type] for (room_type, _), count in part.items()]
    return ["<1%" if share < 0.005 else f"{share:.0%}" for share in shares]


def layout_row(
    scene: str, instance: str | None, category: str | None, center: Any = None, size: Any = None, yaw: float = 0.0
) -> dict[str, Any]:
    return {
        "scene_id": scene, "instance_id": instance, "category": category, "large_category": "desk", "room_type": "office",
        "large_box_size": [0.7, 1.4, 0.75], "box_center": center, "box_size": size, "yaw_degrees": yaw,
    }  # fmt: skip


def test_layouts_are_seen_from_above_with_the_front_of_the_large_object_up() -> None:
    """A mug at the left end (+Y) and front (+X) of the desk, beside a scene in which nothing was drawn."""
    mug = layout_row("drawn/0", "0001", "mug", [0.2, 0.5, 0.8], [0.1, 0.2, 0.1])
    drawn = micro_scenes.drawn_layouts(pa.Table.from_pylist([mug, layout_row("drawn/1", None, None)]))
    assert drawn is not None
    assert "2 on a desk, 0.70 x 1.40 x 0.75 m, office, seen from above, of 1, 0 objects." in drawn.alt
    assert {"mug", "desk, 0.70 x 1.40 x 0.75 m, office"} <= set(texts(drawn.svg))
    pixels = np.asarray(Image.open(io.BytesIO(drawn.png)).convert("RGB"), dtype=np.int64)
    colored = np.ptp(pixels, axis=2) > 60
    colored[int(0.8 * len(pixels)) :] = False  # the legend
    rows, columns = np.nonzero(colored)
    gray = np.nonzero(np.all(np.abs(pixels[:, : pixels.shape[1] // 2] - pixels[len(pixels) // 2, 300]) < 4, axis=2))
    (top, bottom), (left, right) = (np.quantile(part, [0.001, 0.999]) for part in gray)
    scale = (right - left) / 1.4
    assert (left + right) / 2 - columns.mean() == pytest.approx(0.5 * scale, abs=8)
    assert (top + bottom) / 2 - rows.mean() == pytest.approx(0.2 * scale, abs=8)
    assert np.ptp(columns) == pytest.approx(0.2 * scale, abs=8)


def test_no_more_layouts_are_shown_than_there_is_place_for() -> None:
    rows = [layout_row(f"drawn/{n}", "0001", "mug", [0.0, 0.0, 0.8], [0.1, 0.1, 0.1], math.degrees(n)) for n in range(8)]
    drawn = micro_scenes.drawn_layouts(pa.Table.from_pylist(rows))
    assert drawn is not None
    assert ": 6 on a desk" in drawn.alt


def test_nothing_to_draw_gives_no_chart() -> None:
    assert micro_scenes.pair_map(pa.table({"large_category": [], "category": [], "objects": []})) is None
    assert micro_scenes.room_type_map(pa.table({"room_type": [], "large_category": [], "category": [], "objects": []})) is None
    assert micro_scenes.drawn_layouts(pa.table({"scene_id": [], "instance_id": []})) is None
