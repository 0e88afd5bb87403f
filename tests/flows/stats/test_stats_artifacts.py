"""The flow of the statistics against a real Prefect server: what it leaves there is read back through the client."""

from __future__ import annotations

import base64
import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from flows.stats import answers_of
from tests.furnished import furnished_lake
from warehouse.lake import Lake

READ = """
import json, sys
from flows.server.process import prefect_server

pytestmark = pytest.mark.whole
with prefect_server():
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.filters import ArtifactFilter
    with get_client(sync_client=True) as client:
        found = client.read_artifacts(limit=200)
        runs = client.read_flow_runs()
    print(json.dumps({
        'artifacts': [{'key': a.key, 'type': a.type, 'data': a.data, 'description': a.description} for a in found],
        'runs': [[run.state_name, run.parameters] for run in runs],
    }))
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("home")
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "METASCENES_"))}
    return {**kept, "HOME": str(folder), "XDG_CACHE_HOME": str(folder / ".cache"), "NUMBA_CACHE_DIR": str(folder / "numba")}


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return furnished_lake(tmp_path_factory.mktemp("artifacts") / "lake", scenes=1, objects=3)


def ran(home: dict[str, str], *command: str) -> str:
    done = subprocess.run([sys.executable, *command], env=home, capture_output=True, text=True, timeout=500)
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


def rows_of(artifact: dict[str, Any]) -> list[dict[str, str]]:
    """Rows of a table artifact."""
    data = artifact["data"]
    found: list[dict[str, str]] = json.loads(data) if isinstance(data, str) else data
    return found


@pytest.mark.slow
def test_the_flow_leaves_pictures_tables_and_a_link(home: dict[str, str], lake: Lake, tmp_path: Path) -> None:
    out, pictures = tmp_path / "report.html", tmp_path / "pictures"
    said = ran(
        home, "-m", "flows.cli", "stats", "--lake", lake.address, "--artifacts", "--json", "--out", str(out), "--pictures", str(pictures)
    )  # fmt: skip
    told = json.loads(said)
    assert told["report"] == str(out)
    assert told["snapshot_id"] == lake.snapshot().snapshot_id
    assert sorted(told["pictures"]) == sorted(str(file) for file in pictures.iterdir())
    read = json.loads(ran(home, "-c", READ))
    ((state, parameters),) = read["runs"]
    assert state == "Completed"
    assert parameters["lake"] == lake.address
    found = {artifact["key"]: artifact for artifact in read["artifacts"]}
    drawn = {file.stem: file for file in pictures.glob("*.png")}
    assert {key for key, artifact in found.items() if artifact["type"] == "image"} == {
        f"statistics-picture-{name.replace('_', '-')}" for name in drawn
    }
    for name, file in drawn.items():
        address = found[f"statistics-picture-{name.replace('_', '-')}"]["data"]
        kind, _, data = str(address).partition(";base64,")
        with Image.open(io.BytesIO(base64.b64decode(data))) as shown, Image.open(file) as whole:
            assert kind == f"data:image/{shown.format.lower()}"  # type: ignore[union-attr]
            assert shown.width / shown.height == pytest.approx(whole.width / whole.height, rel=0.01)
            assert shown.width == min(whole.width, 1000)
    assert out.resolve().as_uri() in str(found["statistics-report"]["data"])
    timing = answers_of(lake.snapshot()).rows["stage_timing"].to_pylist()
    assert {row["Stage"]: int(row["Scenes"]) for row in rows_of(found["statistics-stage-timing"])} == {
        row["stage"]: row["scenes"] for row in timing
    }
    (failed,) = rows_of(found["statistics-failures"])
    assert failed["Scene"] == "demo/broken"
    assert "secret" not in json.dumps(read["artifacts"])
    assert "| objects | 3 |" in str(found["statistics-summary"]["data"])


@pytest.mark.whole
def test_the_flow_is_addressed_by_its_module_path(home: dict[str, str]) -> None:
    code = (
        "import sys, flows.stats; light = 'prefect' not in sys.modules\n"
        "from prefect.flows import load_flow_from_entrypoint\n"
        "flow = load_flow_from_entrypoint('flows.stats.statistics')\n"
        "print(light, flow.name, sorted(flow.parameters.properties))"
    )
    assert ran(home, "-c", code).split(maxsplit=2) == [
        "True", "statistics", "['lake', 'out', 'pictures', 'release', 'snapshot', 'workers']\n",
    ]  # fmt: skip
