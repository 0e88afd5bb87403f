"""A value that a table refuses costs its slot, and the other slots of its scene are filled."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from tasks import candidates
from tasks.candidates import scan_crop
from tasks.candidates.provider import CandidateProvider, ProviderConfig
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


@pytest.mark.parametrize(("field", "value"), [("seen_share", 1.5), ("library_score", float("nan")), ("call_id", "no call")])
def test_a_refused_row_of_a_candidate_costs_its_slot(monkeypatch: pytest.MonkeyPatch, field: str, value: object) -> None:
    make = scan_crop.make_asset
    changes: dict[str, Any] = {field: value}
    monkeypatch.setattr(scan_crop, "make_asset", lambda *parts, **facts: dataclasses.replace(make(*parts, **facts), **changes))
    outcome = candidates_of(furniture(1, "stool", (0.4, 0.4, 0.5), 0.2))
    rows = outcome.rows["candidates"]
    assert {row.slot for row in rows if row.outcome == "failed"} == {5, 6}
    assert {row.slot for row in rows if row.outcome == "filled"} == {1, 2, 3, 4, 7, 8, 9, 10}
    notes = [note for note in outcome.degradations if ": slot 5 failed: " in note]
    assert len(notes) == 1
    assert field in notes[0]
    assert "\n" not in notes[0]


@pytest.mark.parametrize("name", ["procedural", "scan_crop", "parametric", "library"])
def test_any_provider_loses_its_own_slots_alone(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """A provider of any kind whose assets have a negative volume."""
    real = candidates.provider_of

    def refused(config: ProviderConfig) -> CandidateProvider:
        family = real(config)
        if family.name != name:
            return family
        lent = real(scan_crop.ScanCrop())

        def offer(request: Any, _: Any) -> Any:
            made = lent.offer(request, scan_crop.ScanCrop())
            return dataclasses.replace(made, asset=dataclasses.replace(made.asset, volume_m3=-2e-4))

        return dataclasses.replace(family, offer=offer)

    monkeypatch.setattr(candidates, "provider_of", refused)
    outcome = candidates_of(furniture(1, "stool", (0.4, 0.4, 0.5), 0.2))
    rows = outcome.rows["candidates"]
    is_own = [row.provider.startswith(name) for row in rows]
    assert any(is_own)
    assert all(row.outcome == "failed" for row, own in zip(rows, is_own, strict=True) if own)
    assert all(row.outcome != "failed" for row, own in zip(rows, is_own, strict=True) if not own)
    assert all(asset.volume_m3 >= 0 for asset in outcome.rows["assets"])
