"""The synthesis models inside the package: whole, free to use, and as good at what they were asked as their page says."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from schemas.files import read_file
from tasks.furniture import tops
from tasks.models import CARD, MOST_DOCUMENT_BYTES, ModelFolder
from tasks.synthesis.inference.drawer import Drawer, load
from tasks.synthesis.layout import Large
from tasks.synthesis.metrics.boxes import box_figures
from tasks.synthesis.metrics.distributions import category_shares, total_variation
from tasks.synthesis.model.config import MODELS, config_from
from tasks.synthesis.model.shapes import check_fit
from tasks.training.systems.synthesis import SYNTHESIS
from tasks.weights import from_safetensors

SHIPPED = SYNTHESIS.shipped()
KINDS = sorted(model.kind for model in MODELS)


def drawer_of(folder: ModelFolder) -> Drawer:
    return load(folder.model.weights, config_from(folder.model.config), folder.folder.name)


def test_a_model_of_every_kind_ships() -> None:
    assert sorted(SHIPPED) == KINDS
    kinds = {name: json.loads(folder.model.config)["model"]["kind"] for name, folder in SHIPPED.items()}
    assert kinds == {name: name for name in KINDS}


@pytest.mark.parametrize("name", KINDS)
def test_it_is_whole_small_and_free(name: str) -> None:
    folder = SHIPPED[name]
    check_fit(from_safetensors(folder.model.weights), config_from(folder.model.config), name)
    assert folder.document["license"] == "CC0-1.0"
    assert len(folder.model.weights) < 5_000_000
    card = read_file(Path(folder.folder) / CARD, CARD, MOST_DOCUMENT_BYTES).decode()
    assert folder.document["model_id"] in card
    assert "## Limits" in card


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize("name", KINDS)
def test_it_draws_what_the_rules_of_a_room_say(name: str) -> None:
    drawer, rng = drawer_of(SHIPPED[name]), np.random.default_rng(7)
    larges = {room: [Large("table", tops.typical_size("table", rng), room) for _ in range(48)] for room in ("office", "kitchen")}
    layouts = {room: drawer.draw(wanted, 11) for room, wanted in larges.items()}
    stated = {room: tops.stated_distribution("table", room) for room in larges}
    away = {(a, b): total_variation(stated[a], category_shares(layouts[b])) for a in larges for b in larges}
    # 48 layouts of the rules themselves lie some 0.05 from them
    assert max(away["office", "office"], away["kitchen", "kitchen"]) < 0.2
    assert min(away["office", "kitchen"], away["kitchen", "office"]) > 0.5
    if name == "physcene":
        figures = box_figures([layout for each in layouts.values() for layout in each])
        assert figures.collides < 0.02
        assert figures.off_support < 0.02
