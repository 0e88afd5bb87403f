"""The viewer in a real browser, drawn without a graphics processor: what is clicked, tried and played, and what is asked of whom."""

from __future__ import annotations

import json
import math
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import httpx
import pytest

from flows.view import bundle
from flows.view.scene import Scenes
from flows.view.standalone import write_page
from schemas.optimization import Placement
from tests.flows.stats.test_report_browser import FLAGS
from tests.flows.view.lakes import ACTIONS, OBJECTS, SCENES, SETTLED_SHIFT_M, TRACK, UNSTABLE, place, shown_lake
from warehouse.lake import Lake

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = [pytest.mark.whole, pytest.mark.browser, pytest.mark.skipif(not bundle.is_built(), reason="`make client` has not been run")]

SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
DESK = {"width": 1280, "height": 800}
READY_S = 60.0


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return shown_lake(tmp_path_factory.mktemp("viewer"))


@pytest.fixture(scope="module")
def address(lake: Lake, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """What the command printed; it serves until the tests are done, and ends as it should."""
    command = [sys.executable, "-m", "flows.cli", "view", "--lake", lake.address, "--no-browser", "--json"]
    said = tmp_path_factory.mktemp("said") / "stderr"
    with said.open("w") as errors, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as process:
        assert process.stdout is not None
        yield str(json.loads(process.stdout.readline())["address"])
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0
    assert said.read_text() == ""


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    path = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("no chromium on this machine; apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        flags = [flag for flag in FLAGS if flag != "--disable-gpu"]
        started = playwright.chromium.launch(executable_path=path, args=[*flags, *SOFTWARE])
        yield started
        started.close()


@pytest.fixture
def opened(browser: Browser, address: str) -> Iterator[Callable[..., Page]]:
    """Opens the viewer; at the end nothing was wrong on any page, and nothing was asked of other hosts."""
    wrong: list[str] = []
    contexts = []
    home = address.partition("?")[0]

    def open_page(place: str = address, scene: str = SCENES[0], **options: Any) -> Page:
        context = browser.new_context(viewport=DESK, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda message: wrong.append(f"console: {message.text}"))
        page.on("pageerror", lambda error: wrong.append(f"error: {error}"))
        own = ("data:", "blob:", home, *([place] if place.startswith("file:") else []))
        page.on("request", lambda request: None if request.url.startswith(own) else wrong.append(request.url))
        page.goto(place)
        wait(page, "document.documentElement?.dataset.ready", scene)
        return page

    yield open_page
    assert wrong == []
    for context in contexts:
        context.close()


def wait(page: Page, expression: str, value: Any) -> None:
    """Until an expression has a value; the address with the token leads on to the page, so there may be none at first."""
    from playwright.sync_api import Error

    found, end = None, time.monotonic() + READY_S
    while time.monotonic() < end:
        try:
            found = page.evaluate(expression)
        except Error as error:
            if "context was destroyed" not in str(error) and "view is not defined" not in str(error):
                raise
        if found == value:
            return
        page.wait_for_timeout(30)
    raise AssertionError(f"{expression} is {found!r}, not {value!r}")


def click_object(page: Page, instance_id: str) -> None:
    """A click on the middle of an object in the scene."""
    at = page.evaluate(f"view.placeOf('{instance_id}')")
    page.mouse.click(at["x"], at["y"])


def place_of(page: Page, instance_id: str) -> list[float]:
    position: list[float] = page.evaluate(f"view.positionOf('{instance_id}')")
    return position


def test_a_scene_opens_whole_and_the_next_takes_its_place(opened: Callable[..., Page]) -> None:
    page = opened()
    assert "token" not in page.url
    state = page.evaluate("view.state")
    assert (state["scene"], state["objects"]) == (SCENES[0], OBJECTS)
    assert state["points"] > 0
    assert page.locator("[data-instance]").count() == OBJECTS
    assert page.locator("[data-instance='0001'] + ul [data-instance='0003']").count() == 1, "what stands on the table is below it"
    page.locator(f"[data-scene='{SCENES[1]}']").click()
    wait(page, "document.documentElement?.dataset.ready", SCENES[1])
    assert page.evaluate("location.hash") == f"#{SCENES[1]}"
    page.keyboard.press("[")
    wait(page, "document.documentElement?.dataset.ready", SCENES[0])


def test_everything_fits_the_window(opened: Callable[..., Page]) -> None:
    page = opened()
    assert page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]") == [1280, 800]
    for instance_id in (f"{index:04d}" for index in range(OBJECTS)):
        at, view = page.evaluate(f"view.placeOf('{instance_id}')"), page.locator(".view").bounding_box()
        assert view is not None
        assert view["x"] < at["x"] < view["x"] + view["width"]
        assert view["y"] < at["y"] < view["y"] + view["height"]


def test_a_click_on_an_object_shows_what_is_known_of_it(opened: Callable[..., Page]) -> None:
    page = opened()
    page.keyboard.press("t")  # from above nothing is before anything
    click_object(page, "0001")
    wait(page, "view.state.selected", "0001")
    pane = page.locator(".pane").first
    assert pane.locator("h2").inner_text().lower() == "table"
    for fact in ("A table.", "CC0-1.0", "0.9, rank 1 of 2", "floor", "stays"):
        assert fact in pane.inner_text()
    page.locator("summary").click()
    wait(page, "document.querySelector('.lineage pre').textContent.startsWith('snapshot')", True)
    assert "rank 1 of 2" in page.locator(".lineage pre").inner_text()
    page.keyboard.press("Escape")
    wait(page, "view.state.selected", None)
    page.keyboard.press("n")
    assert page.evaluate("view.state.selected") is not None


def test_the_edge_between_scan_and_replica_moves(opened: Callable[..., Page]) -> None:
    page = opened()
    slider = page.get_by_label("Share of the picture that shows the scan")
    pixels = {}
    for key in ("Home", "End"):
        slider.focus()
        page.keyboard.press(key)
        wait(page, "view.canvas.isDirty", False)
        assert page.evaluate("view.state.cut") == (0 if key == "Home" else 1)
        pixels[key] = page.locator(".view canvas").first.screenshot()
    assert pixels["Home"] != pixels["End"]
    edge = page.locator(".edge").bounding_box()
    view = page.locator(".view").bounding_box()
    assert edge is not None
    assert view is not None
    page.mouse.move(edge["x"] + 4, edge["y"] + 100)
    page.mouse.down()
    page.mouse.move(view["x"] + view["width"] / 4, edge["y"] + 100, steps=3)
    page.mouse.up()
    assert page.evaluate("view.state.cut") == pytest.approx(0.25, abs=0.02)
    page.locator(".view canvas").first.focus()
    page.keyboard.press("ArrowRight")
    assert page.evaluate("view.state.cut") == pytest.approx(0.30, abs=0.02)


def test_a_candidate_is_tried_in_place_and_taken_back(opened: Callable[..., Page]) -> None:
    page = opened()
    page.locator("[data-instance='0000']").click()
    wait(page, "document.querySelectorAll('.tile canvas[data-drawn]').length", 2)
    assert page.locator(".tile:disabled").count() == 1, "the empty slot"
    placed = place_of(page, "0000")
    page.keyboard.press("2")
    wait(page, "view.state.tried", {"0000": 2})
    assert place_of(page, "0000") == pytest.approx([placed[0], placed[1] + 0.2, placed[2]])
    assert page.locator(".tile[aria-pressed=true]").get_attribute("data-slot") == "2"
    page.get_by_role("button", name="show again what was placed").click()
    wait(page, "view.state.tried", {})
    assert place_of(page, "0000") == pytest.approx(placed)
    page.locator(".tile[data-slot='2']").click()
    wait(page, "view.state.tried", {"0000": 2})


def test_settling_is_played_from_proposed_to_settled(opened: Callable[..., Page], lake: Lake) -> None:
    page = opened()
    row = next(row for row in lake.snapshot().rows(Placement, SCENES[0]) if row.instance_id == UNSTABLE)
    poses = [row.proposed_pose, row.optimized_pose, row.settled_pose]
    for name, pose in zip(("proposed", "optimized", "settled"), poses, strict=True):
        page.get_by_role("button", name=name, exact=True).click()
        assert pose is not None
        assert place_of(page, UNSTABLE) == pytest.approx([pose[3], pose[7], pose[11]])
    before = place(int(UNSTABLE))[0, 3]
    page.get_by_role("button", name="Play how it settles").click()
    seen = []
    while page.evaluate("view.settle.isRunning"):
        seen.append(place_of(page, UNSTABLE)[0])
        page.wait_for_timeout(40)
    assert page.evaluate("view.state.time") == 2
    assert place_of(page, UNSTABLE)[0] == pytest.approx(before + SETTLED_SHIFT_M)
    assert len({round(x, 3) for x in seen}) > 3, "it passes through places between"
    assert seen == sorted(seen), "from where it was proposed, onwards"


def test_problems_are_marked_as_of_the_time_that_is_shown(opened: Callable[..., Page]) -> None:
    page = opened()
    marks = "view.over.children[0].children.length"
    page.get_by_role("button", name="proposed", exact=True).click()
    wait(page, marks, 5)  # what does not stay; of the one deep pair a dot, a bar and two boxes
    page.get_by_role("button", name="optimized", exact=True).click()
    wait(page, marks, 1)
    assert page.locator(f"[data-instance='{UNSTABLE}'] .badge").count() == 1
    page.get_by_role("button", name="Problems").click()
    wait(page, "view.over.children.length", 0)


def test_layers_are_shown_and_hidden(opened: Callable[..., Page]) -> None:
    page = opened()
    page.get_by_role("button", name="Supports").click()
    wait(page, "view.over.children.length", 2)
    assert page.evaluate("view.over.children[1].children.length") == 3 * OBJECTS
    page.get_by_role("button", name="Colliders").click()
    wait(page, "view.colliders?.holders.size", OBJECTS - 1)
    assert "1 objects have no collider" in page.locator(".status").inner_text()
    page.get_by_role("button", name="Navmesh").click()
    wait(page, "view.layers.children.length", 2)
    page.get_by_role("button", name="Colliders").click()
    wait(page, "view.objects.visible", True)
    page.get_by_role("button", name="Points").click()
    assert page.evaluate("[view.scan.points.visible, view.scan.mesh.visible]") == [True, False]


def test_an_episode_is_walked_with_the_agents_view(opened: Callable[..., Page]) -> None:
    page = opened()
    page.get_by_role("tab", name="Episodes").click()
    page.locator("[data-episode='0000']").click()
    wait(page, "view.walking.isRunning", False)
    assert page.evaluate("view.state.walk") == {"episode": "0000", "moment": len(ACTIONS), "end": len(ACTIONS)}
    assert page.locator(".inset").is_visible()
    eye = page.evaluate("[...view.walk.camera.position.toArray(), view.walk.body.rotation.z]")
    assert eye == pytest.approx([2.0 + 0.25 * math.cos(math.pi / 6), 2.125, 0.9, math.pi / 6])
    page.keyboard.press("Escape")
    wait(page, "view.state.walk", None)
    assert not page.locator(".inset").is_visible()


def test_a_cart_is_driven_beside_where_it_believed_to_be(opened: Callable[..., Page]) -> None:
    page = opened()
    page.get_by_role("tab", name="Episodes").click()
    run = page.locator("[data-drive]")
    assert run.inner_text().split("\n") == ["A cart to the table: arrived", "0000: 8 s, off by 0.4 cm; expert, built-in, planar"]
    run.click()
    assert page.evaluate("[...view.walk.belief.position.toArray()].slice(0, 2)") != pytest.approx([1.5, 2.0])
    wait(page, "view.walking.isRunning", False)
    state = page.evaluate("view.state.walk")
    assert (state["moment"], state["end"]) == (len(TRACK) - 1, len(TRACK) - 1)
    place = page.evaluate("[...view.walk.cart.position.toArray().slice(0, 2), view.walk.cart.rotation.z]")
    assert place == pytest.approx(list(TRACK[-1]))
    assert page.locator("[data-drive][aria-current=true]").count() == 1
    page.locator("[data-episode='0000']").click()
    assert page.locator("[data-drive][aria-current=true]").count() == 0
    page.keyboard.press("Escape")
    wait(page, "view.state.walk", None)


def test_frames_show_their_masks_and_a_click_selects(opened: Callable[..., Page]) -> None:
    page = opened()
    page.get_by_role("tab", name="Frames").click()
    wait(page, "document.querySelector('canvas.frame').dataset.drawn", "000000")
    frame = page.locator("canvas.frame")
    assert frame.evaluate("node => [node.width, node.height]") == [64, 48]
    row = frame.evaluate("node => [...node.getContext('2d').getImageData(0, 10, 64, 1).data]")
    assert row[:4] != row[4 * 10 : 4 * 11]
    box = frame.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + box["width"] * (4 + 14 + 7) / 64, box["y"] + box["height"] * 12 / 48)
    wait(page, "view.state.selected", "0001")


def test_scripts_in_labels_are_shown_and_not_run(opened: Callable[..., Page]) -> None:
    page = opened()
    page.locator(f"[data-scene='{SCENES[1]}']").click()
    wait(page, "document.documentElement?.dataset.ready", SCENES[1])
    for instance_id in ("0000", UNSTABLE):
        page.locator(f"[data-instance='{instance_id}']").click()
        page.locator("summary").click()
        wait(page, "document.querySelector('.lineage pre').textContent.length > 100", True)
    page.get_by_role("tab", name="Episodes").click()
    assert "onerror" in page.locator("[data-episode]").inner_text()
    assert "onerror" in page.locator("[data-drive]").inner_text()
    assert page.evaluate("window.hacked") is None
    assert page.locator("img[src='x'], b").count() == 0


def test_a_file_opens_without_a_server_and_asks_for_nothing(opened: Callable[..., Page], lake: Lake, tmp_path: Path) -> None:
    file = tmp_path / "scene.html"
    write_page(Scenes(lake), SCENES[1], file)
    page = opened(file.as_uri(), SCENES[1], offline=True)
    state = page.evaluate("view.state")
    assert (state["scene"], state["objects"]) == (SCENES[1], OBJECTS)
    page.locator("[data-instance='0002']").click()
    page.keyboard.press("2")
    wait(page, "view.state.tried", {"0002": 2})
    page.locator("summary").click()
    wait(page, "document.querySelector('.lineage pre').textContent.startsWith('snapshot')", True)
    for layer in ("Colliders", "Navmesh"):
        page.get_by_role("button", name=layer).click()
    wait(page, "view.layers.children.length", 2)
    page.get_by_role("tab", name="Frames").click()
    assert "stay in its folder" in page.locator(".pane").nth(2).inner_text()
    assert page.evaluate("window.hacked") is None


def test_without_the_cookie_a_page_of_another_server_gets_nothing(browser: Browser, address: str, opened: Callable[..., Page]) -> None:
    """A page of another port of this machine is the same site; browsers would send the cookie along."""
    opened()  # somebody has the page open
    home = address.partition("?")[0]
    assert httpx.get(home).status_code == 401
    assert httpx.get(home, params={"token": "guess"}).status_code == 401
    assert httpx.get(address, headers={"host": "evil.example"}).status_code == 403
    assert httpx.get(address, headers={"origin": "http://evil.example"}).status_code == 403
    with httpx.Client() as client:
        assert client.get(address).status_code == 200
        assert client.get(f"{home}api/scenes").status_code == 200
        assert client.get(f"{home}api/scenes", headers={"sec-fetch-site": "same-site"}).status_code == 403


def test_a_port_that_is_taken_is_named(address: str, lake: Lake) -> None:
    port = address.rpartition(":")[2].partition("/")[0]
    command = [sys.executable, "-m", "flows.cli", "view", "--lake", lake.address, "--no-browser", "--port", port]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr == f"metascenes: 127.0.0.1:{port}: --port: cannot be had (Address already in use); leave --port away for a free one\n"


def test_a_scene_that_is_not_there_is_named(lake: Lake, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "flows.cli", "view", "demo/none", "--lake", lake.address, "--out", str(tmp_path / "x.html")]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert "demo/none: there is no such scene" in ran.stderr


def test_an_answer_that_comes_late_does_not_win(opened: Callable[..., Page]) -> None:
    """What was asked for last is shown, whichever arrives first: of two candidates, and of a candidate and what was placed."""
    page = opened()
    tried = page.evaluate(
        """async () => {
            const offer = (slot) => view.document.objects[0].candidates.find((each) => each.slot === slot);
            const { fetch } = window;
            let release;
            const gate = new Promise((resolve) => { release = resolve; });
            window.fetch = async (...asked) => (await gate, fetch(...asked));
            view.select("0000");
            const slow = view.attempt(offer(2)); // not loaded yet
            await view.attempt(null); // what is loaded already
            release();
            await slow;
            window.fetch = fetch;
            return view.state.tried;
        }"""
    )
    assert tried == {}
    assert place_of(page, "0000") == pytest.approx(place(0)[:3, 3].tolist())


def test_a_layer_that_could_not_be_fetched_is_tried_again(opened: Callable[..., Page]) -> None:
    page = opened()
    page.evaluate("""() => { window.whole = fetch; window.fetch = async () => new Response("", { status: 404 }); }""")
    page.get_by_role("button", name="Navmesh").click()
    wait(page, "document.querySelector('.status').classList.contains('wrong')", True)
    page.evaluate("() => { window.fetch = window.whole; }")
    page.get_by_role("button", name="Navmesh").click()
    page.get_by_role("button", name="Navmesh").click()
    wait(page, "view.layers.children.length", 1)


@pytest.mark.slow
def test_what_a_scene_took_is_given_back_with_it(opened: Callable[..., Page]) -> None:
    """Geometries and images of the graphics processor do not add up with visits; marks that are still being drawn make a difference."""
    page = opened()
    for layer in ("Supports", "Colliders", "Navmesh"):
        page.get_by_role("button", name=layer).click()
    held = []
    for scene in SCENES[::-1] * 3:
        page.locator(f"[data-scene='{scene}']").click()
        wait(page, "document.documentElement?.dataset.ready", scene)
        wait(page, "view.layers.children.length", 2)
        for _ in range(3):
            page.keyboard.press("n")
            page.keyboard.press("2")
            page.keyboard.press("x")
        page.keyboard.press("Escape")
        wait(page, "view.state.tried", {})
        wait(page, "view.canvas.isDirty", False)
        held.append(page.evaluate("({ ...view.canvas.renderer.info.memory })"))
    for kind in ("geometries", "textures"):
        first, *later = [max(held[k][kind], held[k + 1][kind]) for k in (0, 2, 4)]
        assert max(later) <= 1.5 * first, held
