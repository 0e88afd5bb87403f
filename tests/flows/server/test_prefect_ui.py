"""The pages that Prefect's server shows by our settings, in a real browser: they ask nobody else, and what a run and the
statistics left there can be found and read.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from flows.server.artifacts import artifact_key
from tests.flows.server.test_artifacts import asked, cut
from tests.flows.stats.test_report_browser import FLAGS
from tests.furnished import furnished_lake
from tests.scans import write_scan
from tests.services import PrefectServer, prefect_server_process
from warehouse.lake import Lake

if TYPE_CHECKING:
    from playwright.sync_api import Page

pytestmark = [pytest.mark.whole, pytest.mark.browser, pytest.mark.slow]

SHOTS = os.environ.get("METASCENES_SHOTS")
"""A folder that gets a picture of every page that was looked at."""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PrefectServer]:
    with prefect_server_process(tmp_path_factory.mktemp("server"), PREFECT_SERVER_UI_V2_ENABLED="false") as started:
        yield started


@pytest.fixture(scope="module")
def lake(server: PrefectServer, tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """A lake with a furnished room, a run over two cut scans into it, and its statistics."""
    folder = tmp_path_factory.mktemp("ui")
    lake = furnished_lake(folder / "rooms", scenes=1, objects=3)
    for name in ("scene0001_00", "scene0002_00"):
        cut(write_scan(folder / "office", name))
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "METASCENES_"))}
    home = kept | {"PREFECT_HOME": str(folder / "prefect"), **server.access, "DO_NOT_TRACK": "1"}
    run = ["run", "--scans", str(folder / "office"), "--lake", lake.address]
    stats = ["stats", "--lake", lake.address, "--artifacts", "--out", str(folder / "report.html")]
    for arguments, code in ((run, 1), (stats, 0)):
        done = subprocess.run([sys.executable, "-m", "flows.cli", *arguments], env=home, capture_output=True, text=True, timeout=500)
        assert done.returncode == code, done.stderr
    return lake


@pytest.fixture
def page(server: PrefectServer) -> Iterator[Page]:
    """A page, which must talk to the server and to nobody else."""
    path = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("no chromium on this machine; apt-get install chromium")
    from playwright.sync_api import sync_playwright

    site = server.url.removesuffix("/api")
    elsewhere: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        page = browser.new_page(viewport={"width": 1280, "height": 860}, base_url=site)
        shown = server.header["Authorization"].removeprefix("Basic ")  # where the UI keeps the token that it asked for
        page.add_init_script(f"localStorage.setItem('prefect-password', {json.dumps(shown)})")
        page.on("request", lambda sent: elsewhere.append(sent.url) if not sent.url.startswith((site, "data:", "blob:")) else None)
        page.set_default_timeout(60_000)
        yield page
        browser.close()
    assert elsewhere == [], "the pages ask somebody else"


def artifact_of(server: PrefectServer, key: str) -> dict[str, Any]:
    (found,) = asked(server, "artifacts/latest/filter", artifacts={"key": {"any_": [key]}})
    return found | {"id": found["latest_id"]}  # its own id is that of the key


def shot(page: Page, name: str) -> None:
    if SHOTS:
        page.wait_for_timeout(1000)
        page.screenshot(path=str(Path(SHOTS) / f"prefect_{name}.png"))


def test_a_run_can_be_found_and_read(page: Page, server: PrefectServer, lake: Lake) -> None:
    (run,) = [run for run in asked(server, "flow_runs/filter") if run["name"] == "office -> rooms, 2 scenes"]
    page.goto(f"/runs/flow-run/{run['id']}")
    page.get_by_text("office -> rooms, 2 scenes").first.wait_for()
    page.get_by_text("Failed", exact=True).first.wait_for()
    shot(page, "run")

    table = artifact_of(server, artifact_key("scenes", lake.address))
    assert table["flow_run_id"] == run["id"]
    page.goto(f"/artifacts/artifact/{table['id']}")
    for row in json.loads(table["data"]):
        page.get_by_text(row["Scene"], exact=True).first.wait_for()
        page.get_by_text(row["Why"], exact=True).first.wait_for()
    page.get_by_text("office -> rooms, 2 scenes").first.wait_for()
    shot(page, "scenes")

    page.goto(f"/artifacts/artifact/{artifact_of(server, artifact_key('summary', lake.address))['id']}")
    page.get_by_role("heading", name="Slowest stages").wait_for()
    page.get_by_text(f"metascenes status --lake {lake.address}").wait_for()
    shot(page, "summary")


def test_a_picture_of_the_statistics_is_drawn(page: Page, server: PrefectServer, lake: Lake) -> None:
    page.goto("/artifacts")
    page.get_by_text("statistics-picture-scene-gallery").first.wait_for()
    shot(page, "artifacts")
    picture = artifact_of(server, "statistics-picture-scene-gallery")
    page.goto(f"/artifacts/artifact/{picture['id']}")
    drawn = page.locator("img[src^='data:image/']").first
    drawn.wait_for()
    width = "image => image.complete ? image.naturalWidth : 0"
    page.wait_for_function(f"(image) => ({width})(image) > 0", arg=drawn.element_handle())
    assert drawn.evaluate(width) > 300
    page.get_by_text("statistics of rooms").first.wait_for()
    shot(page, "picture")
