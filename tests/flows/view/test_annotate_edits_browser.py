"""What becomes of edits on the annotation page while others are on their way, refused, or of an object that is answered already."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from tests.flows.view import test_annotate_browser as pages
from tests.flows.view.asked import OBJECTS, SCENES, TABLE_M
from tests.flows.view.test_annotate_browser import OBJECT, now, position, show, wait

if TYPE_CHECKING:
    from playwright.sync_api import Page, Route

pytestmark = pages.pytestmark
room, lake, server, browser, opened = pages.room, pages.lake, pages.server, pages.browser, pages.opened

OTHER = f"{SCENES[0]}/0003"
"""The object after `OBJECT` in the list."""


class Held:
    """Requests of a page that wait until they are let through."""

    def __init__(self, page: Page, pattern: str, method: str) -> None:
        self.page, self.method, self.is_open = page, method, False
        self.routes: list[Route] = []
        page.route(pattern, self._hold)

    def _hold(self, route: Route) -> None:
        if route.request.method == self.method and not self.is_open:
            self.routes.append(route)
        else:
            route.continue_()

    def wait(self, count: int = 1) -> None:
        """Until so many wait."""
        while len(self.routes) < count:
            self.page.wait_for_timeout(10)

    def let(self) -> None:
        """Let through what waits, and what comes later."""
        self.is_open = True
        for route in self.routes:
            route.continue_()


def status_of(key: str) -> str:
    """An expression: the status of an object on the page."""
    return f"annotate.state.listed.find(([key]) => key === '{key}')[1]"


@pytest.mark.slow
def test_what_is_typed_while_the_answer_before_is_saved_is_a_number(opened: Callable[..., Page]) -> None:
    page = opened("ada")
    show(page, OBJECT)
    answers = Held(page, "**/api/answers/**", "POST")
    page.keyboard.press("Control+Enter")
    wait(page, "document.documentElement.dataset.shown", OTHER)
    before = now(page)["choice"]
    page.locator("[data-field=x]").focus()
    page.keyboard.press("Control+a")
    page.keyboard.type("1")
    answers.wait()
    answers.let()
    wait(page, status_of(OBJECT), "answered")
    page.keyboard.type(".25")
    page.keyboard.press("Enter")
    assert position(page)[0] == 1.25
    assert now(page)["choice"] == before


def test_a_number_that_was_typed_is_of_the_object_that_was_shown(opened: Callable[..., Page]) -> None:
    """Also where the next one is shown, or the answer is saved, before the field was left."""
    page = opened("ada")
    show(page, OBJECT)
    for leave in ("n", "Control+Enter"):
        show(page, OBJECT)
        page.locator("[data-field=x]").fill("0.75" if leave == "n" else "0.5")
        page.keyboard.press(leave)
        wait(page, "document.documentElement.dataset.shown", OTHER)
        assert position(page) == [1.5, 0.0, 0.0]
    wait(page, status_of(OBJECT), "answered")
    show(page, OBJECT)
    assert position(page)[0] == 0.5


@pytest.mark.slow
def test_edits_after_a_look_at_another_tab_are_kept(opened: Callable[..., Page]) -> None:
    """Drafts are read anew then; the page goes on counting where it was, also for what was answered."""
    page = opened("ada")
    show(page, OBJECT)
    for _ in range(3):
        page.keyboard.press("PageUp")
        wait(page, "annotate.state.saved", "saved")
    page.keyboard.press("Control+Enter")
    wait(page, status_of(OBJECT), "answered")
    page.evaluate("annotate.open(false)")
    wait(page, status_of(OBJECT), "answered")
    show(page, OBJECT)
    page.keyboard.press("b")
    wait(page, "annotate.state.saved", "saved")
    kept = position(page)
    assert kept[2] == pytest.approx(TABLE_M, abs=1e-5)
    page.reload()
    wait(page, "Boolean(document.documentElement?.dataset.ready)", True)
    show(page, OBJECT)
    assert (page.evaluate("annotate.state.status"), position(page)) == ("draft", kept)


@pytest.mark.slow
def test_what_is_refused_stays_unsaved_until_it_is_taken(opened: Callable[..., Page]) -> None:
    """However much else is saved meanwhile, and whatever is shown; the object is named, and leaving the page warns."""
    page = opened("ada")
    show(page, OBJECT)

    def refuse(route: Route) -> None:
        route.fulfill(status=409, json={"error": "it cannot be kept"})

    page.route(f"**/api/drafts/{OBJECT}", refuse)
    page.keyboard.press("PageUp")
    told = "Not saved: box 0002: it cannot be kept"
    wait(page, "document.querySelector('.saved').textContent", told)
    changed = position(page)
    show(page, OTHER)
    with page.expect_response("**/api/drafts/**") as answer:
        page.keyboard.press("PageUp")
    assert answer.value.status == 200
    wait(page, "annotate.saving.pending.size", 0)
    assert page.locator(".saved").inner_text() == told
    assert page.evaluate("!dispatchEvent(new Event('beforeunload', { cancelable: true }))"), "leaving warns"
    page.evaluate("annotate.open(false)")
    show(page, OBJECT)
    assert position(page) == changed
    page.unroute(f"**/api/drafts/{OBJECT}")
    page.keyboard.press("PageUp")
    wait(page, "annotate.state.saved", "saved")
    assert not page.evaluate("!dispatchEvent(new Event('beforeunload', { cancelable: true }))")


@pytest.mark.slow
def test_what_came_too_slowly_is_sent_again(opened: Callable[..., Page]) -> None:
    page = opened("ada")
    show(page, OBJECT)
    path = f"**/api/drafts/{OBJECT}"
    page.route(path, lambda route: route.fulfill(status=408, json={"error": "body: was not sent"}), times=1)
    page.keyboard.press("PageUp")
    wait(page, "document.querySelector('.saved').textContent", "Not saved: body: was not sent")
    wait(page, "annotate.state.saved", "saved")


@pytest.mark.slow
def test_edits_while_an_answer_is_taken_back_are_a_draft(opened: Callable[..., Page]) -> None:
    page = opened("ada")
    show(page, OBJECT)
    page.keyboard.press("Control+Enter")
    wait(page, status_of(OBJECT), "answered")
    show(page, OBJECT)
    held = Held(page, "**/api/answers/**", "POST")
    page.get_by_role("button", name="Take the answer back").click()
    held.wait()
    page.keyboard.press("b")
    wait(page, "annotate.state.saved", "saved")
    kept = position(page)
    with page.expect_response("**/api/answers/**") as answer:
        held.let()
    assert answer.value.status == 200
    wait(page, "[annotate.state.saved, annotate.state.status].join()", "saved,draft")
    with page.expect_response("**/api/progress"):
        page.evaluate("annotate.handing.queue.then(() => annotate.saving.flush()).then(() => annotate.progress())")
    page.reload()
    wait(page, "Boolean(document.documentElement?.dataset.ready)", True)
    show(page, OBJECT)
    assert (page.evaluate("annotate.state.status"), position(page)) == ("draft", kept)


@pytest.mark.slow
def test_what_is_saved_is_the_asset_that_was_shown_where_it_was_shown(opened: Callable[..., Page]) -> None:
    """Slots and what selection aligned may mean something else in a later snapshot."""
    page = opened("ada")
    show(page, OBJECT)
    page.keyboard.press("3")
    page.keyboard.press("e")
    page.keyboard.press("5")
    wait(page, "annotate.state.saved", "saved")
    third, fifth = page.evaluate("[3, 5].map((slot) => annotate.draft.candidate(slot))")
    draft = page.evaluate(
        f"fetch('api/work').then((answer) => answer.json()).then((told) => told.objects.find((row) => row.key === '{OBJECT}').draft)"
    )
    with page.expect_request("**/api/answers/**") as request:
        page.keyboard.press("Control+Enter")
    for body in (draft, request.value.post_data_json):
        assert (body["choice"], body["ranking"]) == (third["asset_id"], [third["asset_id"], fifth["asset_id"]])
        assert body["transform"] == third["transform"]
    wait(page, status_of(OBJECT), "answered")
    page.reload()
    wait(page, "Boolean(document.documentElement?.dataset.ready)", True)
    show(page, OBJECT)
    assert {name: now(page)[name] for name in ("choice", "ranking")} == {"choice": 3, "ranking": [5]}


@pytest.mark.slow
def test_a_draft_of_an_asset_that_is_no_candidate_any_more_is_not_saved_as_an_answer(opened: Callable[..., Page]) -> None:
    page = opened("ada")
    show(page, OBJECT)
    strange = {"choice": "f" * 64, "transform": None, "ranking": [], "seconds": 1, "edit": 1}
    keep = """([key, draft]) => fetch(`api/drafts/${key}`, {
        method: "PUT", headers: { "content-type": "application/json" }, body: JSON.stringify(draft),
    }).then((answer) => answer.status)"""
    assert page.evaluate(keep, [OBJECT, strange]) == 200
    page.reload()
    wait(page, "Boolean(document.documentElement?.dataset.ready)", True)
    show(page, OBJECT)
    told = "What was chosen is no candidate any more: choose again."
    assert page.locator(".status").inner_text() == told
    page.keyboard.press("Control+Enter")
    assert page.evaluate("annotate.state.status") == "draft"
    page.keyboard.press("x")
    page.keyboard.press("Control+Enter")
    wait(page, status_of(OBJECT), "answered")


@pytest.mark.slow
def test_candidates_that_have_changed_are_said_in_words(opened: Callable[..., Page]) -> None:
    page = opened("ada")
    show(page, OBJECT)
    reason = "the scene's candidates have changed since the server was started; start it again"
    page.route("**/api/answers/**", lambda route: route.fulfill(status=409, json={"error": reason}))
    page.keyboard.press("Control+Enter")
    wait(page, "document.querySelector('.status').textContent", f"box 0002 is kept as a draft, and not saved: {reason}")
    assert page.evaluate(status_of(OBJECT)) == "draft"


@pytest.mark.slow
def test_a_touched_answer_can_be_left_as_it_was(opened: Callable[..., Page]) -> None:
    """Its draft is thrown away; until then the hand-in tells it from what is not answered."""
    page = opened("ada")
    show(page, OBJECT)
    page.keyboard.press("b")
    page.keyboard.press("Control+Enter")
    wait(page, status_of(OBJECT), "answered")
    for is_new in (False, True):
        if is_new:
            page.reload()
            wait(page, "Boolean(document.documentElement?.dataset.ready)", True)
        show(page, OBJECT)
        answered = (now(page)["choice"], position(page))
        page.keyboard.press("2")
        page.keyboard.press("PageUp")
        wait(page, "annotate.state.saved", "saved")
        page.get_by_role("button", name="Hand in").click()
        texts = page.get_by_role("dialog").locator("p").all_inner_texts()
        assert texts[0].startswith(f"{len(OBJECTS) - 1} of your {len(OBJECTS)} objects are not answered")
        assert texts[1].startswith("1 of them changed since answered")
        page.get_by_role("button", name="Cancel").click()
        page.get_by_role("button", name="Back to my answer").click()
        wait(page, status_of(OBJECT), "answered")
        assert (now(page)["choice"], position(page)) == (answered[0], pytest.approx(answered[1]))
        assert page.evaluate("annotate.state.saved") == "saved"
    page.reload()
    wait(page, "Boolean(document.documentElement?.dataset.ready)", True)
    show(page, OBJECT)
    assert (page.evaluate("annotate.state.status"), now(page)["choice"]) == ("answered", answered[0])
    page.keyboard.press("PageUp")
    wait(page, "[annotate.state.saved, annotate.state.status].join()", "saved,draft")


@pytest.mark.slow
def test_nothing_is_computed_that_nobody_waits_for(opened: Callable[..., Page]) -> None:
    """Figures of an edit before are called off, and an object that is settling is not settled twice."""
    page = opened("ada")
    show(page, OBJECT)
    wait(page, "Boolean(annotate.state.figures)", True)
    ended: list[str] = []
    page.on("requestfailed", lambda request: ended.append(request.url))
    figures = Held(page, "**/api/figures/**", "POST")
    page.keyboard.press("PageUp")
    figures.wait(1)
    page.keyboard.press("PageUp")
    figures.wait(2)
    while not ended:
        page.wait_for_timeout(10)
    assert ended == [figures.routes[0].request.url]
    del figures.routes[0]
    figures.let()
    wait(page, "annotate.state.figures?.floating_m?.toFixed(3)", "0.220")
    settling = Held(page, "**/api/settle/**", "POST")
    page.keyboard.press("l")
    page.keyboard.press("l")
    settling.wait()
    settling.let()
    wait(page, "document.querySelector('.status').textContent.startsWith('Settled')", True)
    assert len(settling.routes) == 1
    wait(page, "document.querySelector('[data-figure=floating]')?.className", "")
