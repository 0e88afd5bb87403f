"""The model that ships is the benchmark's, and its card says what the benchmark found."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from bench.selection import shipping
from bench.selection.shipping import GROUPS, MODEL, measured, ship
from bench.selection.tables import CHOICES, SURFACES
from schemas.errors import InputError
from tasks.models import CARD

COLUMNS = (*CHOICES, *SURFACES)


def row(value: float) -> dict[str, Any]:
    return {"instances": 1200, "figures": {key: {"value": value} for key, *_ in COLUMNS[:-1]}}


def report(**training: Any) -> dict[str, Any]:
    return {
        "seed": 3,
        "counts": {"rooms": {"train": 8, "test": 2}, "instances": {"train": 2000, "test": 1200}, "held_out": {"train": 0, "test": 30}},
        "methods": {"extents": row(0.1), "geometric": row(0.4), MODEL: row(0.8), "blind": row(0.9)},
        "held_out_categories": {"extents": row(0.1), "geometric": row(0.3), MODEL: row(0.7)},
        "house": {},
        "naming": {"shares": {group: {"by_rules": {"value": 0.6}, "by_model": {"value": 0.2}} for group in ("all", "ruled")}},
        "trainings": [{"name": MODEL, "seed": 0, "model_id": "a" * 64, "bytes": 1000} | training],
    }


def test_the_card_holds_the_model_against_the_best_that_learns_nothing() -> None:
    lines = list(measured(report()))
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
    assert [cell[:3] for cell in cells[1:]] == [
        [GROUPS[group], name, "1,200"] for group in ("methods", "held_out_categories") for name in ("geometric", MODEL)
    ]
    for at, (_, _, times, digits) in enumerate(COLUMNS[:-1]):
        assert [cell[3 + at] for cell in cells[1:]] == [f"{times * value:.{digits}f}" for value in (0.4, 0.8, 0.3, 0.7)]
    assert {cell[-1] for cell in cells[1:]} == {"n/a"}
    assert {len(cell) for cell in cells} == {3 + len(COLUMNS)}
    text = "\n".join(lines)
    assert "2,000 instances of 8 generated rooms" in text
    assert "## Held against `geometric`" in text
    assert "names 20.0 % of the scans" in text


def test_the_card_of_what_ships_has_both_the_models_and_the_benchmarks_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def export(lake: Any, wanted: str, out: Path, force: bool) -> None:
        out.mkdir(parents=True)
        (out / CARD).write_text(f"# model {wanted}\n")

    monkeypatch.setattr(shipping, "export_model", export)
    place = ship(tmp_path / "selection", report(), tmp_path / "out")
    assert place == tmp_path / "out" / MODEL
    card = (place / CARD).read_text().splitlines()
    assert card == [f"# model {'a' * 64}", *measured(report())]


@pytest.mark.parametrize(
    ("training", "problem"),
    [({"name": "blind"}, "has no model"), ({"seed": 1}, "has no model"), ({"bytes": 5_000_001}, "too many to ship")],
)
def test_what_cannot_ship_is_refused(training: dict[str, Any], problem: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shipping, "export_model", pytest.fail)
    with pytest.raises(InputError, match=problem):
        ship(tmp_path, report(**training), tmp_path / "out")
    assert not (tmp_path / "out").exists()
