"""The annotation page in a real browser on the real server: what is chosen, aligned, ranked, handed in and reviewed, and what is kept."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from flows.inputs.annotation import batch_list, open_work
from flows.view import bundle
from tests.flows.stats.test_report_browser import FLAGS
from tests.flows.view.asked import BATCH, OBJECTS, SCENES, SIDE, SIDE_COLOR, SLOTS, TABLE_M, asked_lake
from warehouse.lake import Lake

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = [pytest.mark.whole, pytest.mark.browser, pytest.mark.skipif(not bundle.is_built(), reason="`make client` has not been run")]

SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
DESK = {"width": 1280, "height": 800}
PATIENCE_S = 180.0
"""Until something must have happened; nothing is decided by how long it took."""

OBJECT = f"{SCENES[0]}/0002"
"""The box over the table."""


@pytest.fixture(scope="module")
def room(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One scene, asked of ada and bob."""
    folder = tmp_path_factory.mktemp("asked")
    asked_lake(folder, scenes=SCENES[:1])
    return folder


@pytest.fixture
def lake(room: Path, tmp_path: Path) -> Lake:
    """A copy that a test changes."""
    shutil.copytree(room / "lake", tmp_path / "lake")
    return Lake.open(tmp_path / "lake")


class Server:
    """`metascenes annotate serve` on a lake."""

    def __init__(self, lake: Lake) -> None:
        self.lake = lake
        self.start()

    def start(self) -> None:
        command = [
            sys.executable,
            "-m",
            "flows.cli",
            "annotate",
            "serve",
            BATCH,
            "--reviewer",
            "rita",
            "--lake",
            self.lake.address,
            "--json",
        ]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        told = json.loads(self.process.stdout.readline())["addresses"]
        self.addresses = {name: row["address"] for name, row in told.items()}

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()

    def stop(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            assert self.process.wait(PATIENCE_S) == 0


@pytest.fixture
def server(lake: Lake) -> Iterator[Server]:
    started = Server(lake)
    yield started
    started.stop()


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    path = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("no chromium on this machine; apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, args=[*(flag for flag in FLAGS if flag != "--disable-gpu"), *SOFTWARE])
        yield started
        started.close()


@pytest.fixture
def opened(browser: Browser, server: Server) -> Iterator[Callable[..., Page]]:
    """Opens the page of a person; at the end nothing was wrong on any page but what was refused or away, and other hosts were not asked."""
    wrong: list[str] = []
    contexts = []

    def open_page(name: str, **options: Any) -> Page:
        context = browser.new_context(**({"viewport": DESK} | options))
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(PATIENCE_S * 1000)
        page.on("console", lambda message: None if is_expected(message.text) else wrong.append(f"console: {message.text}"))
        page.on("pageerror", lambda error: wrong.append(f"error: {error}"))
        home = server.addresses[name].partition("?")[0]
        page.on("request", lambda request: None if request.url.startswith(("data:", "blob:", home)) else wrong.append(request.url))
        page.goto(server.addresses[name])
        wait(page, "Boolean(document.documentElement?.dataset.ready)", True)
        return page

    yield open_page
    assert wrong == []
    for context in contexts:
        context.close()


def is_expected(message: str) -> bool:
    """What browsers write down of answers that say no, and of servers that were killed."""
    return any(
        part in message
        for part in (
            "status of 401",
            "status of 408",
            "status of 409",
            "ERR_INTERNET_DISCONNECTED",
            "ERR_CONNECTION_REFUSED",
            "ERR_CONNECTION_RESET",
            "ERR_EMPTY_RESPONSE",
        )
    )


def wait(page: Page, expression: str, value: Any) -> None:
    """Until an expression has a value; the address with the token leads on to the page, so there may be none at first."""
    from playwright.sync_api import Error

    found, end = None, time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        try:
            found = page.evaluate(expression)
        except Error as error:
            if "context was destroyed" not in str(error) and "annotate is not defined" not in str(error):
                raise
        if found == value:
            return
        page.wait_for_timeout(30)
    raise AssertionError(f"{expression} is {found!r}, not {value!r}")


def show(page: Page, key: str) -> None:
    """Choose an object in the list, and wait until it stands in the scene."""
    page.locator(f"[data-key='{key}']").click()
    wait(page, "document.documentElement.dataset.shown", key)
    wait(page, "annotate.stage.canvas.isDirty", False)


def now(page: Page) -> dict[str, Any]:
    """What is decided for the object."""
    state: dict[str, Any] = page.evaluate("annotate.state.now")
    return state


def position(page: Page) -> list[float]:
    where: list[float] = page.evaluate("annotate.state.transform.position")
    return where


def drag_along_x(page: Page, metres: float) -> float:
    """Take the handle along x and drag it; what the field said before the hand let go [m]."""
    project = "(x) => { const [px, py, pz] = annotate.state.transform.position; return annotate.stage.project([px + x, py, pz]); }"
    for place in np.arange(0.04, 1.0, 0.02).tolist():
        start, end = (page.evaluate(project, x) for x in (place, place + metres))
        page.mouse.move(start["x"], start["y"])
        if page.evaluate("annotate.stage.gizmo.axis") == "X":
            break
    page.mouse.down()
    page.mouse.move((start["x"] + end["x"]) / 2, (start["y"] + end["y"]) / 2)
    page.mouse.move(end["x"], end["y"])
    told = float(page.locator("[data-field=x]").input_value())
    page.mouse.up()
    return told


def drag_to_place(page: Page, tile: str, place: int) -> None:
    """Drag a tile onto a place of the ranking."""
    start, end = (page.locator(selector).bounding_box() for selector in (tile, f"[data-place='{place}']"))
    assert start is not None
    assert end is not None
    page.mouse.move(start["x"] + start["width"] / 2, start["y"] + start["height"] / 2)
    page.mouse.down()
    page.mouse.move(end["x"] + end["width"] / 2, end["y"] + end["height"] / 2, steps=4)
    page.mouse.up()


def answer_all(page: Page) -> None:
    """Save what is shown for every object."""
    unanswered = "annotate.state.listed.filter(([, status]) => status !== 'answered').length"
    while left := page.evaluate(unanswered):
        page.keyboard.press("Control+Enter")  # once: what is shown still, because the machine is busy, would be saved again
        wait(page, f"{unanswered} < {left}", True)


def ask_to_hand_in(page: Page) -> None:
    """Press the button until the page asks: while an answer arrives, the list is drawn anew and a press may meet a button that is gone."""
    wait(page, "annotate.state.saved", "saved")
    while page.locator("dialog[open]").count() == 0:
        page.get_by_role("button", name="Hand in").click()
        page.wait_for_timeout(30)


@pytest.mark.slow
def test_an_object_is_chosen_aligned_and_ranked_and_kept(opened: Callable[..., Page], lake: Lake) -> None:
    page = opened("ada")
    show(page, OBJECT)
    assert page.locator("[data-field=height]").input_value() == "0.2", "over the table"
    page.keyboard.press("3")
    assert now(page) == {"choice": 3, "transform": None, "ranking": []}
    page.keyboard.press("w")
    told = drag_along_x(page, 0.3)
    assert position(page) == pytest.approx([told, 0.0, TABLE_M + 0.2], abs=1e-3)
    assert told > 0.1
    page.keyboard.press("z")
    assert position(page) == pytest.approx([0.0, 0.0, TABLE_M + 0.2])
    page.keyboard.press("y")
    assert position(page)[0] == pytest.approx(told, abs=1e-3)
    page.get_by_label("X [m]", exact=True).fill("0.1")
    page.keyboard.press("Enter")
    page.get_by_label("Turn [°]").fill("30")
    page.keyboard.press("Enter")
    page.get_by_label("Over support [m]").fill("0.05")
    page.keyboard.press("Enter")
    assert position(page) == pytest.approx([0.1, 0.0, TABLE_M + 0.05], abs=1e-5)
    page.keyboard.press("b")
    assert position(page)[2] == pytest.approx(TABLE_M, abs=1e-5)
    page.keyboard.press("e")
    for key in "124":
        page.keyboard.press(key)
    drag_to_place(page, ".ten [data-slot='7']", 0)
    assert now(page)["ranking"] == [7, 1, 2, 4]
    drag_to_place(page, "[data-rank='3']", 1)
    page.locator("[data-rank='1']").focus()
    page.keyboard.press("ArrowRight")
    assert now(page)["ranking"] == [7, 1, 4, 2]
    wait(page, "annotate.state.saved", "saved")
    before = page.evaluate("annotate.state.now")
    page.reload()
    wait(page, "Boolean(document.documentElement?.dataset.ready)", True)
    assert (page.evaluate("annotate.state.key"), page.evaluate("annotate.state.status")) == (OBJECT, "draft")
    assert now(page) == before
    page.keyboard.press("Enter")
    wait(page, f"annotate.state.listed.find(([key]) => key === '{OBJECT}')[1]", "answered")
    (row,) = [row for row in open_work(lake, BATCH, "ada") if row["instance_id"] == "0002"]
    slots = {asset["asset_id"]: asset["slot"] for asset in page.evaluate("annotate.entries[1].row.candidates")}
    assert [slots[asset] for asset in row["answer"]["ranking"]] == [3, 7, 1, 4, 2]
    assert [row["answer"]["pose"][i] for i in (3, 7, 11)] == pytest.approx([0.1, 0.0, TABLE_M], abs=1e-5)


def test_undo_and_redo_lead_through_any_changes(opened: Callable[..., Page]) -> None:
    """All undone gives what was there first, all redone what was there last; a ranking never names the choice, or one twice."""
    page = opened("ada")
    slot = st.none() | st.integers(1, SLOTS)
    change = st.one_of(
        st.tuples(st.just("choose"), slot),
        st.tuples(st.just("rank"), st.integers(1, SLOTS), st.none() | st.integers(0, 3)),
        st.tuples(st.just("place"), st.floats(-2, 2), st.floats(-1, 3)),
    )

    @given(st.lists(change, max_size=12))
    @settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
    def check(changes: list[tuple[Any, ...]]) -> None:
        seen = page.evaluate(
            """(changes) => {
                const draft = new annotate.draft.constructor({ ...annotate.current.row, draft: null, answer: null });
                const seen = [draft.body];
                for (const [kind, ...values] of changes) {
                    if (kind === "choose") draft.choose(values[0]);
                    else if (kind === "rank") draft.rank(...values);
                    else if (draft.transform) {
                        const [x, scale] = values;
                        draft.place({ ...draft.transform, position: [x, 0, 0], scale: [scale, 1, 1] });
                    }
                    seen.push(draft.body);
                }
                while (draft.undo()) continue;
                const first = draft.body;
                while (draft.redo()) continue;
                return { seen, first, last: draft.body };
            }""",
            changes,
        )
        assert (seen["first"], seen["last"]) == (seen["seen"][0], seen["seen"][-1])
        for body in seen["seen"]:
            assert len(set(body["ranking"])) == len(body["ranking"]) <= 5
            assert body["ranking"][:1] == ([] if body["choice"] is None else [body["choice"]])
            assert body["choice"] is not None or body["transform"] is None
            assert body["transform"] is None or min(body["transform"]["scale"]) > 0

    check()


def test_figures_follow_and_settling_puts_the_object_down(opened: Callable[..., Page]) -> None:
    page = opened("ada")
    show(page, OBJECT)
    wait(page, "annotate.state.figures?.floating_m?.toFixed(3)", "0.200")
    assert "bad" in (page.locator("[data-figure=floating]").get_attribute("class") or "")
    page.keyboard.press("l")
    wait(page, "document.querySelector('.status').textContent.startsWith('Settled')", True)
    wait(page, "document.querySelector('[data-figure=floating]')?.className", "")
    assert position(page) == pytest.approx([0.0, 0.0, TABLE_M], abs=0.005)
    wait(page, "annotate.stage.glide.isRunning", False)
    drawn = page.evaluate("annotate.stage.replica.shown.get('0002').matrix.elements.slice(12, 15)")
    assert drawn == pytest.approx(position(page)), "it glides to where it was put"
    page.keyboard.press("Control+z")
    assert position(page) == pytest.approx([0.0, 0.0, TABLE_M + 0.2])


@pytest.mark.slow
def test_a_batch_goes_back_and_comes_again(opened: Callable[..., Page], lake: Lake) -> None:
    """Answered, handed in, sampled, reviewed and returned with a remark; corrected, handed in again, and accepted."""
    ada, bob, rita = opened("ada"), opened("bob"), opened("rita")
    answer_all(ada)
    ask_to_hand_in(ada)
    ada.get_by_role("dialog").get_by_role("button", name="Hand in", exact=True).click()
    wait(ada, "document.querySelector('dialog[open] .remains')?.textContent.includes(\"bob's\")", True)
    ada.get_by_role("button", name="Cancel").click()
    for number in (1, 2):
        answer_all(bob)
        ask_to_hand_in(bob)
        bob.get_by_role("dialog").get_by_role("button", name="Hand in", exact=True).click()
        wait(bob, "document.querySelector('.status').textContent", "The batch is handed in.")
        assert bob.locator("[data-field=x]").is_disabled(), "nothing can be changed now"
        rita.reload()
        rita.get_by_role("button", name="Draw the sample").click()
        wait(rita, "annotate.state.listed.length", 2 * len(OBJECTS))
        if number == 1:
            show(rita, f"{OBJECT} bob")
            rita.keyboard.press("x")
            assert "needs a remark" in rita.locator(".status").inner_text()
            rita.keyboard.type("too high <b>by 20 cm</b>")
            rita.keyboard.press("Control+Enter")
            wait(rita, "annotate.entries.filter(({ row }) => row.verdict).length", 1)
        for done in range(2 - number, 2 * len(OBJECTS)):
            wait(rita, "annotate.current.row.verdict ?? null", None)
            rita.keyboard.press("y")
            wait(rita, "annotate.entries.filter(({ row }) => row.verdict).length", done + 1)
        rita.get_by_role("button", name="Conclude the review").click()
        verdict = ("returned", "accepted")[number - 1]
        wait(rita, f"document.querySelector('.status').textContent.startsWith('The batch is {verdict}')", True)
        if number == 1:
            bob.reload()
            wait(bob, "Boolean(document.documentElement?.dataset.ready)", True)
            show(bob, OBJECT)
            assert "round 1, rita: too high <b>by 20 cm</b>" in bob.locator(".remarks").inner_text()
            bob.keyboard.press("b")
            wait(bob, "annotate.state.saved", "saved")
    (row,) = batch_list(lake, BATCH)
    assert (row["state"], row["round"], row["counts"], row["passed"]) == ("accepted", 2, True, 2 * len(OBJECTS))
    (corrected,) = [row for row in open_work(lake, BATCH, "bob") if row["instance_id"] == "0002"]
    assert corrected["answer"]["revision"] == 2
    assert corrected["answer"]["pose"][11] == pytest.approx(TABLE_M, abs=1e-5)


@pytest.mark.slow
def test_two_annotators_do_not_meet(opened: Callable[..., Page]) -> None:
    pages = {name: opened(name) for name in ("ada", "bob")}
    for page in pages.values():
        show(page, OBJECT)
    for number in range(1, 5):
        for shift, page in zip((0, 4), pages.values(), strict=True):
            page.keyboard.press(str(number + shift))
    for shift, page in zip((0, 4), pages.values(), strict=True):
        wait(page, "annotate.state.saved", "saved")
        page.reload()
        wait(page, "Boolean(document.documentElement?.dataset.ready)", True)
        assert now(page)["choice"] == 4 + shift


UNKNOWN = "Not saved: the server does not know this page: open the address that it printed"
"""Sessions end with the server."""


def enter(page: Page, server: Server) -> None:
    """Open the address of the person of a page in another window of the same browser."""
    other = page.context.new_page()
    other.goto(server.addresses["ada"])
    other.wait_for_load_state("load")
    other.close()


@pytest.mark.slow
def test_what_is_called_saved_outlives_the_server_and_work_goes_on_without_it(opened: Callable[..., Page], server: Server) -> None:
    page = opened("ada")
    show(page, OBJECT)
    page.keyboard.press("ArrowRight")
    wait(page, "annotate.state.saved", "saved")
    kept = position(page)
    server.kill()
    page.keyboard.press("PageUp")
    wait(page, "document.querySelector('.saved').textContent", "Not saved: the server does not answer")
    page.keyboard.press("PageUp")
    page.keyboard.press("2")
    changed, shown = now(page), page.evaluate("annotate.state.transform")
    page.context.set_offline(True)
    server.start()
    other = opened("ada")
    show(other, OBJECT)
    assert position(other) == kept
    assert page.evaluate("annotate.state.saved") == "unsaved"
    page.context.set_offline(False)
    wait(page, "document.querySelector('.saved').textContent", UNKNOWN)
    enter(page, server)
    wait(page, "annotate.state.saved", "saved")
    assert now(page) == changed
    page.reload()
    wait(page, "Boolean(document.documentElement?.dataset.ready)", True)
    assert now(page) == changed | {"transform": shown}, "what was shown is kept, whatever selection aligns later"


@pytest.mark.slow
def test_edits_while_the_server_is_killed_again_and_again_are_kept(opened: Callable[..., Page], server: Server) -> None:
    """Each time something is called saved it is there after a kill; the page goes on once its person opened the address again."""
    page = opened("ada")
    show(page, OBJECT)
    for _ in range(3):
        page.keyboard.press("ArrowUp")
        page.keyboard.press("PageUp")
        wait(page, "annotate.state.saved", "saved")
        page.keyboard.press(".")  # may be on its way when the server dies
        saved = position(page)
        server.kill()
        server.start()
        enter(page, server)
        wait(page, "annotate.state.saved", "saved")
        answer = page.evaluate("fetch('api/work').then((answer) => answer.json())")
        (row,) = [row for row in answer["objects"] if row["key"] == OBJECT]
        assert row["draft"]["transform"]["position"] == saved
        assert row["draft"]["transform"] == now(page)["transform"]


def test_scripts_in_names_are_shown_and_not_run(opened: Callable[..., Page]) -> None:
    page = opened("ada")
    evil = OBJECTS[3][0]
    show(page, f"{SCENES[0]}/0004")
    for step in "qwe":
        page.keyboard.press(step)
    page.keyboard.press("2")
    assert evil.lower() in page.locator(".pane h2").inner_text().lower()
    assert evil in (page.locator(".ten [data-slot='2']").get_attribute("title") or "")
    assert page.evaluate("window.hacked") is None
    assert page.locator("img[src='x'], .pane b").count() == 0


def test_keys_work_wherever_the_focus_is(opened: Callable[..., Page]) -> None:
    page = opened("ada")
    show(page, OBJECT)
    page.keyboard.press("w")
    for focus in ("[data-field=x]", ".check input", ".ten [data-slot='1']", ".view canvas"):
        page.locator(focus).focus()
        page.keyboard.press("PageUp")
        page.keyboard.press("g")
        assert position(page)[2] == 0, focus
        page.locator(focus).focus()
        page.keyboard.press("z")
        assert position(page)[2] == pytest.approx(TABLE_M + 0.21), focus
        page.keyboard.press("z")
    page.locator("[data-field=x]").focus()
    page.keyboard.press("e")
    page.keyboard.press("5")
    assert now(page)["ranking"] == [5], "numbers are candidates again"
    page.keyboard.press("/")
    page.keyboard.type("box 2 z")
    assert page.locator("input[type=search]").input_value() == "box 2 z"
    assert now(page)["ranking"] == [5]
    page.keyboard.press("Escape")
    page.keyboard.press("?")
    assert page.get_by_role("dialog").is_visible()
    assert page.get_by_role("dialog").locator("dt").count() > 15


@pytest.mark.slow
def test_nothing_is_drawn_while_nothing_changes(opened: Callable[..., Page]) -> None:
    page = opened("ada")
    show(page, OBJECT)
    wait(page, "annotate.stage.own.children.length", 2)
    wait(page, "annotate.stage.canvas.isDirty", False)
    frames = """async () => {
        const before = annotate.state.drawings;
        for (let frame = 0; frame < 20; frame += 1) await new Promise(requestAnimationFrame);
        return annotate.state.drawings - before;
    }"""
    assert page.evaluate(frames) == 0
    page.keyboard.press("f")
    wait(page, "annotate.stage.canvas.isDirty", False)
    assert page.evaluate(frames) == 0


@pytest.mark.slow
def test_the_camera_goes_where_the_photo_was_taken(opened: Callable[..., Page]) -> None:
    page = opened("ada")
    show(page, f"{SCENES[0]}/0003")
    page.get_by_role("button", name="Camera of the photo").click()
    assert page.evaluate("annotate.stage.canvas.camera.position.toArray()") == pytest.approx([0.0, -4.0, 1.0])
    assert "same way" in page.locator("figcaption").inner_text()
    page.keyboard.press("t")
    page.keyboard.press("o")
    wait(page, "document.querySelector('figcaption').textContent.includes('turned')", True)


SHOT_COLOR = """() => {
    const [image, canvas] = [document.querySelector("img.shot"), document.createElement("canvas")];
    if (!image.complete || !image.naturalWidth) return null;
    canvas.getContext("2d").drawImage(image, 0, 0);
    return [...canvas.getContext("2d").getImageData(5, 5, 1, 1).data].slice(0, 3).map((value) => 20 * Math.round(value / 20)).join();
}"""


@pytest.mark.slow
def test_the_photo_follows_the_view(opened: Callable[..., Page]) -> None:
    """Of two photos the one is shown that looks as the view does, and its camera is the one that is gone to."""
    page = opened("ada")
    show(page, f"{SCENES[0]}/0003")
    wait(page, f"({SHOT_COLOR})()", "120,100,60")
    box = page.locator(".stage canvas, canvas").first.bounding_box()
    assert box is not None
    at = (box["x"] + 20, box["y"] + box["height"] - 20)
    page.mouse.move(*at)
    page.mouse.down()
    page.mouse.move(at[0] - box["height"] / 4, at[1], steps=4)  # a quarter turn: the view comes to the right side
    page.mouse.up()
    wait(page, f"({SHOT_COLOR})()", ",".join(str(20 * round(value / 20)) for value in SIDE_COLOR))
    assert page.locator("img.shot").get_attribute("src") == f"api/photos/{SCENES[0]}/0003/000001"
    page.keyboard.press("v")
    assert page.evaluate("annotate.stage.canvas.camera.position.toArray()") == pytest.approx(SIDE[:3, 3].tolist())
    assert "same way" in page.locator("figcaption").inner_text()


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width", [1280, 1024, 700])
def test_everything_fits_and_has_a_name(opened: Callable[..., Page], width: int, scheme: str) -> None:
    page = opened("ada", viewport={"width": width, "height": 800}, color_scheme=scheme)
    assert (page.locator(".object-part").bounding_box() or {"height": 0})["height"] > 100, "the list is seen"
    assert page.evaluate("document.documentElement.scrollWidth") == width
    if width > 1000:
        assert page.evaluate("document.documentElement.scrollHeight") == 800
    nameless = """() => [...document.querySelectorAll("button, input, textarea, img.shot, dialog, progress")].filter((node) =>
        !(node.getAttribute("aria-label") || node.textContent.trim() || node.alt || node.closest("label")?.textContent.trim()),
    ).map((node) => node.outerHTML)"""
    assert page.evaluate(nameless) == []
    ink, paper = page.evaluate("['color', 'backgroundColor'].map((name) => getComputedStyle(document.body)[name])")
    assert ink != paper
