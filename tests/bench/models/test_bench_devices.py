"""The benchmark of devices: what counts as a difference, and the processor against itself."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from bench.machine import machine
from bench.models import devices
from bench.models.devices import device_report, differences
from bench.models.tables import print_models
from tasks.capture.small_objects.detectors import Detections
from tasks.capture.small_objects.segmenters import Segments


def seen(*labels: str, shift: float = 0.0, sure: float = 0.5) -> Any:
    masks = np.zeros((len(labels), 10, 10), dtype=bool)
    masks[:, :5, : 5 + round(shift)] = True
    return Detections(np.tile([shift, 0, 5 + shift, 5], (len(labels), 1)).astype(float), labels, np.full(len(labels), sure), masks)


def test_differences_are_the_largest_and_other_things_are_infinite() -> None:
    assert differences([seen("mug"), seen("pen")], [seen("mug"), seen("pen")]) == (0.0, 0.0, 0.0)
    boxes, scores, masks = differences([seen("mug"), seen("pen")], [seen("mug"), seen("pen", shift=2.0, sure=0.4)])
    assert (boxes, masks) == (2.0, 0.1)
    assert scores == pytest.approx(0.1)
    assert differences([seen("mug")], [seen("cup")])[0] == np.inf
    assert differences([seen("mug")], [seen("mug", "cup")]) == (np.inf, np.inf, np.inf)
    one, two = Segments(np.zeros((1, 4, 5), bool), np.ones(1)), Segments(np.ones((1, 4, 5), bool), np.ones(1))
    assert differences([one], [two]) == (0.0, 0.0, 1.0)


@pytest.mark.whole
def test_the_processor_agrees_with_itself_in_double_precision_and_others_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    torch = pytest.importorskip("torch")
    pytest.importorskip("transformers")
    report = device_report()
    assert [row["provider"] for row in report["rows"]] == list(devices.NETWORKS)
    assert all(row["met"] for row in report["goals"]), report["goals"]
    is_there = torch.cuda.is_available()
    for row in report["rows"]:
        assert row["weights_mb"] > 100
        assert (row["peak_mb"] is not None) == (row["pictures_per_second"] is not None) == is_there
        assert is_there or row["against"] == "cpu, double precision"
    out = io.StringIO()
    print_models({"machine": machine(), "seed": 0, "parts": {"devices": report}, "goals": report["goals"]}, Console(file=out, width=200))
    assert is_there or ("no graphics card" in out.getvalue() and out.getvalue().count("not run") == 2 * len(report["rows"]))

    right, calls = devices.provider_of, []

    def wrong(name: str, shape: Any, folder: Path) -> Any:
        """The second of each has other weights."""
        calls.append(name)
        provider = right(name, shape, folder)
        if calls.count(name) == 2:
            with torch.no_grad():
                for parameter in provider.network.parameters():
                    parameter.mul_(1.05)
        return provider

    monkeypatch.setattr(devices, "provider_of", wrong)
    assert not any(row["met"] for row in device_report()["goals"])
