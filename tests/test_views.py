"""The SQL views, each against a computation of its own in Python and NumPy."""

from __future__ import annotations

import dataclasses
import math
import re
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from datetime import timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from schemas.annotation import Annotation
from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Frame, Instance, Room, Scene
from schemas.exports import ExportCheck, ExportFile
from schemas.navigation import Episode, Navmesh, UnreachableTarget
from schemas.optimization import APPLIED, RELATIONS, Certificate, Contact, Optimization, OptimizationStep, Placement, Support
from schemas.record import rows_to_arrow, table_of
from schemas.runs import StageRun
from schemas.selection import Selection
from schemas.tables import TABLES
from tests.samples import START, fingerprint, sample, stage_run
from warehouse import views
from warehouse.history import states

SCENES = ("demo/a", "scannet/scene0001_00", "scannet/scene0001_01")
"""The last two are scans of one room."""
CATEGORIES = ("chair", "mug", "table")
INSTANCES = ("0000", "0001", "0002", "0003")
ASSETS = tuple(fingerprint("asset", name) for name in "xyz")
EXACT = st.integers(0, 640).map(lambda n: n / 64)
"""Multiples of 1/64: quartiles and sums of them are exact, so that nothing depends on rounding."""

quick = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


class Database:
    """An in-memory DuckDB with all tables, empty until filled, and all views."""

    def __init__(self) -> None:
        import duckdb

        self.connection = duckdb.connect()
        self.connection.execute("SET TimeZone = 'UTC'")
        for name, table in TABLES.items():
            self.connection.register("given", table.arrow_schema.empty_table())
            self.connection.execute(f'CREATE TABLE "{name}" AS SELECT * FROM given')
        views.install(self.connection)

    def fill(self, *rows: Any) -> None:
        """Make these rows, of any tables, all that there is."""
        by_type: dict[type, list[Any]] = defaultdict(list)
        for row in rows:
            by_type[type(row)].append(row)
        for name in TABLES:
            self.connection.execute(f'DELETE FROM "{name}"')
        for record, of_type in by_type.items():
            self.connection.register("given", rows_to_arrow(of_type, record))
            self.connection.execute(f'INSERT INTO "{table_of(record).name}" SELECT * FROM given')

    def ask(self, view: str) -> list[dict[str, Any]]:
        """Rows of a view."""
        return self.connection.sql(f'SELECT * FROM "{view}"').to_arrow_table().to_pylist()


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    made = Database()
    yield made
    made.connection.close()


def by_key(rows: Sequence[Any], *names: str) -> dict[Any, Any]:
    """Rows by the values of some fields, which must be unique."""
    keyed = {tuple(row[name] for name in names) if len(names) > 1 else row[names[0]]: row for row in rows}
    assert len(keyed) == len(rows)
    return keyed


def same(left: Mapping[str, Any], **right: Any) -> None:
    """Assert fields equal, numbers up to rounding."""
    for name, value in right.items():
        if isinstance(value, float) and left[name] is not None:
            assert math.isclose(left[name], value, rel_tol=1e-12, abs_tol=1e-12), (name, left[name], value)
        else:
            assert left[name] == value, (name, left[name], value)


@st.composite
def scenes(draw: st.DrawFn) -> list[Any]:
    """Scenes, some with a room, some with instances."""
    rows: list[Any] = []
    for scene in draw(st.lists(st.sampled_from(SCENES), unique=True)):
        rows.append(sample(Scene, scene_id=scene, room_id=scene.rsplit("_", 1)[0], license=draw(st.sampled_from([None, "CC-BY-4.0"]))))
        if draw(st.booleans()):
            rows.append(sample(Room, scene_id=scene, room_type=draw(st.sampled_from(["office", "kitchen"])), floor_area_m2=draw(EXACT)))
        count = draw(st.integers(0, 12))
        for number in range(count):
            rows.append(
                sample(
                    Instance, scene_id=scene, instance_id=f"{number:04d}", category=draw(st.sampled_from(CATEGORIES)),
                    is_structure=draw(st.sampled_from([False, False, True])), box_volume_m3=draw(EXACT),
                )
            )  # fmt: skip
    return rows


@st.composite
def runs(draw: st.DrawFn) -> list[StageRun]:
    """A history of runs, as commits write it: growing snapshots, times and attempts."""
    rows = []
    attempts: Counter[tuple[str, str, str]] = Counter()
    for place in range(draw(st.integers(0, 14))):
        scene = draw(st.sampled_from(SCENES[:2]))
        stage = draw(st.sampled_from(["capture", "captions"]))
        key = (scene, stage, draw(st.sampled_from([fingerprint(1), fingerprint(2)])))
        attempts[key] += 1
        outcome = draw(st.sampled_from(["done", "done", "failed", "lost", "withdrawn"]))
        rows.append(
            stage_run(
                *key, attempt=attempts[key], outcome=outcome, snapshot_id=1 + place // 3, started_at=START + timedelta(seconds=place),
                seconds=draw(EXACT), peak_memory_mb=draw(EXACT), error="it broke" if outcome == "failed" else None,
                degradations=tuple(draw(st.lists(st.sampled_from(["0001: no view", "0002: no view", "one worker"]), max_size=3))),
            )
        )  # fmt: skip
    return rows


def degrees(radians: float | None) -> float | None:
    return None if radians is None else math.degrees(radians)


def of(rows: Sequence[Any], record: type) -> list[Any]:
    return [row for row in rows if type(row) is record]


def objects_of(rows: Sequence[Any]) -> dict[str, list[Instance]]:
    """Instances that are no structure, by scene; every scene is there."""
    found: dict[str, list[Instance]] = {row.scene_id: [] for row in of(rows, Scene)}
    for row in of(rows, Instance):
        if not row.is_structure:
            found[row.scene_id].append(row)
    return found


def test_every_view_asks_a_question_and_answers_an_empty_lake(database: Database) -> None:
    database.fill()
    comments = dict(database.connection.execute("SELECT view_name, comment FROM duckdb_views() WHERE NOT internal").fetchall())
    assert len(views.listing()) >= 20
    for name, question in views.listing():
        assert question.endswith("?")
        assert comments[name].startswith(f"{question} Version ")
        assert len(database.ask(name)) == {"headline": 1, "annotation_timing": 3}.get(name, 0), name
    assert {name: value for name, value in database.ask("headline")[0].items() if value} == {}


def test_views_name_no_table_and_each_is_a_single_reading_statement(database: Database) -> None:
    import duckdb

    for view in views.views():
        assert view.name not in TABLES
        statements = database.connection.extract_statements(view.query)
        assert [s.type for s in statements] == [duckdb.StatementType.SELECT]


def test_a_view_without_a_question_is_refused() -> None:
    with pytest.raises(ValueError, match="asks a question"):
        views._parse("odd", "SELECT 1")
    with pytest.raises(ValueError, match="is a table"):
        views._parse("scenes", "-- What?\n-- Version 1.\nSELECT 1")
    with pytest.raises(ValueError, match="states the version"):
        views._parse("odd", "-- What?\nSELECT 1")


@quick
@given(rows=scenes())
def test_objects_and_categories_per_scene(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    objects, rooms = objects_of(rows), {row.scene_id: row for row in of(rows, Room)}
    counted, categories = by_key(database.ask("objects_per_scene"), "scene_id"), by_key(database.ask("categories_per_scene"), "scene_id")
    assert counted.keys() == categories.keys() == objects.keys()
    for scene, held in objects.items():
        area = rooms[scene].floor_area_m2 if scene in rooms else None
        structures = sum(row.is_structure for row in of(rows, Instance) if row.scene_id == scene)
        density = len(held) / area if area else None
        room_type = rooms[scene].room_type if scene in rooms else "unknown"
        same(counted[scene], objects=len(held), structures=structures, floor_area_m2=area, objects_per_m2=density, room_type=room_type)
        frequency = Counter(row.category for row in held)
        first = min(frequency, key=lambda c: (-frequency[c], c)) if frequency else None
        same(categories[scene], categories=len(frequency), most_frequent_category=first, most_frequent_objects=frequency[first] or None)
    everywhere = [row for held in objects.values() for row in held]
    answer = database.ask("category_counts")
    assert [row["category"] for row in answer] == sorted(
        {row.category for row in everywhere}, key=lambda c: (-sum(r.category == c for r in everywhere), c)
    )
    for row in answer:
        having = [one for one in everywhere if one.category == row["category"]]
        same(row, objects=len(having), scenes=len({one.scene_id for one in having}), share=len(having) / len(everywhere))
    same(
        database.ask("headline")[0],
        scenes=len(objects), objects=len(everywhere), categories=len({row.category for row in everywhere}),
        floor_area_m2=float(sum(row.floor_area_m2 for row in rooms.values())), rooms=len({row.room_id for row in of(rows, Scene)}),
    )  # fmt: skip


@quick
@given(rows=scenes())
def test_volume_quartiles_whiskers_and_outliers_are_those_of_matplotlib(database: Database, rows: list[Any]) -> None:
    from matplotlib.cbook import boxplot_stats

    database.fill(*rows)
    volumes: dict[str, list[float]] = defaultdict(list)
    for held in objects_of(rows).values():
        for row in held:
            volumes[row.category].append(row.box_volume_m3)
    answer = database.ask("volume_by_category")
    order = sorted(volumes, key=lambda c: (-len(volumes[c]), c))
    assert [(row["frequency_rank"], row["category"]) for row in answer] == list(enumerate(order, start=1))
    strays = database.ask("volume_outliers")
    for row in answer:
        values = volumes[row["category"]]
        box = boxplot_stats(values)[0]
        fliers = sorted(float(value) for value in box["fliers"])
        same(
            row, objects=len(values), smallest_m3=min(values), largest_m3=max(values), q1_m3=float(box["q1"]), median_m3=float(box["med"]),
            q3_m3=float(box["q3"]), whisker_low_m3=float(box["whislo"]), whisker_high_m3=float(box["whishi"]), outliers=len(fliers),
        )  # fmt: skip
        assert sorted(stray["box_volume_m3"] for stray in strays if stray["category"] == row["category"]) == fliers


def test_a_whisker_never_ends_inside_its_box(database: Database) -> None:
    # the only volume below the lower quartile is an outlier, so that no volume lies between fence and box
    volumes = (0.0, 10.0, 10.0, 10.0)
    held = [
        sample(Instance, scene_id="demo/a", instance_id=f"{n:04d}", category="mug", is_structure=False, box_volume_m3=v)
        for n, v in enumerate(volumes)
    ]
    database.fill(*held)
    same(database.ask("volume_by_category")[0], whisker_low_m3=7.5, q1_m3=7.5, whisker_high_m3=10.0, outliers=1)


@quick
@given(history=runs(), rows=scenes())
def test_runs_and_times_agree_with_the_history_of_the_lake(database: Database, history: list[StageRun], rows: list[Any]) -> None:
    database.fill(*rows, *history)
    state = states(rows_to_arrow(history, StageRun))
    current = {key: found.done for key, found in state.items() if found.done is not None}
    answer = by_key(database.ask("current_runs"), "scene_id", "stage")
    assert {key: (row["fingerprint"], row["attempt"]) for key, row in answer.items()} == {
        key: (run.fingerprint, run.attempt) for key, run in current.items()
    }
    failed = {key: found.last for key, found in state.items() if found.last.outcome != "done"}
    failures = by_key(database.ask("failures"), "scene_id", "stage")
    assert {key: (row["outcome"], row["error"]) for key, row in failures.items()} == {k: (r.outcome, r.error) for k, r in failed.items()}
    for key, row in failures.items():
        tried = [r for r in history if (r.scene_id, r.stage, r.fingerprint) == (*key, failed[key].fingerprint)]
        assert row["attempts"] == sum(r.outcome != "withdrawn" for r in tried)
    objects = {scene: len(held) for scene, held in objects_of(rows).items()}
    timing = by_key(database.ask("stage_timing"), "stage")
    assert timing.keys() == {stage for _, stage in current}
    for stage, row in timing.items():
        seconds = {scene: run.seconds for (scene, name), run in current.items() if name == stage}
        counted = {scene: objects.get(scene, 0) for scene in seconds}
        total = sum(counted.values())
        each = sum(s for scene, s in seconds.items() if counted[scene]) / total if total else None
        values = list(seconds.values())
        same(
            row, scenes=len(values), total_seconds=float(sum(values)), median_seconds=float(np.median(values)), objects=total,
            p95_seconds=float(np.percentile(values, 95)), slowest_seconds=max(values), seconds_per_object=each,
        )  # fmt: skip
    per_scene = by_key(database.ask("scene_timing"), "scene_id")
    assert per_scene.keys() == {scene for scene, _ in current} & objects.keys()
    for scene, row in per_scene.items():
        spent = {stage: run.seconds for (one, stage), run in current.items() if one == scene}
        slowest = min(spent, key=lambda stage: (-spent[stage], stage))
        same(row, stages=len(spent), total_seconds=float(sum(spent.values())), slowest_stage=slowest, slowest_seconds=spent[slowest])
        same(row, seconds_per_object=sum(spent.values()) / objects[scene] if objects[scene] else None)
    for row in database.ask("stage_outcomes"):
        of_stage = [run for run in history if run.stage == row["stage"]]
        for outcome in ("done", "failed", "lost", "withdrawn"):
            assert row[outcome] == sum(run.outcome == outcome for run in of_stage)
        assert row["runs"] == sum(run.outcome != "withdrawn" for run in of_stage)
    degraded = Counter((run.stage, re.sub(r"^\d+: ", "", text)) for run in current.values() for text in run.degradations)
    assert {(row["stage"], row["degradation"]): row["times"] for row in database.ask("degradation_counts")} == dict(degraded)


OUTCOMES = next(column.values for column in table_of(OptimizationStep).columns if column.name == "outcome")
PAIRS = [("0000", "0001"), ("0000", "wall_00"), ("0001", "floor")]


@st.composite
def physics(draw: st.DrawFn) -> list[Any]:
    """What the optimization wrote of some scenes: steps, contacts, placements, supports, certificates."""
    rows: list[Any] = []
    for scene in SCENES[:2]:
        steps = draw(st.lists(st.sampled_from(OUTCOMES[1:]), max_size=9))
        for step, outcome in enumerate(["start", *steps]):
            rows.append(sample(OptimizationStep, scene_id=scene, step=step, outcome=outcome))
        for phase, (first, second) in draw(
            st.lists(st.tuples(st.sampled_from(["proposed", "optimized"]), st.sampled_from(PAIRS)), unique=True)
        ):
            depth, allowed = draw(st.sampled_from([0.0, 0.001, 0.002, 0.0021, 0.25])), draw(st.booleans())
            of_pair = {"scene_id": scene, "phase": phase, "instance_a": first, "body_b": second}
            rows.append(sample(Contact, **of_pair, penetration_m=depth, is_allowed=allowed))
        placed = draw(st.lists(st.sampled_from(INSTANCES), unique=True))
        for instance in placed:
            place = {"scene_id": scene, "instance_id": instance}
            remains = draw(st.sampled_from([None, "sinks into the floor", "stands in 0002"]))
            rows.append(sample(Instance, **place, category=draw(st.sampled_from(CATEGORIES)), is_structure=False))
            rows.append(sample(Placement, **place, remains=remains))
            rows.append(
                sample(
                    Support, **place, relation=draw(st.sampled_from(RELATIONS)), against=draw(st.sampled_from([None, "wall_00"])),
                    is_fixed=draw(st.booleans()), is_kept=draw(st.booleans()), gap_m=-draw(EXACT),
                )
            )  # fmt: skip
            for engine in draw(st.lists(st.sampled_from(["mujoco", "newton"]), unique=True)):
                density, bounds = draw(EXACT), draw(st.none() | st.tuples(EXACT, EXACT))
                low, high = (None, None) if bounds is None else (bounds[0], sum(bounds))
                problem = draw(st.sampled_from([None, None, None, "its state diverges"]))
                far, tilt, depth = (None if problem else draw(EXACT) for _ in range(3))
                rows.append(
                    sample(
                        Certificate, **place, engine=engine, problem=problem, displacement_m=far, tilt_radians=tilt,
                        start_penetration_m=depth, is_fixed=draw(st.booleans()), is_stable_1cm=problem is None and draw(st.booleans()),
                        is_stable_5cm=problem is None and draw(st.booleans()), density_kg_m3=density, density_low_kg_m3=low,
                        density_high_kg_m3=high,
                        is_density_plausible=None if low is None or high is None or not density else low <= density <= high,
                    )
                )  # fmt: skip
        if draw(st.booleans()):
            lines = draw(st.lists(st.sampled_from(["0001: sinks into the floor", "0003: stands in 0002", "no room is known"]), unique=True))
            rows.append(
                sample(
                    Optimization, scene_id=scene, method=draw(st.sampled_from(["paper", "default"])), object_count=len(placed),
                    loss_start=draw(EXACT), loss_final=draw(EXACT), moves=draw(st.integers(0, 9)), remains=tuple(lines),
                )
            )  # fmt: skip
    return rows


def deep(rows: Sequence[Any], scene: str, phase: str) -> list[float]:
    """Penetration depths of a scene's pairs that may not interpenetrate [m]."""
    return [r.penetration_m for r in of(rows, Contact) if (r.scene_id, r.phase, r.is_allowed) == (scene, phase, False)]


@quick
@given(rows=physics())
def test_collision_loss_before_and_after(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    answer = by_key(database.ask("collision_loss"), "scene_id")
    made = by_key([dataclasses.asdict(row) for row in of(rows, Optimization)], "scene_id")
    assert answer.keys() == made.keys() | {row.scene_id for row in of(rows, Contact) if not row.is_allowed}
    for scene, row in answer.items():
        optimization = made.get(scene, {"method": None, "loss_start": None, "loss_final": None, "moves": None})
        before, after = deep(rows, scene, "proposed"), deep(rows, scene, "optimized")
        outcomes = [r.outcome for r in of(rows, OptimizationStep) if r.scene_id == scene]
        same(
            row, method=optimization["method"], loss_unit={"paper": "m3", "default": "m", None: None}[optimization["method"]],
            loss_before=optimization["loss_start"], loss_after=optimization["loss_final"], moves=optimization["moves"],
            applied_steps=sum(outcome in APPLIED for outcome in outcomes), deep_pairs_before=sum(d > 0.002 for d in before),
            deep_pairs_after=sum(d > 0.002 for d in after), deepest_before_m=max(before, default=0.0),
            deepest_after_m=max(after, default=0.0),
        )  # fmt: skip


@quick
@given(rows=physics())
def test_stability_counts_the_free_and_names_those_that_fail(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    groups: dict[tuple[str, str], list[Certificate]] = defaultdict(list)
    for row in of(rows, Certificate):
        groups[row.scene_id, row.engine].append(row)
    answer = by_key(database.ask("stability"), "scene_id", "engine")
    assert answer.keys() == groups.keys()
    for key, group in groups.items():
        free = [c for c in group if not c.is_fixed]
        one, five = sum(c.is_stable_1cm for c in free), sum(c.is_stable_5cm for c in free)
        known = [c for c in free if c.problem is None]
        worst = max((c.displacement_m for c in known), default=None)
        same(
            answer[key], objects=len(group), free=len(free), fixed=len(group) - len(free), fixed_share=1 - len(free) / len(group),
            stable_1cm=one, stable_5cm=five, stable_1cm_share=one / len(free) if free else None,
            stable_5cm_share=five / len(free) if free else None, worst_displacement_m=worst,
            worst_tilt_degrees=math.degrees(max(c.tilt_radians for c in known)) if known else None,
            deepest_start_penetration_m=max((c.start_penetration_m for c in known), default=None),
            refused=sum(c.problem is not None for c in group),
            uncertified=sum(p.scene_id == key[0] for p in of(rows, Placement)) - sum(c.problem is None for c in group),
        )  # fmt: skip
        assert answer[key]["worst_instance_id"] in {c.instance_id for c in known if c.displacement_m == worst} | (
            {None} if not known else set()
        )
    failing = {(c.scene_id, c.instance_id, c.engine): c for group in groups.values() for c in group if c.problem or not c.is_fixed}
    failing = {key: c for key, c in failing.items() if not (c.is_stable_1cm and c.is_stable_5cm)}
    named = by_key(database.ask("unstable_objects"), "scene_id", "instance_id", "engine")
    assert named.keys() == failing.keys()
    category, support, placed = (
        {(r.scene_id, r.instance_id): getattr(r, name) for r in of(rows, record)}
        for record, name in ((Instance, "category"), (Support, "relation"), (Placement, "remains"))
    )
    for key, row in named.items():
        same(
            row, category=category[key[:2]], support=support[key[:2]], remains=placed[key[:2]], fails_5cm=not failing[key].is_stable_5cm,
            displacement_m=failing[key].displacement_m, problem=failing[key].problem,
            tilt_degrees=degrees(failing[key].tilt_radians),
        )  # fmt: skip
    assert [row["displacement_m"] for row in database.ask("unstable_objects")] == sorted(
        (c.displacement_m for c in failing.values()), key=lambda far: (far is not None, -(far or 0.0))
    )
    mujoco = [c for (_, engine), group in groups.items() if engine == "mujoco" for c in group if not c.is_fixed]
    pairs = sum(depth > 0.002 for scene in SCENES for depth in deep(rows, scene, "optimized"))
    fixed = sum(c.is_fixed for (_, engine), group in groups.items() if engine == "mujoco" for c in group)
    same(
        database.ask("headline")[0], free_objects=len(mujoco), fixed_objects=fixed, stable_1cm=sum(c.is_stable_1cm for c in mujoco),
        stable_5cm=sum(c.is_stable_5cm for c in mujoco), deep_pairs=pairs,
    )  # fmt: skip


@quick
@given(rows=physics())
def test_a_scene_is_plausible_when_nothing_speaks_against_it(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    answer = by_key(database.ask("scene_certificates"), "scene_id", "engine")
    certificates = of(rows, Certificate)
    expected = set()
    for made in of(rows, Optimization):
        scene = made.scene_id
        placed = {p.instance_id for p in of(rows, Placement) if p.scene_id == scene}
        for engine in sorted({c.engine for c in certificates if c.scene_id == scene}) or [None]:
            expected.add((scene, engine))
            held = {c.instance_id: c for c in certificates if (c.scene_id, c.engine) == (scene, engine)}
            simulated = {name for name, c in held.items() if c.problem is None}
            fallen = sum(not c.is_fixed and not c.is_stable_5cm for c in held.values())
            pairs = sum(d > 0.002 for d in deep(rows, scene, "optimized"))
            same(
                answer[scene, engine], uncertified=len(placed - simulated), deep_pairs=pairs, unstable_5cm=fallen if engine else None,
                lost_supports=sum(s.scene_id == scene and not s.is_kept for s in of(rows, Support)),
                implausible_densities=sum(c.is_density_plausible is False for c in held.values()), remains=len(made.remains),
                is_plausible=engine is not None and not pairs and not fallen and simulated == placed,
            )  # fmt: skip
    assert answer.keys() == expected


@quick
@given(rows=physics())
def test_densities_supports_and_what_remains(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    category = {(r.scene_id, r.instance_id): r.category for r in of(rows, Instance)}
    weighed: dict[tuple[str, str], Certificate] = {}
    for row in sorted(of(rows, Certificate), key=lambda c: c.engine):
        weighed.setdefault((row.scene_id, row.instance_id), row)
    densities = by_key(database.ask("density_check"), "category")
    assert densities.keys() == {category[key] for key in weighed}
    for name, row in densities.items():
        having = [c for key, c in weighed.items() if category[key] == name]
        same(
            row, objects=len(having), implausible=sum(c.is_density_plausible is False for c in having),
            without_verdict=sum(c.is_density_plausible is None for c in having),
            median_density_kg_m3=float(np.median(known)) if (known := [c.density_kg_m3 for c in having if c.density_kg_m3]) else None,
            least_density_kg_m3=min(known, default=None), greatest_density_kg_m3=max(known, default=None),
            allowed_from_kg_m3=min((c.density_low_kg_m3 for c in having if c.density_low_kg_m3 is not None), default=None),
            allowed_to_kg_m3=max((c.density_high_kg_m3 for c in having if c.density_high_kg_m3 is not None), default=None),
        )  # fmt: skip
        assert row["too_light"] + row["too_heavy"] == row["implausible"]
    supports = of(rows, Support)
    counted = by_key(database.ask("support_counts"), "scene_id")
    assert counted.keys() == {s.scene_id for s in supports}
    for scene, row in counted.items():
        carried = [s for s in supports if s.scene_id == scene]
        columns = zip(("on_floor", "on_objects", "inside_objects", "on_walls", "on_ceiling", "unsupported"), RELATIONS, strict=True)
        same(row, **{column: sum(s.relation == relation for s in carried) for column, relation in columns})
        same(
            row, fixed=sum(s.is_fixed for s in carried), lost=sum(not s.is_kept for s in carried),
            against_room=sum(s.against is not None for s in carried), largest_gap_m=max(abs(s.gap_m) for s in carried),
        )  # fmt: skip
    said = {(p.scene_id, p.instance_id, p.remains) for p in of(rows, Placement) if p.remains}
    for made in of(rows, Optimization):
        for line in made.remains:
            name, _, text = line.rpartition(": ")
            said.add((made.scene_id, name or None, text))
    answer = database.ask("optimization_remains")
    assert len(answer) == len(said)
    assert {(r["scene_id"], r["instance_id"], r["remains"]) for r in answer} == said
    assert all(r["category"] == category.get((r["scene_id"], r["instance_id"])) for r in answer)


@st.composite
def choices(draw: st.DrawFn) -> list[Any]:
    """Instances with candidates, selections, placements, captions, supports and annotations."""
    known = zip(ASSETS, ("MIT", "MIT", "CC0-1.0"), ("Q", None, "Q"), strict=True)
    rows: list[Any] = [sample(Asset, asset_id=asset, license=terms, author=author) for asset, terms, author in known]
    for scene in SCENES[:2]:
        for instance in draw(st.lists(st.sampled_from(INSTANCES), unique=True)):
            place = {"scene_id": scene, "instance_id": instance}
            rows.append(sample(Instance, **place, category=draw(st.sampled_from(CATEGORIES)), is_structure=False))
            if draw(st.booleans()):
                body = draw(st.sampled_from(["rigid", "cloth", "soft"]))
                rows.append(sample(Caption, **place, mass_kg=1 + draw(EXACT), body_type=body, is_fallback=draw(st.booleans())))
            slots = draw(st.lists(st.integers(1, 3), unique=True))
            filled = [slot for slot in slots if draw(st.booleans())]
            for slot in slots:
                outcome = "filled" if slot in filled else draw(st.sampled_from(["empty", "failed"]))
                rows.append(
                    sample(
                        Candidate, **place, slot=slot, provider=draw(st.sampled_from(["library", "procedural"])), outcome=outcome,
                        is_fallback=draw(st.booleans()), asset_id=ASSETS[slot - 1] if slot in filled else None,
                    )
                )  # fmt: skip
            ranked = draw(st.permutations(filled))
            for rank, slot in enumerate(ranked, start=1):
                score, chamfer = draw(st.integers(0, 64)) / 64, draw(EXACT)
                rows.append(sample(Selection, **place, rank=rank, slot=slot, asset_id=ASSETS[slot - 1], score=score, chamfer_m=chamfer))
            if ranked:
                asset = ASSETS[draw(st.sampled_from(ranked)) - 1]
                rows.append(sample(Placement, **place, asset_id=asset, displacement_m=draw(EXACT), lift_m=-draw(EXACT)))
                rows.append(sample(Support, **place, relation=draw(st.sampled_from(RELATIONS)), is_fixed=draw(st.booleans())))
                for engine in draw(st.lists(st.sampled_from(["mujoco", "newton"]), unique=True)):
                    moved = draw(st.none() | EXACT)
                    turned = None if moved is None else draw(EXACT)
                    rows.append(sample(Certificate, **place, engine=engine, displacement_m=moved, tilt_radians=turned))
            for batch in range(draw(st.integers(0, 2))):
                choice = draw(st.sampled_from([None, *ASSETS]))
                when = START + timedelta(days=batch)
                rows.append(sample(Annotation, **place, batch_id=f"b{batch}", annotator="ann", answered_at=when, choice=choice))
    return rows


@quick
@given(rows=choices())
def test_candidates_selections_and_placements(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    best = {(r.scene_id, r.instance_id): r for r in of(rows, Selection) if r.rank == 1}
    placed = {(r.scene_id, r.instance_id): r for r in of(rows, Placement)}
    category = {(r.scene_id, r.instance_id): r.category for r in of(rows, Instance)}
    groups: dict[tuple[str, int], list[Candidate]] = defaultdict(list)
    for row in of(rows, Candidate):
        groups[row.provider, row.slot].append(row)
    wins = by_key(database.ask("candidate_wins"), "provider", "slot")
    assert wins.keys() == groups.keys()
    for key, group in groups.items():
        won = [b.score for c in group if (b := best.get((c.scene_id, c.instance_id))) and b.slot == c.slot]
        filled = sum(c.outcome == "filled" for c in group)
        same(
            wins[key], candidates=len(group), filled=filled, fallbacks=sum(c.is_fallback for c in group), wins=len(won),
            win_share=len(won) / filled if filled else None, mean_winning_score=float(np.mean(won)) if won else None,
            placed=sum((p := placed.get((c.scene_id, c.instance_id))) is not None and p.asset_id == c.asset_id for c in group),
        )  # fmt: skip
    assert sum(row["wins"] for row in wins.values()) == len(best)
    for row in database.ask("selection_quality"):
        scores = [r.score for key, r in best.items() if category[key] == row["category"]]
        same(row, objects=len(scores), median_score=float(np.median(scores)), lowest_score=min(scores))
    for row in database.ask("displacement_by_category"):
        moved = [p.displacement_m for key, p in placed.items() if category[key] == row["category"]]
        same(row, objects=len(moved), moved=sum(m > 0 for m in moved), median_displacement_m=float(np.median(moved)))
    assert sum(row["objects"] for row in database.ask("displacement_by_category")) == len(placed)
    licenses = {asset.asset_id: asset.license for asset in of(rows, Asset)}
    used = by_key([row for row in database.ask("license_counts") if row["material"] == "asset"], "license")
    assert {key: row["uses"] for key, row in used.items()} == Counter(licenses[p.asset_id] for p in placed.values())
    for name, row in used.items():
        of_license = [p for p in placed.values() if licenses[p.asset_id] == name]
        same(row, items=len({p.asset_id for p in of_license}), scenes=len({p.scene_id for p in of_license}))
    assert sum(row["uses"] for row in database.ask("attributions")) == len(placed)


@quick
@given(rows=choices())
def test_one_row_per_object_and_what_is_known_of_it(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    answer = by_key(database.ask("scene_objects"), "scene_id", "instance_id")
    assert answer.keys() == {(r.scene_id, r.instance_id) for r in of(rows, Instance)}
    captions, placed, supports = ({(r.scene_id, r.instance_id): r for r in of(rows, kind)} for kind in (Caption, Placement, Support))
    scores = {(r.scene_id, r.instance_id, r.asset_id): r.score for r in of(rows, Selection)}
    certified = {(r.scene_id, r.instance_id): r for r in of(rows, Certificate) if r.engine == "mujoco"}
    for key, row in answer.items():
        placement = placed.get(key)
        same(
            row, mass_kg=captions[key].mass_kg if key in captions else None,
            displacement_m=placement.displacement_m if placement else None, score=scores[(*key, placement.asset_id)] if placement else None,
            support=supports[key].relation if key in supports else None, is_fixed=supports[key].is_fixed if key in supports else None,
            settled_displacement_m=certified[key].displacement_m if key in certified else None,
            settled_tilt_degrees=degrees(certified[key].tilt_radians) if key in certified else None,
        )  # fmt: skip
    for row in database.ask("mass_by_category"):
        masses = [captions[key].mass_kg for key, one in answer.items() if one["category"] == row["category"] and key in captions]
        same(row, objects=len(masses), median_kg=float(np.median(masses)), heaviest_kg=max(masses), total_kg=float(sum(masses)))
        assert row["rigid"] + row["cloth"] + row["soft"] == len(masses)
    fallbacks = {(r["stage"], r["provider"]): (r["answers"], r["fallbacks"]) for r in database.ask("fallback_counts")}
    candidates = of(rows, Candidate)
    assert sum(a for (stage, _), (a, _) in fallbacks.items() if stage == "candidates") == len(candidates)
    assert sum(f for (stage, _), (_, f) in fallbacks.items() if stage == "candidates") == sum(c.is_fallback for c in candidates)
    assert sum(f for (stage, _), (_, f) in fallbacks.items() if stage == "captions") == sum(c.is_fallback for c in captions.values())


@quick
@given(rows=choices())
def test_annotation_agreement_counts_only_the_newest_answer(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    newest: dict[tuple[str, str], Annotation] = {}
    for row in sorted(of(rows, Annotation), key=lambda r: r.answered_at):
        newest[row.scene_id, row.instance_id] = row
    best = {(r.scene_id, r.instance_id): r.asset_id for r in of(rows, Selection) if r.rank == 1}
    answer = database.ask("annotation_agreement")
    if not newest:
        assert answer == []
        return
    agreed = sum(row.choice is not None and row.choice == best.get(key) for key, row in newest.items())
    comparable = sum(row.choice is not None and key in best for key, row in newest.items())
    same(
        answer[0], annotator="ann", answers=len(newest), none_fits=sum(row.choice is None for row in newest.values()),
        same_as_selection=agreed, agreement=agreed / comparable if comparable else None,
    )  # fmt: skip


@st.composite
def trips(draw: st.DrawFn) -> list[Any]:
    """Navmeshes, episodes and unreachable targets of some scenes."""
    rows = draw(scenes())
    for scene in sorted({row.scene_id for row in of(rows, Scene)}):
        for agent in draw(st.lists(st.sampled_from(["stretch", "spot"]), unique=True)):
            rows.append(sample(Navmesh, scene_id=scene, agent=agent, area_m2=draw(EXACT), largest_island_m2=draw(EXACT)))
        for number in range(draw(st.integers(0, 5))):
            rows.append(
                sample(
                    Episode, scene_id=scene, episode_id=f"{number:04d}", agent=draw(st.sampled_from(["stretch", "spot"])),
                    instance_id=draw(st.sampled_from(INSTANCES)), split=draw(st.sampled_from(["train", "test"])), geodesic_m=draw(EXACT),
                    actions=("forward",) * draw(st.integers(0, 4)) + ("stop",),
                )
            )  # fmt: skip
        for target in draw(st.lists(st.sampled_from(INSTANCES), unique=True)):
            rows.append(sample(UnreachableTarget, scene_id=scene, instance_id=target))
        for number in range(draw(st.integers(0, 3))):
            pose = None if draw(st.booleans()) else tuple(np.eye(4).ravel().tolist())
            rows.append(sample(Frame, scene_id=scene, frame_id=f"{number:06d}", pose=pose))
    return rows


@quick
@given(rows=trips())
def test_navigability_splits_and_capture(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    area = {row.scene_id: row.floor_area_m2 for row in of(rows, Room)}
    answer = by_key(database.ask("navigability"), "scene_id", "agent")
    assert answer.keys() == {(row.scene_id, row.agent) for row in of(rows, Navmesh)}
    for mesh in of(rows, Navmesh):
        taken = [e for e in of(rows, Episode) if (e.scene_id, e.agent) == (mesh.scene_id, mesh.agent)]
        floor = area.get(mesh.scene_id)
        same(
            answer[mesh.scene_id, mesh.agent], episodes=len(taken), targets=len({e.instance_id for e in taken}),
            navigable_share=mesh.area_m2 / floor if floor else None,
            largest_island_share=mesh.largest_island_m2 / mesh.area_m2 if mesh.area_m2 else None,
            unreachable_targets=sum(u.scene_id == mesh.scene_id for u in of(rows, UnreachableTarget)),
        )  # fmt: skip
    reasons = [(r["scene_id"], r["instance_id"], r["reason"]) for r in database.ask("unreachable_objects")]
    assert reasons == sorted((u.scene_id, u.instance_id, u.reason) for u in of(rows, UnreachableTarget))
    for row in database.ask("episode_splits"):
        inside = [e for e in of(rows, Episode) if e.split == row["split"]]
        same(
            row, episodes=len(inside), scenes=len({e.scene_id for e in inside}), rooms=len({e.scene_id.rsplit("_", 1)[0] for e in inside}),
            median_geodesic_m=float(np.median([e.geodesic_m for e in inside])),
            mean_actions=float(np.mean([len(e.actions) for e in inside])),
        )  # fmt: skip
    for row in database.ask("capture_quality"):
        posed = sum(f.pose is not None for f in of(rows, Frame) if f.scene_id == row["scene_id"])
        assert row["posed_frames"] == posed
    scans = [r for r in database.ask("license_counts") if r["material"] == "scan"]
    assert {r["license"]: r["items"] for r in scans} == Counter(s.license or "not stated" for s in of(rows, Scene))


@st.composite
def exports(draw: st.DrawFn) -> list[Any]:
    """Export files and checks of some scenes."""
    rows: list[Any] = []
    for scene in SCENES[:2]:
        for kind in ("usd", "habitat"):
            for path in draw(st.lists(st.sampled_from("abc"), unique=True)):
                rows.append(sample(ExportFile, scene_id=scene, format=kind, path=path, size_bytes=draw(st.integers(0, 1000))))
            for rule in draw(st.lists(st.sampled_from("pqr"), unique=True)):
                rows.append(sample(ExportCheck, scene_id=scene, format=kind, rule=rule, passed=draw(st.booleans())))
    return rows


@quick
@given(rows=exports())
def test_export_verdicts(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    answer = by_key(database.ask("export_verdicts"), "scene_id", "format")
    assert answer.keys() == {(row.scene_id, row.format) for row in rows}
    for key, row in answer.items():
        files = [r for r in of(rows, ExportFile) if (r.scene_id, r.format) == key]
        checks = [r for r in of(rows, ExportCheck) if (r.scene_id, r.format) == key]
        broken = sum(not check.passed for check in checks)
        passed = bool(files) and bool(checks) and broken == 0
        same(row, files=len(files), size_bytes=sum(f.size_bytes for f in files), rules=len(checks), broken_rules=broken, passed=passed)
    found = {(r["scene_id"], r["format"], r["rule"]) for r in database.ask("broken_rules")}
    assert found == {(r.scene_id, r.format, r.rule) for r in of(rows, ExportCheck) if not r.passed}
