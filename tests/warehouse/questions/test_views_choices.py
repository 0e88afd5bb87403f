"""What people chose, beside what selection proposed and beside each other, each view against a computation of its own in plain Python."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.annotation import Annotation, QualityReview
from schemas.candidates import Asset, Candidate
from schemas.capture import Instance, Scene
from schemas.navigation import Split
from schemas.selection import Selection
from tasks.geometry.transforms import flat, rotation_vector, yaw_pose
from tests.samples import sample
from tests.warehouse.questions.view_answers import ASSETS, Database, by_key, of, quick, same

SCENES, OBJECTS, NAMES = ("demo/a", "demo/b"), ("0000", "0001", "0002"), ("ada", "bob", "cleo")
PROVIDERS = dict(zip(ASSETS, ("procedural", "library", "library"), strict=True))
VOLUMES = {"small": 0.005, "medium": 0.1, "large": 0.5}


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


@st.composite
def chosen(draw: st.DrawFn) -> list[Any]:
    """Objects with candidates in an order, and accepted answers of three people."""
    rows: list[Any] = [sample(QualityReview, batch_id="b", verdict="accepted", wrong=0)]
    rows += [sample(Scene, scene_id=scene, room_id=scene) for scene in SCENES] + [sample(Split, room_id=SCENES[0], split="train")]
    rows += [sample(Asset, asset_id=asset, category="Chair", extents=(1.0, 1.0, 1.0)) for asset in ASSETS]
    for scene, name in itertools.product(SCENES, OBJECTS):
        place = {"scene_id": scene, "instance_id": name}
        size = draw(st.sampled_from(sorted(VOLUMES)))
        category = draw(st.sampled_from(["chair", "mug"]))
        rows.append(sample(Instance, **place, category=category, is_structure=False, box_volume_m3=VOLUMES[size]))
        order = draw(st.permutations(ASSETS))[: draw(st.integers(0, 3))]
        for rank, asset in enumerate(order, 1):
            named = {"asset_id": asset, "slot": rank}
            pose = flat(yaw_pose(0.25 * rank, [rank, 0.0, 0.0]))
            rows.append(sample(Selection, **place, **named, rank=rank, pose=pose, scale=(1.0, 1.0, 2.0), score=0.5))
            rows.append(sample(Candidate, **place, **named, provider=PROVIDERS[asset], outcome="filled"))
        for who in draw(st.lists(st.sampled_from(NAMES), unique=True)):
            choice = draw(st.sampled_from([None, *ASSETS]))
            ranking = tuple(draw(st.permutations(ASSETS))[: draw(st.integers(0, 3))])
            ranking = tuple(asset for asset in ranking if asset != choice)
            moved = choice is not None and draw(st.booleans())
            pose = flat(yaw_pose(draw(st.sampled_from([0.0, 1.0, 3.0])), [draw(st.integers(0, 3)), 1.0, 0.5])) if moved else None
            scale = (1.0, draw(st.sampled_from([1.0, 2.0])), 1.0) if moved else None
            rows.append(sample(Annotation, **place, batch_id="b", annotator=who, choice=choice, ranking=ranking, pose=pose, scale=scale))
    return rows


def orders(rows: list[Any]) -> dict[tuple[str, str, str], list[str]]:
    return {
        (row.scene_id, row.instance_id, row.annotator): [*([row.choice] if row.choice else []), *row.ranking]
        for row in of(rows, Annotation)
    }


@pytest.mark.whole
@quick
@given(rows=chosen())
def test_distances_turns_and_sizes_of_what_two_put_in_a_place(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    aligned = {(row.scene_id, row.instance_id, row.asset_id): row for row in of(rows, Selection)}
    placed: dict[str, dict[tuple[str, str, str], tuple[np.ndarray, float]]] = defaultdict(dict)
    for row in of(rows, Annotation):
        own = aligned.get((row.scene_id, row.instance_id, row.choice))
        pose, scale = row.pose or (own.pose if own else None), row.scale or (own.scale if own else None)
        if row.choice is not None and pose is not None and scale is not None:
            placed[row.annotator][row.scene_id, row.instance_id, row.choice] = (np.array(pose).reshape(4, 4), math.prod(scale))
    answer = by_key(database.ask("annotator_pose_agreement"), "annotator_a", "annotator_b")
    expected = {(a, b): sorted(placed[a].keys() & placed[b].keys()) for a, b in itertools.combinations(NAMES, 2)}
    assert answer.keys() == {pair for pair, keys in expected.items() if keys}
    for (a, b), row in answer.items():
        both = [(placed[a][key], placed[b][key]) for key in expected[a, b]]
        apart = [float(np.linalg.norm(first[:3, 3] - second[:3, 3])) for (first, _), (second, _) in both]
        turns = [float(np.linalg.norm(rotation_vector(first[:3, :3].T @ second[:3, :3]))) for (first, _), (second, _) in both]
        ratios = [max(one / other, other / one) for (_, one), (_, other) in both]
        assert row["instances"] == len(both)
        assert row["median_distance_m"] == pytest.approx(np.quantile(apart, 0.5))
        assert row["p90_distance_m"] == pytest.approx(np.quantile(apart, 0.9))
        assert row["median_turn_degrees"] == pytest.approx(math.degrees(np.quantile(turns, 0.5)), abs=1e-4)
        assert row["p90_turn_degrees"] == pytest.approx(math.degrees(np.quantile(turns, 0.9)), abs=1e-4)
        assert row["median_size_ratio"] == pytest.approx(np.quantile(ratios, 0.5))


@pytest.mark.whole
@quick
@given(rows=chosen())
def test_pairs_of_candidates_in_one_order(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    ranked = orders(rows)
    answer = by_key(database.ask("annotator_rank_agreement"), "annotator_a", "annotator_b")
    for a, b in itertools.combinations(NAMES, 2):
        alike, pairs, places = 0, 0, set()
        for scene, name in itertools.product(SCENES, OBJECTS):
            first, second = ranked.get((scene, name, a), []), ranked.get((scene, name, b), [])
            for x, y in itertools.combinations(sorted(set(first) & set(second)), 2):
                pairs += 1
                alike += (first.index(x) < first.index(y)) == (second.index(x) < second.index(y))
                places.add((scene, name))
        if pairs:
            same(answer[a, b], instances=len(places), pairs=pairs, alike=alike, kendalls_tau=(2 * alike - pairs) / pairs)
        else:
            assert (a, b) not in answer


@pytest.mark.whole
@quick
@given(rows=chosen())
def test_where_selection_proposes_something_else(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    ranks = {(row.scene_id, row.instance_id, row.asset_id): row.rank for row in of(rows, Selection)}
    best = {(row.scene_id, row.instance_id): row.asset_id for row in of(rows, Selection) if row.rank == 1}
    objects = {(row.scene_id, row.instance_id): row for row in of(rows, Instance)}
    sizes = {volume: size for size, volume in VOLUMES.items()}
    groups: dict[tuple[str, str], list[Annotation]] = defaultdict(list)
    of_provider: dict[str, int] = defaultdict(int)
    for row in of(rows, Annotation):
        key = (row.scene_id, row.instance_id)
        if key in best:
            for group in (
                ("category", objects[key].category),
                ("provider", PROVIDERS[best[key]]),
                ("size", sizes[objects[key].box_volume_m3]),
            ):
                groups[group].append(row)
            if (*key, row.choice) in ranks:
                of_provider[PROVIDERS[row.choice]] += 1
    answer = by_key(database.ask("selection_against_people"), "dimension", "value")
    assert answer.keys() == groups.keys() | {("provider", provider) for provider in of_provider}
    for group, row in answer.items():
        given_rank = [ranks.get((one.scene_id, one.instance_id, one.choice)) for one in groups[group]]
        count = len(groups[group])
        none = sum(one.choice is None for one in groups[group])
        known = [rank for rank in given_rank if rank is not None]
        same(
            row, answers=count, none_fits=none, same=known.count(1), in_next_four=sum(1 < rank <= 5 for rank in known),
            elsewhere=count - none - len(known), mean_rank=sum(known) / len(known) if known else None,
            same_share=known.count(1) / count if count else None, none_fits_share=none / count if count else None,
            chosen_of_provider=of_provider[group[1]] if group[0] == "provider" else None,
        )  # fmt: skip


@pytest.mark.whole
@quick
@given(rows=chosen())
def test_training_data_has_every_candidate_with_its_labels(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    ranked, answers = orders(rows), {(row.scene_id, row.instance_id, row.annotator): row for row in of(rows, Annotation)}
    expected = {}
    for selection, key in itertools.product(of(rows, Selection), answers):
        if key[:2] == (selection.scene_id, selection.instance_id):
            order = ranked[key]
            expected[*key, selection.slot] = (
                selection.asset_id == answers[key].choice, order.index(selection.asset_id) + 1 if selection.asset_id in order else None,
                answers[key].choice is None, PROVIDERS[selection.asset_id], "train" if key[0] == SCENES[0] else None, selection.rank,
            )  # fmt: skip
    answer = by_key(database.ask("selection_training"), "scene_id", "instance_id", "annotator", "slot")
    facts = ("is_chosen", "people_rank", "has_no_choice", "provider", "split", "rank")
    assert {key: tuple(row[name] for name in facts) for key, row in answer.items()} == expected
    objects = {(row.scene_id, row.instance_id): row for row in of(rows, Instance)}
    for row in answer.values():
        one = objects[row["scene_id"], row["instance_id"]]
        assert row["is_category_match"] == (one.category == "chair")
        assert row["size_ratio"] == pytest.approx(2.0 / one.box_volume_m3)
