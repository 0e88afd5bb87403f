"""The views of collisions, stability, densities and supports, each against a computation of its own."""

from __future__ import annotations

import dataclasses
import math
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.capture import Instance
from schemas.optimization import APPLIED, RELATIONS, Certificate, Contact, Optimization, OptimizationStep, Placement, Support
from schemas.record import table_of
from tests.samples import sample
from tests.warehouse.questions.view_answers import (
    CATEGORIES,
    EXACT,
    INSTANCES,
    SCENES,
    Database,
    by_key,
    degrees,
    of,
    quick,
    same,
)

UNITS = {"paper": "1", "released": "m3", "default": "m"}
"""Unit of a method's loss."""


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


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
            early, miss = draw(st.sampled_from([(None, None), (0.0, 0.0), (0.02, 0.02), (0.021, 0.0), (0.0, 0.5), (0.5, 0.021)]))
            counts = {"collider_pieces": None, "collider_faces": None} if early is None else {"collider_pieces": 7, "collider_faces": 84}
            asset = draw(st.sampled_from(["a" * 64, "b" * 64]))
            shares = {"collider_early_share": early, "collider_miss_share": miss}
            rows.append(sample(Placement, **place, remains=remains, asset_id=asset, **shares, **counts))
            rows.append(
                sample(
                    Support, **place, relation=draw(st.sampled_from(RELATIONS)), against=draw(st.sampled_from([None, "wall_00"])),
                    is_fixed=draw(st.booleans()), is_kept=draw(st.booleans()), gap_m=-draw(EXACT),
                )
            )  # fmt: skip
            for engine in draw(st.lists(st.sampled_from(["mujoco", "mujoco_defaults", "newton"]), unique=True)):
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
                        **nudges(draw, engine, problem),
                        is_density_plausible=None if low is None or high is None or not density else low <= density <= high,
                    )
                )  # fmt: skip
        if draw(st.booleans()):
            lines = draw(st.lists(st.sampled_from(["0001: sinks into the floor", "0003: stands in 0002", "no room is known"]), unique=True))
            rows.append(
                sample(
                    Optimization, scene_id=scene, method=draw(st.sampled_from(["paper", "released", "default"])), object_count=len(placed),
                    loss_start=draw(EXACT), loss_final=draw(EXACT), moves=draw(st.integers(0, 9)), remains=tuple(lines),
                )
            )  # fmt: skip
    return rows


def nudges(draw: st.DrawFn, engine: str, problem: str | None) -> dict[str, Any]:
    """What a certificate says of nudges: MuJoCo nudges unless it is told not to, Newton does not."""
    if engine == "newton" or draw(st.integers(0, 4)) == 0:
        return {"nudged_displacement_m": None, "nudged_tilt_radians": None, "is_stable_nudged": None}
    far, tilt = (None, None) if problem else (draw(EXACT), draw(EXACT))
    return {"nudged_displacement_m": far, "nudged_tilt_radians": tilt, "is_stable_nudged": problem is None and draw(st.booleans())}


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
            row, method=optimization["method"], loss_unit=UNITS.get(optimization["method"]),
            loss_before=optimization["loss_start"], loss_after=optimization["loss_final"], moves=optimization["moves"],
            applied_steps=sum(outcome in APPLIED for outcome in outcomes), deep_pairs_before=sum(d > 0.002 for d in before),
            deep_pairs_after=sum(d > 0.002 for d in after), deepest_before_m=max(before, default=0.0),
            deepest_after_m=max(after, default=0.0),
        )  # fmt: skip


@pytest.mark.whole
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
        nudged = None if any(c.is_stable_nudged is None for c in free) else sum(bool(c.is_stable_nudged) for c in free)
        known = [c for c in free if c.problem is None]
        worst = max((c.displacement_m for c in known), default=None)
        same(
            answer[key], objects=len(group), free=len(free), fixed=len(group) - len(free), fixed_share=1 - len(free) / len(group),
            stable_1cm=one, stable_5cm=five, stable_1cm_share=one / len(free) if free else None,
            stable_5cm_share=five / len(free) if free else None, stable_nudged=nudged,
            stable_nudged_share=nudged / len(free) if free and nudged is not None else None, worst_displacement_m=worst,
            worst_tilt_degrees=math.degrees(max(c.tilt_radians for c in known)) if known else None,
            deepest_start_penetration_m=max((c.start_penetration_m for c in known), default=None),
            refused=sum(c.problem is not None for c in group),
            uncertified=sum(p.scene_id == key[0] for p in of(rows, Placement)) - sum(c.problem is None for c in group),
        )  # fmt: skip
        assert answer[key]["worst_instance_id"] in {c.instance_id for c in known if c.displacement_m == worst} | (
            {None} if not known else set()
        )
    failing = {(c.scene_id, c.instance_id, c.engine): c for group in groups.values() for c in group if c.problem or not c.is_fixed}
    failing = {key: c for key, c in failing.items() if not (c.is_stable_1cm and c.is_stable_5cm) or c.is_stable_nudged is False}
    named = by_key(database.ask("unstable_objects"), "scene_id", "instance_id", "engine")
    assert named.keys() == failing.keys()
    category, support, placed = (
        {(r.scene_id, r.instance_id): getattr(r, name) for r in of(rows, record)}
        for record, name in ((Instance, "category"), (Support, "relation"), (Placement, "remains"))
    )
    for key, row in named.items():
        same(
            row, category=category[key[:2]], support=support[key[:2]], remains=placed[key[:2]], is_stable_5cm=failing[key].is_stable_5cm,
            displacement_m=failing[key].displacement_m, problem=failing[key].problem,
            tilt_degrees=degrees(failing[key].tilt_radians), nudged_displacement_m=failing[key].nudged_displacement_m,
            nudged_tilt_degrees=degrees(failing[key].nudged_tilt_radians),
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
        stable_nudged=None if any(c.is_stable_nudged is None for c in mujoco) else sum(bool(c.is_stable_nudged) for c in mujoco),
    )  # fmt: skip


@pytest.mark.whole
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


@pytest.mark.whole
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


@quick
@given(rows=physics())
def test_assets_whose_colliders_fill_openings_or_leave_parts_out(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    over: dict[str, list[Placement]] = defaultdict(list)
    for row in of(rows, Placement):
        if row.collider_early_share is not None and max(row.collider_early_share, row.collider_miss_share) > 0.02:
            over[row.asset_id].append(row)
    answer = by_key(database.ask("collider_fit"), "asset_id")
    assert answer.keys() == over.keys()
    for asset, row in answer.items():
        same(
            row, objects=len(over[asset]), early_share=max(p.collider_early_share for p in over[asset]),
            miss_share=max(p.collider_miss_share for p in over[asset]), pieces=7, faces=84,
        )  # fmt: skip
