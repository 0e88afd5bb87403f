"""What looks alike: who stands for whom, and that all of a look are offered what was made for one of them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from schemas.captions import Caption
from schemas.capture import Instance
from tasks import candidates
from tasks.candidates.assets import MadeAsset
from tasks.candidates.looks import exemplars
from tasks.candidates.procedural import Procedural, procedural_asset
from tasks.candidates.provider import CandidateProvider, ProviderConfig
from tasks.candidates.providers import provider_of
from tasks.candidates.request import CandidateRequest
from tasks.furniture import generate
from tasks.geometry.transforms import flat, yaw_pose
from tests.samples import sample
from tests.tasks.candidates.crops import candidates_of, scanned

CHAIR = (0.45, 0.5, 0.95)
SIDES = st.tuples(*[st.floats(0.05, 2.0)] * 3)


def box(number: int, size: tuple[float, ...], category: str = "chair", hidden: tuple[float, ...] | None = None) -> Instance:
    return sample(
        Instance, instance_id=f"{number:04d}", category=category, is_structure=False, box_pose=flat(yaw_pose(0.3 * number)), box_size=size,
        hidden_m=hidden,
    )  # fmt: skip


def colored(number: int, word: str) -> Caption:
    return sample(Caption, instance_id=f"{number:04d}", colors=(word,))


def test_chairs_of_one_size_are_one_look_and_one_of_which_less_was_seen_too() -> None:
    rows = [
        box(1, CHAIR), box(2, (0.47, 0.48, 0.93)), box(3, (0.2, 0.5, 0.95)), box(4, (0.45, 0.5, 1.3)), box(5, CHAIR, "stool"),
        box(6, (0.45, 0.5, 0.5), hidden=(0.0, 0.0, 0.0, 0.0, 0.45, 0.0)),
    ]  # fmt: skip
    assert exemplars(rows, {}) == dict.fromkeys(("0001", "0002", "0003", "0006"), "0001"), "turned, part seen, its legs inferred"
    painted = {row.instance_id: colored(int(row.instance_id), "red" if row.instance_id == "0002" else "blue") for row in rows}
    assert exemplars(rows, painted) == dict.fromkeys(("0001", "0003", "0006"), "0001")


@given(sizes=st.lists(SIDES, max_size=8), words=st.lists(st.sampled_from(["red", "blue"]), min_size=8, max_size=8))
@settings(deadline=None)
def test_looks_part_the_instances_whatever_their_order(sizes: list[tuple[float, ...]], words: list[str]) -> None:
    rows = [box(i, size, ("chair", "table")[i % 2]) for i, size in enumerate(sizes)]
    captions = {row.instance_id: colored(i, words[i]) for i, row in enumerate(rows)}
    looks = exemplars(rows, captions)
    assert exemplars(rows[::-1], captions) == looks
    by_id = {row.instance_id: row for row in rows}
    for name, lender in looks.items():
        assert looks[lender] == lender
        assert by_id[name].category == by_id[lender].category
        assert captions[name].colors == captions[lender].colors
        part, whole = np.sort(by_id[name].box_size), np.sort(by_id[lender].box_size)
        assert (part <= whole * 1.12).all(), "nothing stands for what is larger"
    assert all(sum(other == lender for other in looks.values()) >= 2 for lender in looks.values())


def test_what_is_made_for_one_chair_is_offered_to_all_that_look_like_it() -> None:
    parts = generate("chair", CHAIR, np.random.default_rng(5)).parts
    first, second, odd = (scanned(i, "chair", parts, 0.4 * i) for i in (1, 2, 3))
    odd = (dataclasses.replace(odd[0], category="stool"), odd[1])
    alone = {row.instance_id: row for row in candidates_of(second).rows["candidates"] if row.slot == 1}
    rows = candidates_of(first, second, odd).rows["candidates"]
    slots = {(row.instance_id, row.slot): row for row in rows}
    assert len(slots) == 30
    for slot in (1, 2, 3):
        assert slots["0002", slot].asset_id == slots["0001", slot].asset_id
        assert slots["0003", slot].asset_id != slots["0001", slot].asset_id
    assert alone["0002"].asset_id != slots["0002", 1].asset_id, "alone it is its own look"
    template = slots["0001", 4]
    assert (template.provider, template.outcome) == ("parametric", "filled")
    lent = [row for row in rows if row.instance_id == "0002" and row.asset_id == template.asset_id]
    assert [(row.slot, row.provider, row.is_fallback) for row in lent] == [(10, "parametric", True)]
    assert (lent[0].reason or "").startswith("fitted to 0001, which looks like it; ")
    assert slots["0002", 4].asset_id != template.asset_id, "its own fit stays"


def test_what_several_share_is_drawn_once(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[tuple[str, ProviderConfig]] = []

    def counted(config: ProviderConfig) -> CandidateProvider:
        family = provider_of(config)
        if config.kind != Procedural.kind:
            return family

        def offer(request: CandidateRequest, provider: Procedural) -> MadeAsset:
            drawn.append((request.instance.instance_id, provider))
            return procedural_asset(request, provider)

        return dataclasses.replace(family, offer=offer)

    monkeypatch.setattr(candidates, "provider_of", counted)
    parts = generate("chair", CHAIR, np.random.default_rng(5)).parts
    rows = candidates_of(*(scanned(number, "chair", parts, 0.4 * number) for number in (1, 2))).rows["candidates"]
    assert len(drawn) == len(set(drawn))
    assert {name for name, _ in drawn} == {"0001"}
    assert sum(row.provider == "procedural" for row in rows) > len(drawn)
