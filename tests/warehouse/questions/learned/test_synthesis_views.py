"""The views over scenes that models drew, each against plain Python over made-up rows."""

from __future__ import annotations

import math
import statistics
from collections import Counter, defaultdict
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.micro_scenes import MicroScene, MicroSceneObject
from schemas.optimization import Certificate, Contact, Placement
from schemas.synthesis import Synthesis, SynthesisObject
from schemas.training import LearnedModel, ModelEvaluation
from tasks.synthesis.layout import Large, Layout
from tasks.synthesis.metrics.distributions import category_kl
from tests.samples import fingerprint, sample
from tests.warehouse.questions.view_answers import EXACT, Database, by_key, of, quick, same

LARGE = ("desk", "shelf", "table")
SMALL = ("book", "kettle", "monitor", "mug")
MODELS = tuple((fingerprint("model", name), kind) for name, kind in (("a", "atiss"), ("b", "diffusion")))
BOXES = ((0.5, 1.0, 0.75), (0.5, 1.5, 0.75))


few = settings(quick, max_examples=12)


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


def micro_scene(scene: str, large_id: str, category: str, small: Sequence[str]) -> list[Any]:
    """Rows of a micro-scene with these small categories, whose ids follow that of the large object."""
    objects = [
        sample(MicroSceneObject, scene_id=scene, large_id=large_id, instance_id=f"{int(large_id) + at:04d}", category=name)
        for at, name in enumerate(small, 1)
    ]
    return [sample(MicroScene, scene_id=scene, instance_id=large_id, category=category, object_count=len(small)), *objects]


@st.composite
def drawn_scenes(draw: st.DrawFn) -> list[Any]:
    """Scenes that models drew, with what became of their objects, among micro-scenes of scans."""
    rows: list[Any] = []
    for number in range(draw(st.integers(0, 4))):
        small = draw(st.lists(st.sampled_from(SMALL), min_size=1, max_size=4))
        rows += micro_scene(f"demo/{number}", "0001", draw(st.sampled_from(LARGE)), small)
    for number in range(draw(st.integers(0, 7))):
        scene = f"{draw(st.sampled_from(['drawn', 'more']))}/{number}"
        model_id, kind = draw(st.sampled_from(MODELS))
        names = draw(st.lists(st.sampled_from(SMALL), max_size=5))
        counts = [draw(st.integers(0, len(names))) for _ in range(2)]
        rows.append(
            sample(
                Synthesis, scene_id=scene, model_id=model_id, model_kind=kind, instance_id="0000", category=draw(st.sampled_from(LARGE)),
                box_size=draw(st.sampled_from(BOXES)), room_type=draw(st.sampled_from(["kitchen", "office"])), seed=0, number=number,
                object_count=len(names), colliding_count=counts[0], off_support_count=counts[1], seconds=draw(EXACT),
            )
        )  # fmt: skip
        if draw(st.booleans()) and names:
            rows += micro_scene(scene, "0000", rows[-1].category, names)  # which must count for nothing
        ids = [f"{at:04d}" for at in range(1, len(names) + 1)]
        for instance_id, name in zip(ids, names, strict=True):
            stable = draw(st.sampled_from((None, False, True, True)))
            rows.append(sample(SynthesisObject, scene_id=scene, instance_id=instance_id, category=name, is_stable=stable))
        for instance_id in ("0000", *ids):
            if draw(st.sampled_from([False, True, True])):
                rows.append(sample(Placement, scene_id=scene, instance_id=instance_id, displacement_m=draw(EXACT), lift_m=draw(EXACT)))
                for engine in draw(st.sets(st.sampled_from(["mujoco", "newton"]))):
                    stable = draw(st.sampled_from([False, True, True, True]))
                    rows.append(sample(Certificate, scene_id=scene, instance_id=instance_id, engine=engine, is_stable_1cm=stable))
        pairs = [(a, b) for a in ("0000", *ids) for b in (*ids, "floor") if a < b]
        for a, b in draw(st.lists(st.sampled_from(pairs), unique=True, max_size=4)):
            phase, depth = draw(st.sampled_from(["proposed", "optimized"])), draw(st.sampled_from([0.0, 0.004, 0.006]))
            rows.append(sample(Contact, scene_id=scene, instance_a=a, body_b=b, phase=phase, penetration_m=depth))
    return rows


def divergence(rows: Sequence[Any], asked: Sequence[Synthesis]) -> float | None:
    """CKL [nat] of the drawn scenes: each takes the mean counts of the scanned micro-scenes of its large category for the truth."""
    made = {row.scene_id for row in of(rows, Synthesis)}
    small: dict[tuple[str, str], list[str]] = defaultdict(list)
    for row in of(rows, MicroSceneObject):
        small[row.scene_id, row.large_id].append(row.category)
    scanned: dict[str, list[list[str]]] = defaultdict(list)
    for row in of(rows, MicroScene):
        if row.scene_id not in made:
            scanned[row.category].append(small[row.scene_id, row.instance_id])
    expected: Counter[str] = Counter()
    drawn: Counter[str] = Counter()
    for scene in asked:
        for names in scanned[scene.category]:
            for name in names:
                expected[name] += 1 / len(scanned[scene.category])  # type: ignore[assignment]
        if scanned[scene.category]:
            drawn.update(row.category for row in of(rows, SynthesisObject) if row.scene_id == scene.scene_id)
    if not expected or not drawn:
        return None
    p = {name: value / sum(expected.values()) for name, value in expected.items()}
    q = {name: drawn[name] / sum(drawn.values()) for name in p}
    return sum(p[name] * (math.log(p[name] + 1e-6) - math.log(q[name] + 1e-6)) for name in p)


@given(rows=drawn_scenes())
@few
def test_figures_are_those_of_each_models_scenes(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    groups: dict[tuple[str, str, str], list[Synthesis]] = defaultdict(list)
    for row in of(rows, Synthesis):
        groups[row.model_id, row.model_kind, row.scene_id.split("/")[0]].append(row)
    found = by_key(database.ask("synthesis_figures"), "model_id", "model_kind", "dataset")
    assert found.keys() == groups.keys()
    placed = {(row.scene_id, row.instance_id): row for row in of(rows, Placement)}
    certified = {(row.scene_id, row.instance_id): row.is_stable_1cm for row in of(rows, Certificate) if row.engine == "mujoco"}
    for key, asked in groups.items():
        by_scene = {scene.scene_id: [row for row in of(rows, SynthesisObject) if row.scene_id == scene.scene_id] for scene in asked}
        keys = [(row.scene_id, row.instance_id) for objects in by_scene.values() for row in objects]
        deep = {
            (row.scene_id, body)
            for row in of(rows, Contact)
            for body in (row.instance_a, row.body_b)
            if row.phase == "proposed" and row.penetration_m > 0.005
            if {(row.scene_id, row.instance_a), (row.scene_id, row.body_b)} <= {*keys}
        }  # fmt: skip
        filled = [objects for objects in by_scene.values() if objects]
        moves = [math.hypot(placed[one].displacement_m, placed[one].lift_m) for one in keys if one in placed]
        stable_after = [[certified.get((row.scene_id, row.instance_id), False) for row in objects] for objects in filled]
        stable_before = [[bool(row.is_stable) for row in objects] for objects in filled]
        same(
            found[key], scenes=len(asked), objects=len(keys), objects_per_scene=len(keys) / len(asked),
            colliding_share=mean([scene.colliding_count for scene in asked], len(keys)),
            colliding_scene_share=mean([scene.colliding_count > 0 for scene in asked], len(asked)),
            off_support_share=mean([scene.off_support_count for scene in asked], len(keys)),
            off_support_scene_share=mean([scene.off_support_count > 0 for scene in asked], len(asked)),
            placed_share=mean([one in placed for one in keys], len(keys)),
            placed_colliding_share=mean([one in deep for one in keys], len(moves)),
            drawn_stable_share=mean([flag for flags in stable_before for flag in flags], len(keys)),
            drawn_stable_scene_share=mean([all(flags) for flags in stable_before], len(filled)),
            settled_stable_share=mean([flag for flags in stable_after for flag in flags], len(keys)),
            settled_stable_scene_share=mean([all(flags) for flags in stable_after], len(filled)),
            median_move_m=float(np.quantile(moves, 0.5)) if moves else None,
            p95_move_m=float(np.quantile(moves, 0.95)) if moves else None,
            seconds_per_scene=statistics.fmean(scene.seconds for scene in asked),
        )  # fmt: skip
        assert found[key]["category_kl"] == pytest.approx(divergence(rows, asked), abs=1e-9)


def mean(values: Sequence[float], count: int) -> float | None:
    return sum(values) / count if count else None


def test_divergence_of_one_scene_on_each_large_object_is_that_of_the_layouts(database: Database) -> None:
    """The figure of the lake and that of evaluations are one where every scanned micro-scene is drawn anew once."""
    truth = [("desk", ("monitor", "mug", "mug")), ("desk", ("book",)), ("table", ("kettle", "mug"))]
    drawn = [("desk", ("mug", "mug", "book", "book")), ("desk", ("monitor",)), ("table", ())]
    rows: list[Any] = []
    for number, (category, names) in enumerate(truth):
        rows += micro_scene(f"demo/{number}", "0000", category, names)
    for number, (category, names) in enumerate(drawn):
        scene = f"drawn/{number}"
        rows.append(
            sample(Synthesis, scene_id=scene, model_id=MODELS[0][0], model_kind="atiss", category=category, object_count=len(names))
        )
        rows += [sample(SynthesisObject, scene_id=scene, instance_id=f"{at:04d}", category=name) for at, name in enumerate(names, 1)]
        rows += micro_scene(scene, "0000", category, names) if names else []
    database.fill(*rows)
    (found,) = database.ask("synthesis_figures")
    assert found["category_kl"] == pytest.approx(category_kl(*([layout(*one) for one in part] for part in (truth, drawn))), rel=1e-9)
    assert found["category_kl"] > 1.0  # kettles are never drawn


def layout(category: str, names: Sequence[str]) -> Layout:
    count = len(names)
    return Layout(Large(category, (0.5, 1.0, 0.75)), tuple(names), np.zeros((count, 3)), np.ones((count, 3)), np.zeros(count))


@given(rows=drawn_scenes())
@few
def test_layouts_hold_every_drawn_object_and_every_empty_scene_once(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    answer = database.ask("synthesis_layouts")
    alike = Counter((row.model_id, row.category, row.room_type, row.box_size) for row in of(rows, Synthesis))
    asked = {row.scene_id: row for row in of(rows, Synthesis)}
    filled = {row.scene_id for row in of(rows, SynthesisObject)}
    keys = {(row.scene_id, row.instance_id): row.category for row in of(rows, SynthesisObject)}
    keys |= {(scene, None): None for scene in asked.keys() - filled}
    found = by_key(answer, "scene_id", "instance_id")
    assert {key: row["category"] for key, row in found.items()} == keys
    for (scene, _), row in found.items():
        large = asked[scene]
        same(row, large_category=large.category, room_type=large.room_type, model_kind=large.model_kind)
        assert row["large_box_size"] == list(large.box_size)
        assert row["alike_scenes"] == alike[large.model_id, large.category, large.room_type, large.box_size]
    assert [row["alike_scenes"] for row in answer] == sorted((row["alike_scenes"] for row in answer), reverse=True)


def test_evaluations_are_those_of_trainings_of_synthesis_models(database: Database) -> None:
    models = [
        sample(LearnedModel, model_id=fingerprint(name), training_id=training, kind=kind, architecture="diffusion", is_withdrawn=is_gone)
        for name, training, kind, is_gone in (
            ("a", "good", "synthesis", False), ("b", "gone", "synthesis", True), ("c", "choice", "selection", False)
        )
    ]  # fmt: skip
    figures = [
        sample(ModelEvaluation, training_id=training, model_id=model and fingerprint(model), method=method, metric="ckl", value=0.25)
        for training, model, method in (
            ("good", "a", "synthesis"), ("good", None, "independent_draws"), ("gone", "b", "synthesis"), ("choice", "c", "selection"),
            ("choice", None, "chance"),
        )
    ]  # fmt: skip
    database.fill(*models, *figures)
    found = {(row["training_id"], row["method"]): row for row in database.ask("synthesis_evaluations")}
    assert found.keys() == {("good", "synthesis"), ("good", "independent_draws")}
    assert [found["good", name]["architecture"] for name in ("synthesis", "independent_draws")] == ["diffusion", None]
    assert {row["value"] for row in found.values()} == {0.25}
