"""The policy that ships is the benchmark's agent of the first seed, and its card says what the benchmark found."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from bench.policy import shipping
from bench.policy.shipping import FIGURES, LIMITS, NAME, SENSES, measured, ship
from schemas.errors import InputError
from tasks.models import CARD, identity_json
from tasks.training.systems.navigation import preset
from tests.samples import fingerprint, stage_run
from warehouse.lake import Lake


def row(value: float) -> dict[str, Any]:
    interval = {"low": value - 0.1, "high": value + 0.1}
    return {"seeds": 3, "n": 2250, "found_interval": interval, "found_in_view_interval": None} | dict.fromkeys(FIGURES, value)


def report(*agents: str, **training: Any) -> dict[str, Any]:
    loop = {
        "rooms": {"train": 60, "test": 15}, "episodes": {"train": 5900, "test": 750}, "lake": "nowhere",
        "figures": {name: row(0.1 * number) for number, name in enumerate(("random", "blind", *agents), start=1)},
        "trainings": [
            {"name": name, "seed": seed, "model_id": f"{name}-{seed}"} | training for name in ("blind", *agents) for seed in (1, 0)
        ],
    }  # fmt: skip
    return {"seed": 7, "parts": {"loop": loop}}


def with_lake(folder: Path, told: dict[str, Any]) -> dict[str, Any]:
    """A report of a lake that is there."""
    lake = Lake.open(folder / "lake")
    run = stage_run("bench/room_0000", "capture", fingerprint(0))
    lake.stage_rows(dataclasses.replace(run, outcome="failed", error="a", error_kind="input"))
    told["parts"].get("loop", {})["lake"] = lake.address
    return told


@pytest.fixture
def exported(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """Lakes and models that were exported. The weights of a model called `large` are by a byte."""
    made: list[tuple[str, str]] = []

    def find(reader: Any, wanted: str) -> tuple[Any, str]:
        config = identity_json(preset("sensing" if "dagger" in wanted else "small"))
        return SimpleNamespace(model_id=wanted, config=config, weights_bytes=5_000_000 + wanted.startswith("large")), ""

    def export(lake: Any, wanted: str, out: Path, force: bool) -> None:
        made.append((lake.address, wanted))
        out.mkdir(parents=True)
        (out / CARD).write_text(f"# model {wanted}\n")

    monkeypatch.setattr(shipping, "found_model", find)
    monkeypatch.setattr(shipping, "export_model", export)
    return made


@pytest.mark.parametrize(("agents", "ships"), [(("small", "dagger"), "dagger-0"), (("small",), "small-0")])
def test_the_corrected_one_ships_and_else_the_plain_one(
    agents: tuple[str, ...], ships: str, exported: list[tuple[str, str]], tmp_path: Path
) -> None:
    told = with_lake(tmp_path, report(*agents)) | {"seed": 3}
    place = ship(told, tmp_path / "out")
    assert place == tmp_path / "out" / NAME
    assert exported == [(str(tmp_path / "lake"), ships)]
    lines = measured(3, told["parts"]["loop"], agents[-1], senses=agents[-1] == "dagger")
    assert (place / CARD).read_text().splitlines() == [f"# model {ships}", *lines]


def test_the_card_has_who_acted_beside_it() -> None:
    lines = list(measured(7, report("small", "dagger")["parts"]["loop"], "dagger", senses=True))
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| ")]
    assert [cell[0] for cell in cells] == ["who", "random", "blind", "small", "**dagger**, this one is of seed 0"]
    assert {len(cell) for cell in cells} == {3 + len(FIGURES)}
    assert cells[2][1:6] == ["3", "2,250", "20.0 (10.0-30.0)", "20.0", "20.0"]
    assert "5,900 episodes of 60 generated rooms" in "\n".join(lines)
    assert lines[-len(LIMITS) - 1 :] == [f"- {line}" for line in (SENSES, *LIMITS)]
    assert f"- {SENSES}" not in [*measured(7, report("small")["parts"]["loop"], "small", senses=False)]


def test_a_figure_that_is_missing_is_said_to_be() -> None:
    loop = report("small")["parts"]["loop"]
    loop["figures"]["small"]["found_in_view"] = None
    assert sum("| n/a |" in line for line in measured(7, loop, "small", senses=False)) == 1


@pytest.mark.parametrize(
    ("told", "problem"),
    [
        (report(), "has no agent of seed 0"),
        ({"seed": 7, "parts": {"frames": {}}}, "has no agent of seed 0"),
        (report("small", seed=1), "has no agent of seed 0"),
        (report("small", model_id="large"), "5,000,001 bytes are too many to ship"),
    ],
)
def test_what_cannot_ship_is_refused(told: dict[str, Any], problem: str, exported: list[tuple[str, str]], tmp_path: Path) -> None:
    with pytest.raises(InputError, match=problem):
        ship(with_lake(tmp_path, told), tmp_path / "out")
    assert exported == []
    assert not (tmp_path / "out").exists()


def test_a_lake_that_is_gone_is_said_to_be(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"lake: nowhere is gone; measure again"):
        ship(report("small"), tmp_path / "out")
