"""What the report asks of a snapshot: named SQL, each no more than a picture or a table shows.

A lake may hold 100,000 scenes and millions of objects; whatever the report does with rows of one kind is done in SQL, and
what it lists is cut there.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import pyarrow as pa

from flows.outputs.drives import shown_drives
from flows.outputs.films import shown_walks
from tasks.micro_scenes import charts as micro_scenes
from tasks.stats import counts, timelines, volumes, words
from tasks.stats.columns import GRIDS
from tasks.stats.grids import OBJECT_LIMIT, ROW_LIMIT
from warehouse.questions.quoting import listed

if TYPE_CHECKING:
    import duckdb

    from warehouse.tables.snapshot import Reader

PICTURED_SCENES = 10
"""Scenes with pictures: about 0.35 MB each, so that the report can still be mailed."""

GALLERY_SCENES = 24
"""Scenes in the gallery, drawn from all: two thumbnails of 8 kB each."""

GALLERY_OBJECTS = 12
"""Objects in the gallery of candidates, one per category: eleven thumbnails of 3 kB each."""

FILMED_RUNS = 6
"""Runs of policies of which one success and one failure is shown: 60 kB each; of each policy one first."""

DRIVEN_RUNS = 3
"""Policies' runs and setups of carts of which one that arrived and one that did not is shown: 80 kB each."""

TIMELINE_RUNS = 600
"""Runs with a bar of their own; more are put together in bins of time."""

TIMELINE_BINS = 120
"""Bins of time: about as many as a phone's width can tell apart."""

PAUSE_SECONDS = 300.0
"""When no worker does anything for longer, the timeline leaves it out: a lake may grow for years, an hour a day."""


@dataclasses.dataclass(frozen=True)
class ShownScenes:
    """The scenes that a report shows. listed: the first rows of its table. gallery: a sample of all, by hash of the name."""

    listed: tuple[str, ...] = ()
    gallery: tuple[str, ...] = ()

    @property
    def pictured(self) -> tuple[str, ...]:
        """Those with a card and pictures."""
        return self.listed[:PICTURED_SCENES]


@dataclasses.dataclass(frozen=True)
class Answers:
    """Rows by name of the query, and how many rows a view has of which only the first were asked for."""

    rows: Mapping[str, pa.Table]
    totals: Mapping[str, int]
    scenes: ShownScenes


def shown_scenes(connection: duckdb.DuckDBPyConnection) -> ShownScenes:
    """The scenes that a report on this snapshot shows."""
    listed = connection.sql(f"SELECT scene_id FROM scenes ORDER BY scene_id LIMIT {ROW_LIMIT}").fetchall()
    gallery = connection.sql(f"SELECT scene_id FROM scenes ORDER BY md5(scene_id), scene_id LIMIT {GALLERY_SCENES}").fetchall()
    return ShownScenes(tuple(name for (name,) in listed), tuple(sorted(name for (name,) in gallery)))


def answers_of(reader: Reader) -> Answers:
    """All that the report says of a snapshot."""
    with reader.connect() as connection:
        scenes = shown_scenes(connection)
        asked = report_queries(scenes)
        cut = when_cut()
        rows = {name: connection.sql(sql).to_arrow_table() for name, sql in asked.items() if name not in cut}
        # what is asked only of large lakes: how many rows a table has that is cut, and the timeline in bins
        for name, (first, limit) in cut.items():
            if rows[first].num_rows > limit:
                rows[name] = connection.sql(asked[name]).to_arrow_table()
    totals = {view: rows[f"{view}.count"]["rows"][0].as_py() for view in _ORDERS if f"{view}.count" in rows}
    return Answers(rows, totals, scenes)


def report_queries(scenes: ShownScenes) -> dict[str, str]:
    """The SQL of every picture and table, by name: the view that is asked, and after a dot what is asked of it."""
    listed, pictured, gallery = _between(scenes.listed), _between(scenes.pictured), _names(scenes.gallery)
    queries = {"headline": "SELECT * FROM headline"}
    for view, (_, columns) in GRIDS.items():
        shown = ", ".join([*(name for name, _, _ in columns), *_ALSO_DRAWN.get(view, ())])
        limit = f" LIMIT {ROW_LIMIT + 1}" if view in _ORDERS else ""
        queries[view] = f"SELECT {shown} FROM {view} ORDER BY {_ORDERS.get(view, shown)}{limit}"
        if view in _ORDERS:
            queries[f"{view}.count"] = f"SELECT count(*) AS rows FROM {view}"
    for view, facts in _OF_LISTED.items():
        queries[f"{view}.listed"] = f"SELECT scene_id, {facts} FROM {view} WHERE {listed} ORDER BY ALL"
    for view, facts in _OF_PICTURED.items():
        queries[f"{view}.pictured"] = (
            f"SELECT {facts} FROM {view} WHERE {pictured} "
            f"QUALIFY row_number() OVER (PARTITION BY scene_id ORDER BY {_FIRST[view]}) <= {OBJECT_LIMIT} ORDER BY ALL"
        )
    for column, view in (("objects", "objects_per_scene"), ("categories", "categories_per_scene")):
        queries[f"{view}.histogram"] = f"SELECT {column}, count(*) AS scenes FROM {view} GROUP BY {column} ORDER BY {column}"
    most = max(words.WORD_LIMIT, counts.CATEGORY_LIMIT)
    queries["category_counts"] = f"SELECT category, objects, scenes FROM category_counts ORDER BY objects DESC, category LIMIT {most}"
    queries["category_by_room_type"] = (
        "SELECT category, room_type, objects FROM category_by_room_type WHERE category IN "
        f"(SELECT category FROM category_counts ORDER BY objects DESC, category LIMIT {counts.CATEGORY_LIMIT}) ORDER BY ALL"
    )
    queries["micro_scene_pairs"] = "SELECT large_category, category, objects FROM micro_scene_pairs ORDER BY ALL"
    queries["micro_scene_by_room_type"] = "SELECT room_type, large_category, category, objects FROM micro_scene_by_room_type ORDER BY ALL"
    queries["synthesis_layouts"] = _drawn_layouts()
    for prefix, column in (("", "box_volume_m3"), ("solid_", "solid_volume_m3")):
        queries |= _volumes(f"{prefix}volume_by_category", f"{prefix}volume_outliers", column)
    runs = (  # one run of each policy before a second one of any
        "(SELECT policy, run_name FROM (SELECT DISTINCT policy, run_name FROM trajectories) "
        f"ORDER BY row_number() OVER (PARTITION BY policy ORDER BY run_name), policy LIMIT {FILMED_RUNS})"
    )
    queries["trajectory_metrics.shown"] = shown_walks(1, f"(policy, run_name) IN {runs}")
    drives = (
        "(SELECT policy, run_name, setup, body FROM (SELECT DISTINCT policy, run_name, setup, body FROM robot_runs) "
        f"ORDER BY row_number() OVER (PARTITION BY policy ORDER BY run_name, setup, body), policy LIMIT {DRIVEN_RUNS})"
    )
    queries["robot_runs.shown"] = shown_drives(1, f"(policy, run_name, setup, body) IN {drives}")
    queries["candidate_wins"] = "SELECT slot, provider, filled, wins FROM candidate_wins ORDER BY slot, provider"
    queries["collision_loss.worst"] = (
        "SELECT scene_id, deep_pairs_before, deep_pairs_after FROM collision_loss "
        f"ORDER BY deep_pairs_before DESC, scene_id LIMIT {counts.SCENE_LIMIT}"
    )
    queries["scene_timing.slowest"] = (
        "SELECT scene_id, stage, seconds FROM current_runs WHERE scene_id IN "
        f"(SELECT scene_id FROM scene_timing ORDER BY total_seconds DESC, scene_id LIMIT {counts.SCENE_LIMIT}) ORDER BY ALL"
    )
    queries["dataset_growth"] = "SELECT * FROM (SELECT * FROM dataset_growth ORDER BY snapshot_id DESC, created_at DESC, name DESC " + (
        f"LIMIT {counts.RELEASE_LIMIT}) ORDER BY snapshot_id, created_at, name"
    )
    queries |= _timeline()
    queries["instances.gallery"] = _gallery(gallery)
    return queries


def when_cut() -> dict[str, tuple[str, int]]:
    """Queries that are asked only when another one gave more rows than that."""
    return {**{f"{view}.count": (view, ROW_LIMIT) for view in _ORDERS}, "run_timeline.binned": ("run_timeline", TIMELINE_RUNS)}


def _names(names: Sequence[str]) -> str:
    """Names as a list of SQL literals; one that no scene has where there is none."""
    return "(" + listed(names or ("",)) + ")"


def _between(names: Sequence[str]) -> str:
    """The condition of scenes that follow each other. DuckDB hands bounds on to all tables of a join, but no list of names."""
    first, last = _names(names[:1])[1:-1], _names(names[-1:])[1:-1]
    return f"scene_id BETWEEN {first} AND {last} AND scene_id IN {_names(names)}"


def _volumes(view: str, outliers: str, column: str) -> dict[str, str]:
    """Boxes of the most frequent categories, and the places of their outliers on a logarithmic axis, each once."""
    boxes = f"SELECT * FROM {view} WHERE frequency_rank <= {volumes.CATEGORY_LIMIT} ORDER BY frequency_rank"
    steps = volumes.OUTLIER_STEPS
    place = f"exp(round(ln(greatest({column}, {volumes.SMALLEST_VOLUME_M3})) * {steps}) / {steps})"
    # Of all categories: to ask which are the most frequent would cost more than the few places of the others.
    strays = f"SELECT category, {place} AS volume_m3, count(*) AS objects FROM {outliers} GROUP BY ALL ORDER BY ALL"
    return {view: boxes, outliers: strays}


def _drawn_layouts() -> str:
    """Drawn objects of the first scenes on the large object that most scenes were drawn on, where there are two of them."""
    alike = "model_id, large_category, room_type, large_box_size"
    return f"""WITH most AS (
    SELECT DISTINCT {alike}, alike_scenes FROM synthesis_layouts WHERE alike_scenes > 1
    ORDER BY alike_scenes DESC, large_category, room_type, large_box_size, model_id LIMIT 1
)
SELECT large_category, room_type, large_box_size, scene_id, instance_id, category, box_center, box_size, yaw_degrees
FROM synthesis_layouts JOIN most USING ({alike})
QUALIFY dense_rank() OVER (ORDER BY scene_id) <= {micro_scenes.LAYOUT_LIMIT} ORDER BY scene_id, instance_id"""


def _timeline() -> dict[str, str]:
    """The runs over time without the pauses: each of them while they are few, else in bins of the busiest workers."""
    at_work = f"""WITH runs AS (
    SELECT scene_id, stage, host, epoch(started_at) AS starts, epoch(ended_at) AS ends FROM run_timeline
), marked AS (
    SELECT *, starts - max(ends) OVER (ORDER BY starts, ends, scene_id, stage ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING) AS idle
    FROM runs
), placed AS (
    SELECT *, starts - min(starts) OVER () - coalesce(
        sum(idle) FILTER (idle > {PAUSE_SECONDS}) OVER (ORDER BY starts, ends, scene_id, stage ROWS UNBOUNDED PRECEDING), 0) AS begins
    FROM marked
)
"""
    binned = f"""{at_work}, lanes AS (
    SELECT host FROM runs GROUP BY host ORDER BY sum(ends - starts) DESC, host LIMIT {timelines.BINNED_LANES}
), measured AS (
    SELECT host, stage, begins, begins + ends - starts AS stops FROM placed WHERE host IN (SELECT host FROM lanes)
), ruler AS (
    SELECT greatest(max(begins + ends - starts), 1e-6) / {TIMELINE_BINS} AS width FROM placed
), reached AS (
    SELECT *, least(floor(begins / width), {TIMELINE_BINS - 1})::BIGINT AS first,
        least(floor(stops / width), {TIMELINE_BINS - 1})::BIGINT AS last
    FROM measured, ruler
), cut AS (
    SELECT *, unnest(range(first, last + 1)) AS bin FROM reached
)
SELECT host, stage, bin * any_value(width) AS begins, (bin + 1) * any_value(width) AS ends,
    sum(greatest(least(stops, (bin + 1) * width) - greatest(begins, bin * width), 0)) / any_value(width) AS share,
    count(*) FILTER (first = bin) AS runs
FROM cut GROUP BY host, bin, stage ORDER BY ALL"""
    return {
        "run_timeline": f"{at_work}SELECT host, stage, begins, begins + ends - starts AS ends, 1::DOUBLE AS share, 1::BIGINT AS runs "
        f"FROM placed ORDER BY begins, host, stage LIMIT {TIMELINE_RUNS + 1}",
        "run_timeline.binned": binned,
        "run_timeline.pauses": f"{at_work}SELECT begins AS at, idle AS seconds FROM placed WHERE idle > {PAUSE_SECONDS} "
        "ORDER BY idle DESC, begins LIMIT 50",
        "run_timeline.workers": "SELECT count(DISTINCT host) AS workers FROM run_timeline",
    }


def _gallery(scenes: str) -> str:
    """Candidates of one object per category, the categories that are most frequent among the scenes."""
    return f"""WITH named AS (
    SELECT scene_id, instance_id, category, view_blob, mesh_blob, count(*) OVER (PARTITION BY category) AS alike
    FROM instances
    WHERE scene_id IN {scenes} AND NOT is_structure
        AND (scene_id, instance_id) IN (SELECT (scene_id, instance_id) FROM candidates WHERE scene_id IN {scenes})
    QUALIFY row_number() OVER (PARTITION BY category ORDER BY md5(scene_id || '/' || instance_id)) = 1
    ORDER BY alike DESC, category LIMIT {GALLERY_OBJECTS}
), chosen AS (
    SELECT scene_id, instance_id, slot, rank, score, scale, pose FROM selections WHERE scene_id IN {scenes}
), filled AS (
    SELECT named.*, slot, candidates.provider, is_fallback, outcome, reason, candidates.asset_id, rank, score, scale, pose
    FROM named JOIN candidates USING (scene_id, instance_id) LEFT JOIN chosen USING (scene_id, instance_id, slot)
    WHERE candidates.scene_id IN {scenes}
)
SELECT filled.*, assets.mesh_blob AS asset_blob, assets.name AS asset_name, placements.asset_id AS placed_asset_id, placements.origin
FROM filled
LEFT JOIN assets ON assets.asset_id = filled.asset_id
LEFT JOIN (SELECT scene_id, instance_id, asset_id, origin FROM placements WHERE scene_id IN {scenes}) AS placements
    ON placements.scene_id = filled.scene_id AND placements.instance_id = filled.instance_id
ORDER BY filled.alike DESC, filled.category, filled.slot"""


_ORDERS: Mapping[str, str] = {
    "annotation_timing": "reading DESC",
    "annotation_agreement": "answers DESC, annotator",
    "annotator_agreement": "instances DESC, annotator_a, annotator_b",
    "quality_history": "answered_until DESC NULLS LAST, batch_id, round",
    "dataset_comparison": "dataset",
    "failures": "scene_id, stage",
    "broken_rules": "format, rule, scene_id, message",
    "degradation_counts": "times DESC, stage, degradation",
    "fallback_counts": "stage, provider, provider_version",
    "selection_methods": "dataset, split, top_1 DESC, method, model_id, training_id",
    "selection_quality": "objects DESC, category",
    "scene_certificates": "is_plausible, deep_pairs DESC, unstable_5cm DESC, uncertified DESC, scene_id, engine",
    "stability": "stable_5cm_share, stable_1cm_share, scene_id, engine",
    "unstable_objects": "displacement_m DESC NULLS FIRST, scene_id, instance_id, engine",
    "optimization_remains": "scene_id, instance_id NULLS FIRST, remains",
    "support_counts": "lost DESC, unsupported DESC, scene_id",
    "collider_fit": "greatest(early_share, miss_share) DESC, asset_id",
    "density_check": "implausible DESC, objects DESC, category",
    "scene_fidelity_overview": "object_f_5cm NULLS LAST, scene_id",
    "fidelity_by_category": "mean_f_5cm NULLS LAST, category",
    "micro_scene_overview": "room_type = 'all' DESC, micro_scenes DESC, category, room_type",
    "micro_scene_splits": "split NULLS LAST",
    "synthesis_figures": "dataset, model_kind, model_id",
    "synthesis_evaluations": "dataset, split, metric, method, architecture NULLS FIRST, value",
    "navigability": "navigable_share, scene_id, agent",
    "navigation_metrics": "policy, run_name, agent, split, success_distance_m",
    "navigation_comparison": "comparison_id, tested_on, trained_on",
    "navigation_comparison_tests": "comparison_id, tested_on, first, second, measure",
    "robot_metrics": "policy, run_name, setup, body",
    "unreachable_objects": "scene_id, instance_id",
    "export_verdicts": "passed, scene_id, format",
    "license_counts": "material, license",
    "attributions": "uses DESC, license, author, provider, source",
}
"""Order of the tables that are cut; in it, what matters most comes first."""

_ALSO_DRAWN: Mapping[str, tuple[str, ...]] = {"stability": ("stable_1cm", "stable_5cm")}
"""Columns that a chart draws and the table does not show."""

_OF_LISTED: Mapping[str, str] = {
    "objects_per_scene": "room_type, floor_area_m2, objects",
    "categories_per_scene": "categories",
    "collision_loss": "deep_pairs_before, deep_pairs_after",
    "stability": "engine, engine_version, objects, free, fixed, fixed_share, stable_1cm, stable_5cm, stable_nudged, stable_1cm_share, "
    "stable_5cm_share, worst_instance_id, worst_displacement_m, worst_tilt_degrees, deepest_start_penetration_m, refused, uncertified",
    "scene_fidelity_overview": "object_f_5cm",
    "navigability": "agent, navigable_share, episodes",
    "scene_timing": "total_seconds",
}
"""What the table of scenes and the cards say of a scene."""

_OF_PICTURED: Mapping[str, str] = {
    "scene_objects": "scene_id, instance_id, category, box_size, mass_kg, material, provider, score, displacement_m, lift_m, support, "
    "settled_displacement_m",
    "optimization_remains": "scene_id, instance_id, category, remains",
    "export_verdicts": "scene_id, format, rules, broken_rules, passed",
}
"""What only the cards say."""

_FIRST: Mapping[str, str] = {
    "scene_objects": "instance_id",
    "optimization_remains": "instance_id NULLS FIRST, remains",
    "export_verdicts": "format",
}
