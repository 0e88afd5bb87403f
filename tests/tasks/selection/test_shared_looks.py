"""One asset for what looks alike: who gets it, who keeps their own, and that nothing else changes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.selection import Selection
from tasks.geometry.transforms import yaw_pose
from tasks.selection import ScoreConfig, SelectionConfig
from tasks.selection.looks import shared
from tasks.selection.methods.extents import Extents
from tasks.selection.methods.model import ModelScores
from tests.samples import sample
from tests.tasks.selection.drawn import drawn_model
from tests.tasks.selection.rooms import RED, Room, cabinet, chair, scan

ASSETS = [f"{number:064x}" for number in range(5)]
SCORES = st.dictionaries(st.sampled_from(ASSETS), st.integers(0, 20).map(lambda score: score / 100), min_size=1)
LOSS = 0.02


def ranking(name: str, scores: dict[str, float]) -> list[Selection]:
    ordered = sorted(scores.items(), key=lambda pair: (-pair[1], pair[0]))
    return [
        sample(Selection, instance_id=name, rank=rank, slot=rank, asset_id=asset, score=score, look=None)
        for rank, (asset, score) in enumerate(ordered, start=1)
    ]


@given(tables=st.lists(SCORES, max_size=6))
def test_an_asset_is_shared_by_those_that_lose_little_by_it(tables: list[dict[str, float]]) -> None:
    rankings = {f"{i:04d}": ranking(f"{i:04d}", scores) for i, scores in enumerate(tables)}
    categories = {name: ("chair", "table")[int(name) % 3 == 0] for name in rankings}
    made = shared(rankings, categories, LOSS)
    assert list(made) == list(rankings)
    looks: dict[str | None, list[str]] = {}
    for name, rows in made.items():
        assert [row.rank for row in rows] == list(range(1, len(rows) + 1))
        plain = sorted((dataclasses.replace(row, rank=1, look=None) for row in rows), key=lambda row: row.slot)
        assert plain == [dataclasses.replace(row, rank=1) for row in rankings[name]], "rows change in rank and look alone"
        assert [row.slot for row in rows[1:]] == [row.slot for row in rankings[name] if row.slot != rows[0].slot]
        assert len({row.look for row in rows}) == 1
        assert rankings[name][0].score - rows[0].score <= LOSS + 1e-9
        looks.setdefault(rows[0].look, []).append(name)
    alone = looks.pop(None, [])
    assert all(made[name] == rankings[name] for name in alone)
    for look, names in looks.items():
        assert look == min(names)
        assert len(names) >= 2
        assert len({(made[name][0].asset_id, categories[name]) for name in names}) == 1
    for asset in ASSETS:  # nobody is left out who could share
        for category in ("chair", "table"):
            could = [
                name for name in alone
                if categories[name] == category
                and any(row.asset_id == asset and rankings[name][0].score - row.score <= LOSS for row in rankings[name])
            ]  # fmt: skip
            assert len(could) < 2


def test_what_has_no_category_shares_nothing() -> None:
    rankings = {name: ranking(name, {ASSETS[0]: 0.5}) for name in ("0001", "0002")}
    assert shared(rankings, dict.fromkeys(rankings, ""), LOSS) == rankings
    assert {rows[0].look for rows in shared(rankings, dict.fromkeys(rankings, "mug"), LOSS).values()} == {"0001"}


@pytest.fixture(scope="module")
def chairs() -> Room:
    """Two red chairs, each with three candidates that differ by a millimeter, the best of each another one."""
    room = Room()
    names = [room.asset([mesh.copy().apply_scale(1 + 0.002 * k) for mesh in chair(RED)], f"chair {k}") for k in range(3)]
    for number, order in enumerate(((0, 1, 2), (2, 1, 0))):
        scale = (1 + 0.004 * number,) * 3
        instance = room.instance(*scan(chair(RED), yaw_pose(0.4), scale, np.random.default_rng(number)), 0.4, category="chair")
        for slot, k in enumerate(order, start=1):
            room.candidate(instance, slot, names[k])
        room.candidate(instance, 4, room.asset(cabinet(), "cabinet"))
    return room


def test_scores_of_fit_alone_are_near_enough_for_one_asset(chairs: Room) -> None:
    """All lie within the loss here: of geometric scores, and those near to them, alone that says something."""
    plain, _ = chairs.select()
    assert {row.look for row in plain} == {"0000"}
    assert len({row.asset_id for row in plain if row.rank == 1}) == 1
    model = drawn_model()
    near, _ = chairs.select(SelectionConfig(provider=ModelScores(within=LOSS)), model=model)
    assert {(row.provider, row.look) for row in near} == {("model", "0000")}
    assert len({row.asset_id for row in near if row.rank == 1}) == 1
    for provider, scorer in ((Extents(), None), (ModelScores(within=0.2), model), (ModelScores(within=1.0), model)):
        rows, _ = chairs.select(SelectionConfig(provider=provider, score=ScoreConfig(look_loss=1.0)), model=scorer)
        assert {row.look for row in rows} == {None}
        assert rows == sorted(rows, key=lambda row: (row.instance_id, -round(row.score, 9), row.slot))
