"""The report in a real browser: offline, on a desk and on a phone, light and dark."""

from __future__ import annotations

import csv
import io
import itertools
import re
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from flows.stats import write_report
from tasks.stats.columns import GRIDS
from tasks.stats.scenes import PictureConfig
from tasks.stats.style import INK, SERIES
from tests.flows.stats.test_stats import CHARTS
from tests.furnished import furnished_lake
from warehouse.lake import Lake

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Locator, Page

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
    if (!walker.currentNode.data.trim() || ['SCRIPT', 'STYLE'].includes(node.tagName) || node.closest('[hidden]')) continue;
    const style = getComputedStyle(node);
    if (node.closest('.plan') && style.fill === 'rgb(31, 27, 22)') continue; // on the footprint that it names
    const [a, b] = [light(rgba(node instanceof SVGElement ? style.fill : style.color)), light(ground(node))].sort((x, y) => y - x);
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

FILLS = """
() => [...document.querySelectorAll('.charts svg')].map(svg => [...svg.querySelectorAll('text')].map(text => getComputedStyle(text).fill))
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
    assert len(images) == 2 * 6 + 2 * 2 + OBJECTS
    assert all(complete and natural > 0 and shown > 0 for complete, natural, shown in images)
    widths = page.evaluate("[...document.querySelectorAll('svg')].map(svg => svg.getBoundingClientRect().width)")
    assert len(widths) == CHARTS + 2 * 3, "of each scene its loss curve, floor plan and map of fidelity"
    assert all(200 < width <= viewport["width"] for width in widths)
    page.evaluate("document.querySelectorAll('details').forEach(details => { details.open = true })")
    assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]
    assert page.evaluate(OUTSIDE, viewport["width"]) == []
    captions = page.locator("caption span").evaluate_all("spans => spans.map(span => span.getBoundingClientRect().right)")
    assert captions
    assert max(captions) <= viewport["width"], "a table that is wider than the page has a caption that is not"
    found = page.evaluate(CONTRAST)
    assert found["count"] > 300
    assert found["poor"] == []
    assert wrong == []


INJECTED = """
async () => {
  const blocked = new Set();
  document.addEventListener('securitypolicyviolation', event => blocked.add(event.effectiveDirective));
  const script = document.createElement('script');
  script.textContent = 'window.hacked = 1';
  const style = document.createElement('style');
  style.textContent = 'body { display: none }';
  const image = document.createElement('img');
  image.setAttribute('onerror', 'window.hacked = 2');
  document.body.append(script, style, image);
  image.src = 'data:,';
  await new Promise(resolve => { image.addEventListener('error', () => setTimeout(resolve)); });
  return [window.hacked ?? null, getComputedStyle(document.body).display, [...blocked].sort()];
}
"""


def test_what_others_put_into_the_report_does_not_run(opened: Callable[..., tuple[Page, list[str]]]) -> None:
    page, wrong = opened(viewport=DESK)
    assert wrong == [], "its own script and style do"
    assert page.evaluate("document.documentElement.classList.contains('js')")
    assert page.evaluate(INJECTED) == [None, "block", ["script-src-attr", "script-src-elem", "style-src-elem"]]


def rgb(color: str) -> str:
    """A color `#rrggbb` as browsers say it."""
    return "rgb({}, {}, {})".format(*(int(color[at : at + 2], 16) for at in (1, 3, 5)))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_charts_turn_over_with_the_page(opened: Callable[..., tuple[Page, list[str]]], scheme: str) -> None:
    page, wrong = opened(viewport=DESK, color_scheme=scheme)
    ink = rgb(INK.light if scheme == "light" else INK.dark)
    fills = page.evaluate(FILLS)
    names = page.locator(".charts figcaption").all_inner_texts()
    assert len(fills) == len(names) == CHARTS + 2, "a map of fidelity per scene"
    for name, of in zip(names, fills, strict=True):
        if name == "View category_counts" and ink not in of:  # no word of the cloud is in ink
            assert {rgb(tone.light if scheme == "light" else tone.dark) for tone in SERIES} >= set(of)
        else:
            assert ink in of, name
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
    page.get_by_role("button", name="Side by side", exact=True).click()
    assert pair.locator("img").evaluate_all(BOXES) == beside
    assert wrong == []


def test_a_link_to_a_view_unfolds_its_sql(opened: Callable[..., tuple[Page, list[str]]]) -> None:
    page, wrong = opened(viewport=PHONE)
    sql = page.locator("#sql-volume_by_category pre")
    assert not sql.is_visible()
    page.locator("a[href='#sql-volume_by_category']").first.click()
    sql.wait_for(state="visible")
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


@pytest.mark.parametrize("viewport", [DESK, PHONE], ids=["desk", "phone"])
def test_the_bar_of_sections_stays_and_says_where_one_is(opened: Callable[..., tuple[Page, list[str]]], viewport: dict[str, int]) -> None:
    page, wrong = opened(viewport=viewport, reduced_motion="reduce")
    bar = page.locator("nav")
    links = bar.locator("a")
    names = links.all_inner_texts()
    assert len(names) > 10
    for name in (names[2], names[-1], names[0]):
        links.get_by_text(name, exact=True).click()
        bar.locator("a[aria-current]", has_text=re.compile(f"^{name}$")).wait_for()
        box = bar.bounding_box()
        assert box is not None
        assert (box["x"], box["y"]) == (0, 0), "it sticks to the top"
        current = bar.locator("a[aria-current]").bounding_box()
        assert current is not None
        assert current["x"] >= 0, "and what is marked is in sight"
        assert current["x"] + current["width"] <= viewport["width"]
        title = page.evaluate("document.querySelector(location.hash + ' h2').getBoundingClientRect().top")
        assert name == names[-1] or title >= box["height"], "the bar does not hide the title"
    assert page.evaluate("document.querySelectorAll('main section[id]').length") == len(names), "every section is in it"
    assert wrong == []


def rows_of(grid: Locator) -> list[list[str]]:
    """Texts of the rows that are shown, as the page has them."""
    read = "body => [...body.rows].filter(row => !row.hidden).map(row => [...row.cells].map(cell => cell.textContent))"
    rows: list[list[str]] = grid.locator("tbody").evaluate(read)
    return rows


def test_tables_are_sorted_by_what_their_cells_mean(opened: Callable[..., tuple[Page, list[str]]], lake: Lake) -> None:
    page, wrong = opened(viewport=DESK)
    grid = page.locator("[data-file=export_verdicts]")
    before = rows_of(grid)
    with lake.snapshot().connect() as connection:
        sizes = connection.sql("SELECT scene_id, format, size_bytes FROM export_verdicts").fetchall()
    names = grid.locator("th").all_inner_texts()
    at = names.index("Size")
    head = grid.locator("th").nth(at)
    for asked, sign in (("ascending", 1), ("descending", -1)):
        head.get_by_role("button").click()
        assert head.get_attribute("aria-sort") == asked
        known = {(scene, form): size for scene, form, size in sizes}
        shown = [known[row[0], row[1]] for row in rows_of(grid)]
        assert shown == sorted(shown, key=lambda size: sign * size)
        assert sorted(rows_of(grid)) == sorted(before)
    head.get_by_role("button").click()
    assert head.get_attribute("aria-sort") is None
    assert rows_of(grid) == before, "as it was"
    first = grid.locator("th").first
    first.get_by_role("button").focus()
    page.keyboard.press("Enter")
    assert first.get_attribute("aria-sort") == "ascending"
    assert wrong == []


def test_missing_numbers_come_last_however_a_table_is_sorted(opened: Callable[..., tuple[Page, list[str]]]) -> None:
    page, wrong = opened(viewport=DESK)
    page.locator("details", has_text="Objects (").first.locator("summary").click()
    grid = page.locator("[data-file^=scene_objects-]").first
    at = grid.locator("th").all_inner_texts().index("Lifted [m]")
    grid.locator("tbody").evaluate(
        "(body, at) => { const cell = body.rows[1].cells[at]; cell.textContent = '\u2013'; cell.dataset.raw = ''; }", at
    )
    for _ in range(2):
        grid.locator("th").nth(at).get_by_role("button").click()
        assert [row[at] for row in rows_of(grid)].index("\u2013") == len(rows_of(grid)) - 1
    assert wrong == []


@pytest.mark.parametrize("viewport", [DESK, PHONE], ids=["desk", "phone"])
def test_a_table_is_filtered_and_taken_away_as_csv(
    opened: Callable[..., tuple[Page, list[str]]], lake: Lake, viewport: dict[str, int]
) -> None:
    page, wrong = opened(viewport=viewport)
    filters = page.get_by_role("searchbox", name="Filter: Exports", exact=True)
    filters.fill("room_1 USD")
    grid = page.locator("[data-file=export_verdicts]")
    shown = rows_of(grid)
    assert [(row[0], row[1]) for row in shown] == [("demo/room_1", "usd")]
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Download as CSV: Exports", exact=True).click()
    assert waiting.value.suggested_filename == "export_verdicts.csv"
    (row,) = csv.DictReader(io.StringIO(Path(waiting.value.path()).read_text(encoding="utf-8"), newline=""))
    with lake.snapshot().connect() as connection:
        columns = ", ".join(name for name, _, _ in GRIDS["export_verdicts"][1])
        asked = connection.sql(f"SELECT {columns} FROM export_verdicts WHERE scene_id = 'demo/room_1' AND format = 'usd'")
        (known,) = asked.to_arrow_table().to_pylist()
    assert row == {name: ("yes" if value else "no") if isinstance(value, bool) else str(value) for name, value in known.items()}
    filters.fill("")
    assert len(rows_of(grid)) > 1
    assert wrong == []


def test_numbers_of_a_csv_are_whole_and_texts_are_no_formulas(opened: Callable[..., tuple[Page, list[str]]], lake: Lake) -> None:
    page, wrong = opened(viewport=DESK)
    grid = page.locator("[data-file=stability]").first
    evil = ['=HYPERLINK("http://x","y")', "@SUM(1)", "-1", 'a, "b"\nc']
    grid.locator("tbody").evaluate(
        "(body, texts) => texts.slice(0, body.rows.length).forEach((text, at) => { body.rows[at].cells[1].textContent = text; })", evil
    )
    with page.expect_download() as waiting:
        page.get_by_role("button", name="Download as CSV: Left alone under gravity").click()
    rows = list(csv.DictReader(io.StringIO(Path(waiting.value.path()).read_text(encoding="utf-8"), newline="")))
    assert [row["engine"] for row in rows] == [text if text.startswith("a") else "'" + text for text in evil[: len(rows)]]
    with lake.snapshot().connect() as connection:
        known = dict(connection.sql("SELECT scene_id, stable_5cm_share FROM stability").fetchall())
    assert {row["scene_id"]: float(row["stable_5cm_share"]) for row in rows} == known
    assert wrong == []


@pytest.mark.parametrize("viewport", [DESK, PHONE], ids=["desk", "phone"])
def test_charts_say_their_numbers_to_pointer_finger_and_keys(
    opened: Callable[..., tuple[Page, list[str]]], lake: Lake, viewport: dict[str, int]
) -> None:
    page, wrong = opened(viewport=viewport, has_touch=viewport is PHONE, reduced_motion="reduce")
    chart = page.locator(".charts svg", has=page.locator(".tip")).first
    with lake.snapshot().connect() as connection:
        rows = connection.sql("SELECT scene_id, objects FROM objects_per_scene ORDER BY scene_id").fetchall()
    said = [f"{scene}: {objects} objects" for scene, objects in rows]
    tip = page.get_by_role("status").and_(page.locator("#tip"))
    marks = chart.locator(".tip")
    assert marks.evaluate_all("marks => marks.map(mark => mark.getAttribute('aria-label'))") == said
    assert page.locator("svg title").count() == 0, "the browser shows none of its own"
    marks.nth(1).scroll_into_view_if_needed()
    (marks.nth(1).tap if viewport is PHONE else marks.nth(1).hover)()
    assert tip.inner_text() == said[1]
    box = tip.bounding_box()
    assert box is not None
    assert box["x"] >= 0
    assert box["x"] + box["width"] <= viewport["width"]
    page.keyboard.press("Escape")
    assert not tip.is_visible()
    chart.focus()
    for key, at in (
        ("ArrowRight", 0),
        ("ArrowDown", 1),
        ("ArrowRight", 0),
        ("End", len(said) - 1),
        ("ArrowLeft", len(said) - 2),
        ("Home", 0),
    ):
        page.keyboard.press(key)
        assert tip.inner_text() == said[at], key
    page.evaluate("document.activeElement.blur()")
    assert not tip.is_visible()
    assert wrong == []
