"""The report in a real browser: offline, on a desk and on a phone, light and dark."""

from __future__ import annotations

import itertools
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from flows.stats import write_report
from tasks.stats.scenes import PictureConfig
from tasks.stats.style import INK
from tests.flows.stats.test_stats import CHARTS
from tests.furnished import furnished_lake
from warehouse.lake import Lake

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

pytestmark = [pytest.mark.whole, pytest.mark.browser]

FLAGS = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
DESK, PHONE = {"width": 1280, "height": 900}, {"width": 390, "height": 844}
OBJECTS = 5

CONTRAST = """
() => {
  // colors as numbers, whatever notation the browser computed: a pixel of a canvas has them
  const paint = document.createElement('canvas').getContext('2d', {willReadFrequently: true});
  const rgba = color => {
    paint.clearRect(0, 0, 1, 1); paint.fillStyle = color; paint.fillRect(0, 0, 1, 1);
    return [...paint.getImageData(0, 0, 1, 1).data];
  };
  const light = ([r, g, b]) => [r, g, b].map(v => v / 255)
    .map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4)
    .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
  const ground = node => {
    for (let at = node; at; at = at.parentElement) {
      const color = rgba(getComputedStyle(at).backgroundColor);
      if (color[3] > 200) return color;
    }
    return [255, 255, 255, 255];
  };
  const poor = [];
  let count = 0;
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode.parentElement;
    if (!walker.currentNode.data.trim() || ['SCRIPT', 'STYLE'].includes(node.tagName)) continue;
    const [a, b] = [light(rgba(getComputedStyle(node).color)), light(ground(node))].sort((x, y) => y - x);
    count += 1;
    if ((a + 0.05) / (b + 0.05) < 4.5) poor.push(`${node.tagName} ${walker.currentNode.data.trim().slice(0, 40)}`);
  }
  return {count, poor};
}
"""

OUTSIDE = """
width => [...document.querySelectorAll('main *')].filter(node => {
  // what is wider than the page must be inside something that scrolls by itself
  const box = node.getBoundingClientRect();
  if (box.width === 0 || (box.right <= width + 0.5 && box.left >= -0.5)) return false;
  for (let at = node.parentElement; at; at = at.parentElement) {
    const over = getComputedStyle(at).overflowX;
    if (over === 'auto' || over === 'scroll' || over === 'hidden') return false;
  }
  return true;
}).map(node => node.outerHTML.slice(0, 80))
"""

BOXES = """
images => images.map(image => {
  const box = image.getBoundingClientRect();
  return {left: box.left, top: box.top + scrollY, width: box.width, height: box.height};
})
"""

INKED = """
([index, inks]) => {
  // pixels of a chart in each of some colors
  const image = document.querySelectorAll('.charts img')[index];
  const canvas = document.createElement('canvas');
  [canvas.width, canvas.height] = [image.naturalWidth, image.naturalHeight];
  const paint = canvas.getContext('2d');
  paint.drawImage(image, 0, 0);
  const data = paint.getImageData(0, 0, canvas.width, canvas.height).data;
  const counts = inks.map(() => 0);
  for (let i = 0; i < data.length; i += 4) {
    if (data[i + 3] < 250) continue;
    inks.forEach((ink, k) => { if (ink.every((value, c) => Math.abs(value - data[i + c]) <= 4)) counts[k] += 1; });
  }
  return counts;
}
"""


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return furnished_lake(tmp_path_factory.mktemp("browser") / "lake", scenes=2, objects=OBJECTS)


@pytest.fixture(scope="module")
def report(lake: Lake, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("report") / "report.html"
    return write_report(lake, out, look=PictureConfig(width=400, height=280, oversampling=1), workers=1).path


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    path = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("no chromium on this machine; apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=path, args=list(FLAGS))
        yield started
        started.close()


@pytest.fixture
def opened(browser: Browser, report: Path) -> Iterator[Callable[..., tuple[Page, list[str]]]]:
    """Opens the report with the network blocked; gives the page and what went wrong on it so far."""
    contexts = []

    def open_page(**options: Any) -> tuple[Page, list[str]]:
        context = browser.new_context(**options)
        contexts.append(context)
        context.set_offline(True)
        wrong: list[str] = []
        page = context.new_page()
        page.on("console", lambda message: wrong.append(f"console: {message.text}"))
        page.on("pageerror", lambda error: wrong.append(f"error: {error}"))
        page.on("request", lambda request: wrong.append(request.url) if not request.url.startswith(("data:", report.as_uri())) else None)
        page.goto(report.as_uri(), wait_until="load")
        return page, wrong

    yield open_page
    for context in contexts:
        context.close()


@pytest.mark.parametrize("viewport", [DESK, PHONE], ids=["desk", "phone"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_everything_is_there_without_a_network_and_can_be_read(
    opened: Callable[..., tuple[Page, list[str]]], viewport: dict[str, int], scheme: str
) -> None:
    page, wrong = opened(viewport=viewport, color_scheme=scheme)
    images = page.evaluate("[...document.images].map(image => [image.complete, image.naturalWidth, image.getBoundingClientRect().width])")
    assert len(images) == CHARTS + 2 * 8 + 2 * 2 + 2 + OBJECTS, "a map of fidelity per scene"
    assert all(complete and natural > 0 and shown > 0 for complete, natural, shown in images)
    page.evaluate("document.querySelectorAll('details').forEach(details => { details.open = true })")
    assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]
    assert page.evaluate(OUTSIDE, viewport["width"]) == []
    found = page.evaluate(CONTRAST)
    assert found["count"] > 300
    assert found["poor"] == []
    assert wrong == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_charts_turn_over_with_the_page(opened: Callable[..., tuple[Page, list[str]]], scheme: str) -> None:
    page, wrong = opened(viewport=DESK, color_scheme=scheme)
    inks = [[int(color[at : at + 2], 16) for at in (1, 3, 5)] for color in (INK.light, INK.dark)]
    for index in range(CHARTS):
        if page.locator(".charts figcaption code").nth(index).inner_text() == "category_counts":
            continue  # no word of the cloud is in ink
        light, dark = page.evaluate(INKED, [index, inks])
        assert (light > 20, dark > 20) == ((True, False) if scheme == "light" else (False, True)), index
    assert wrong == []


def test_the_slider_cuts_the_replica_and_side_by_side_shows_it_whole(opened: Callable[..., tuple[Page, list[str]]]) -> None:
    page, wrong = opened(viewport=DESK)
    pair = page.locator(".pair").first
    beside = pair.locator("img").evaluate_all(BOXES)
    assert beside[0]["left"] + beside[0]["width"] <= beside[1]["left"]
    page.get_by_role("button", name="Slider").click()
    over = pair.locator("img").evaluate_all(BOXES)
    assert over[0] == over[1]
    assert over[0]["width"] > 1.9 * beside[0]["width"]
    slider = pair.get_by_role("slider")
    slider.focus()
    page.keyboard.press("End")
    assert slider.input_value() == "100"
    hidden = "node => getComputedStyle(node).clipPath"
    assert "100%" in pair.locator(".views > div").nth(1).evaluate(hidden)
    page.keyboard.press("Home")
    assert "0%" in pair.locator(".views > div").nth(1).evaluate(hidden)
    page.get_by_role("button", name="Side by side").click()
    assert pair.locator("img").evaluate_all(BOXES) == beside
    assert wrong == []


def test_a_link_to_a_view_unfolds_its_sql(opened: Callable[..., tuple[Page, list[str]]]) -> None:
    page, wrong = opened(viewport=PHONE)
    sql = page.locator("#sql-volume_by_category pre")
    assert not sql.is_visible()
    page.locator("a[href='#sql-volume_by_category']").first.click()
    sql.wait_for(state="visible", timeout=2000)
    assert "quantile_cont" in sql.inner_text()
    assert wrong == []


def test_the_report_works_without_scripts(opened: Callable[..., tuple[Page, list[str]]]) -> None:
    page, wrong = opened(viewport=DESK, java_script_enabled=False)
    assert not page.get_by_role("button", name="Slider").is_visible()
    assert page.locator(".pair img").nth(1).is_visible()
    page.locator("summary").first.click()
    assert page.get_by_role("cell", name="chair").first.is_visible()
    assert wrong == []


def test_people_who_do_not_see_it_find_their_way(opened: Callable[..., tuple[Page, list[str]]]) -> None:
    page, _ = opened(viewport=DESK)
    levels = page.evaluate("[...document.querySelectorAll('h1,h2,h3')].map(h => Number(h.tagName[1]))")
    assert levels[0] == 1
    assert all(after - before <= 1 for before, after in itertools.pairwise(levels))
    assert page.evaluate("[...document.images].every(image => image.alt.length > 10)")
    assert page.evaluate("[...document.querySelectorAll('input')].every(input => input.getAttribute('aria-label'))")
    assert page.evaluate("[...document.querySelectorAll('table')].every(table => table.caption && table.querySelector('th[scope]'))")
    assert page.evaluate("document.documentElement.lang") == "en"


def test_galleries_show_as_many_candidates_as_the_lake_has(opened: Callable[..., tuple[Page, list[str]]], lake: Lake) -> None:
    page, wrong = opened(viewport=DESK)
    with lake.snapshot().connect() as connection:
        slots = dict(connection.sql("SELECT scene_id || ' ' || instance_id, count(*) FROM candidates GROUP BY ALL").fetchall())
        placed = connection.sql("SELECT count(*) FROM placements").fetchall()[0][0]
    strips = page.locator(".strip")
    assert strips.count() == OBJECTS  # one of each category
    assert placed >= OBJECTS
    for index in range(strips.count()):
        strip = strips.nth(index)
        name = strip.locator("h3 span").inner_text().split(",")[0]
        assert strip.locator(".candidate").count() == slots[name]
        chosen = strip.locator(".candidate.chosen")
        assert chosen.count() == 1
        assert "chosen" in chosen.inner_text()  # not by color alone
        assert "chosen" in str(chosen.locator("img").get_attribute("alt"))
        assert strip.locator(".candidate", has_text="fallback").count() == 1
        assert strip.locator(".candidate", has_text="empty").count() == 1
    assert page.locator(".gallery li").count() == 2
    page.locator(".gallery a").first.click()
    assert page.evaluate("document.querySelector(location.hash).tagName") == "ARTICLE"
    assert wrong == []


def test_a_film_of_candidates_scrolls_in_its_own_box_by_keyboard(opened: Callable[..., tuple[Page, list[str]]]) -> None:
    page, wrong = opened(viewport={"width": 220, "height": 700})  # narrower than three thumbnails
    film = page.locator(".film").first
    film.focus()
    assert page.evaluate("document.activeElement.className") == "film"
    assert film.evaluate("node => node.scrollWidth > node.clientWidth")
    for _ in range(5):
        page.keyboard.press("ArrowRight")
    for _ in range(60):  # it glides
        if film.evaluate("node => node.scrollLeft") > 20:
            break
        page.wait_for_timeout(50)
    assert film.evaluate("node => node.scrollLeft") > 20
    assert page.evaluate("scrollX") == 0
    assert wrong == []
