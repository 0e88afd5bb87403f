"""The benchmark of storeys: scores against houses whose truth is known or wrong, and a small run of it."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench.capture.houses import NOBODYS, House, made_house, scored
from flows.commands.bench import command
from tests.tasks.capture.storeys.houses import house_of, mezzanine


def known(storeys: int) -> House:
    """A house of plates as the benchmark has its own."""
    house = house_of(storeys, (7.0, 9.0), 2.5, 0.3)
    owner = house.storey[house.surface.faces[:, 0]]
    is_stair = np.array([label == "stairs" for label in house.labels])[house.instance[house.surface.faces[:, 0]]]
    middles = np.array([(low + high) / 2 for low, high in house.slabs])
    return House("plates", house.surface, np.where(is_stair, NOBODYS, owner), middles, np.full(storeys - 1, 0.3))


@pytest.mark.parametrize("storeys", [1, 2, 3])
def test_a_house_that_is_divided_right_has_full_marks(storeys: int) -> None:
    score = scored(known(storeys))
    assert (score.storeys, score.counted) == (storeys, storeys)
    assert score.off_m == pytest.approx(0.0, abs=0.02)
    assert score.beside_m == 0.0
    assert score.lost < 1e-9
    assert score.misplaced == 0.0


def test_what_is_wrong_is_seen() -> None:
    house = known(2)
    raised = scored(dataclasses.replace(house, middles=house.middles + 0.5))
    assert raised.off_m == pytest.approx(0.5, abs=0.02)
    assert raised.beside_m == pytest.approx(0.35, abs=0.02)
    swapped = scored(dataclasses.replace(house, storey=np.where(house.storey == NOBODYS, NOBODYS, 1 - house.storey)))
    assert swapped.misplaced > 0.9
    gallery = mezzanine((8.0, 9.0), 0.4, 2.6).surface
    wrong = scored(House("gallery", gallery, np.zeros(len(gallery.faces), np.int64), np.array([2.5]), np.array([0.3])))
    assert (wrong.storeys, wrong.counted, wrong.off_m, wrong.beside_m) == (2, 1, None, None)


@pytest.mark.slow
def test_a_house_is_a_function_of_its_seed_and_a_small_run_prints_its_figures(tmp_path: Path) -> None:
    first, again = (made_house(tmp_path / str(turn), 0, 5) for turn in (0, 1))
    assert first.surface.vertices.tobytes() == again.surface.vertices.tobytes()
    assert first.surface.faces.tobytes() == again.surface.faces.tobytes()
    done = CliRunner().invoke(command, ["capture", "--parts", "storeys", "--houses", "2", "--json"])
    report = json.loads(done.stdout)
    assert done.exit_code == 0, report["goals"]
    assert [(row["kind"], row["storeys"], row["right"]) for row in report["parts"]["storeys"]["rows"]] == [
        ("dwellings", 1, 1), ("dwellings", 2, 1),
    ]  # fmt: skip
