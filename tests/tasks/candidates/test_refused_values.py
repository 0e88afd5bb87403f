"""A value that a table refuses costs its slot, and the other slots of its scene are filled."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from tasks.candidates import scan_crop
from tests.tasks.candidates.crops import candidates_of, furniture


@pytest.mark.parametrize(("field", "value"), [("volume_m3", -1e-5), ("volume_m3", float("nan")), ("extents", (0.4, float("inf"), 0.5))])
def test_a_value_that_a_table_refuses_costs_its_slot(monkeypatch: pytest.MonkeyPatch, field: str, value: object) -> None:
    make = scan_crop.make_asset

    def broken(*parts: Any, **facts: Any) -> Any:
        made = make(*parts, **facts)
        changes: dict[str, Any] = {field: value, "is_watertight": False}
        return dataclasses.replace(made, asset=dataclasses.replace(made.asset, **changes))

    monkeypatch.setattr(scan_crop, "make_asset", broken)
    outcome = candidates_of(furniture(1, "stool", (0.4, 0.4, 0.5), 0.2))
    slots = {row.slot: row for row in outcome.rows["candidates"]}
    assert {slot for slot, row in slots.items() if row.outcome == "failed"} == {5, 6}
    assert {slots[slot].outcome for slot in (1, 2, 3, 4, 7, 8, 9, 10)} == {"filled"}
    assert field in (slots[5].reason or "")
    assert "Error" not in (slots[5].reason or "")
    assert sum(": slot 5 failed: " in note for note in outcome.degradations) == 1
