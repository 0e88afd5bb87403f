"""Nights over three scans, one of them refused: the run fails, one line, one row, one message; none is left after the repair."""

from __future__ import annotations

import sys
from logging import WARNING
from pathlib import Path
from typing import Any

import pytest

from bench.flows.small_scenes import SETTINGS, write_small_scans
from schemas.runs import RefusedScan
from tests.flows.server.test_deployments import Hook, Prefect, eventually
from tests.flows.server.test_deployments import deployed as deployed  # fixtures
from tests.flows.server.test_deployments import hook as hook
from tests.flows.server.test_deployments import prefect as prefect
from warehouse.lake import Lake

pytestmark = [pytest.mark.slow, pytest.mark.whole, pytest.mark.timeout(1800)]

NIGHT = """
import sys
from prefect import tags
from flows.pipeline import replicate

scans, lake, *settings = sys.argv[1:]
with tags("metascenes"):
    state = replicate(scans, lake, workers=1, settings=settings, return_state=True)
print("run:", state.state_details.flow_run_id)
print("state:", state.type.value, state.name, state.message)
"""

LAST = """
from prefect import flow, tags
from prefect.states import Failed

@flow(name="last")
def last():
    return Failed(message="the last message")

with tags("metascenes"):
    last(return_state=True)
"""


def test_a_refused_scan_is_told_of_once_and_forgotten_when_it_is_repaired(deployed: Prefect, tmp_path: Path) -> None:
    scans = write_small_scans(tmp_path / "small", 2)
    broken = scans / "kitchen" / "habitat"
    broken.mkdir(parents=True)
    (broken / "info_semantic.json").write_text("{}")
    lake = Lake.open(tmp_path / "lake")

    def night() -> tuple[str, list[str]]:
        """The state in which a night ended, and the warnings of its log, which the server keeps."""
        done = deployed.run([sys.executable, "-c", NIGHT, str(scans), lake.address, *SETTINGS])
        assert done.returncode == 0, done.stderr
        said = dict(line.split(": ", 1) for line in done.stdout.splitlines() if line.startswith(("run: ", "state: ")))
        logs = eventually(lambda: log_of(said["run"]), "the log of a run")
        return said["state"], [line["message"] for line in logs if line["level"] >= WARNING]

    def log_of(run: str) -> list[dict[str, Any]]:
        """The log of a run, once its last line has arrived."""
        asked = {"logs": {"flow_run_id": {"any_": [run]}}, "limit": 200}
        lines: list[dict[str, Any]] = deployed.ask("logs/filter", asked).raise_for_status().json()
        return lines if any("Finished in state" in line["message"] for line in lines) else []

    def told() -> list[dict[str, Any]]:
        return [call for _, call in Hook.taken if "kitchen" in call["text"]]

    state, warned = night()
    assert state.startswith("FAILED Failed 2 scenes done, 0 up to date, 1 scan refused: kitchen: folder: holds no scan"), state
    (line,) = warned
    assert line.startswith("kitchen: folder: holds no scan")
    (row,) = lake.snapshot().rows(RefusedScan)
    assert (row.scans, row.path, row.format) == (str(scans.resolve()), "kitchen", "replica_v1")
    eventually(told, "a call of the webhook")

    state, warned = night()
    assert state.startswith("FAILED Failed as before: 0 scenes done, 2 up to date, 1 scan refused: kitchen: folder"), state
    assert warned == [line]
    (again,) = lake.snapshot().rows(RefusedScan)
    assert again.first_seen_at == row.first_seen_at < again.last_seen_at

    (broken / "info_semantic.json").unlink()
    broken.rmdir()
    broken.parent.rmdir()
    state, warned = night()
    assert (state, warned) == ("COMPLETED Completed 0 scenes done, 2 up to date", [])
    assert list(lake.snapshot().rows(RefusedScan)) == []
    deployed.run([sys.executable, "-c", LAST]).check_returncode()
    eventually(lambda: [call for _, call in Hook.taken if "the last message" in call["text"]], "a call of the webhook")
    assert len(told()) == 1, "events are handled in their order: a second message would have come before the last"
