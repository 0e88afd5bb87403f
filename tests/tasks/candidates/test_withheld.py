"""Templates that furnish wild rooms are never offered where they are withheld."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from tasks import candidates
from tasks.candidates import CandidatesConfig
from tasks.candidates.parametric.forms import forms_of
from tasks.candidates.procedural import Procedural, procedural_asset
from tasks.candidates.provider import NothingToOffer
from tasks.candidates.request import CandidateRequest
from tasks.candidates.slots import SlotConfig
from tasks.furniture import generate
from tasks.stage import Context
from tests.tasks.candidates.test_parametric import request_of, seen_surface

SIZES = {"chair": (0.5, 0.5, 0.9), "sofa": (0.9, 2.0, 0.8), "table": (0.8, 1.4, 0.74), "cabinet": (0.4, 0.9, 0.9)}


def request(category: str, size: tuple[float, float, float]) -> CandidateRequest:
    x, y, z = size
    points = seen_surface([(-0.5 * x, -0.5 * y, 0.0, 0.5 * x, 0.5 * y, z)], np.random.default_rng(0), count=400)
    return dataclasses.replace(request_of(category, points, size), is_withholding=True)


@pytest.mark.parametrize("category", SIZES)
def test_the_generator_offers_its_other_half(category: str) -> None:
    size = SIZES[category]
    wild = {generate(category, size, np.random.default_rng(seed), half="withheld").name for seed in range(20)}
    names = {procedural_asset(request(category, size), Procedural(variant)).asset.name for variant in range(1, 8)}
    assert names
    assert not names & wild


def test_a_category_with_a_single_withheld_template_gets_nothing() -> None:
    with pytest.raises(NothingToOffer, match="only template of a guitar"):
        procedural_asset(request("guitar", (0.12, 0.38, 1.0)), Procedural(1))
    plain = dataclasses.replace(request("guitar", (0.12, 0.38, 1.0)), is_withholding=False)
    assert procedural_asset(plain, Procedural(1)).asset.category == "guitar"


@pytest.mark.parametrize(("category", "size"), [("sofa", (2.4, 2.8, 0.8)), ("table", (1.5, 1.6, 0.74)), ("chair", (0.5, 0.5, 0.9))])
def test_templates_fitted_to_points_are_withheld_too(category: str, size: tuple[float, float, float]) -> None:
    asked = request(category, size)
    points = np.zeros((1, 3))
    offered = {template.name for template, _ in forms_of(category, asked, points)}
    every = {template.name for template, _ in forms_of(category, dataclasses.replace(asked, is_withholding=False), points)}
    assert offered
    assert offered < every
    assert "U" not in offered


def test_the_setting_reaches_every_slot() -> None:
    asked = request("guitar", (0.12, 0.38, 1.0))
    context: Context = asked.context
    config = CandidatesConfig(slots=(SlotConfig(Procedural(1)), SlotConfig(Procedural(2))))
    for withheld in (False, True):
        done = candidates.run(
            instances=[asked.instance], frames=[], masks=[], captions=[], library=None, scan=None, context=context,
            config=dataclasses.replace(config, withheld=withheld),
        )  # fmt: skip
        outcomes = {row.outcome for row in done.rows["candidates"]}
        assert outcomes == ({"empty"} if withheld else {"filled"})
