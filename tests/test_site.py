"""The site of the documentation: its links and navigation, and the site itself where its tools are installed."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pytest
import yaml

from tasks.pipeline import MODULES, STAGES
from tests.conftest import REPOSITORY


def loaded() -> ModuleType:
    spec = importlib.util.spec_from_file_location("hooks", REPOSITORY / "docs" / "hooks.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


HOOKS = loaded()
PAGES = sorted(path.relative_to(REPOSITORY).as_posix() for path in (*REPOSITORY.glob("*.md"), *(REPOSITORY / "docs").rglob("*.md")))


def listed(entries: list[dict[str, object]]) -> list[str]:
    """Pages of a navigation, in order."""
    contents = [content for entry in entries for content in entry.values()]
    return [page for content in contents for page in (listed(content) if isinstance(content, list) else [content])]


NAVIGATION = listed(yaml.safe_load((REPOSITORY / "mkdocs.yml").read_text())["nav"])


@pytest.mark.parametrize("page", PAGES)
def test_links_of_a_page_lead_to_what_is_there(page: str) -> None:
    targets = {HOOKS.repository_path(target, page) for target, _ in HOOKS.links((REPOSITORY / page).read_text())}
    assert sorted(target for target in targets if not (REPOSITORY / target).exists()) == []


@pytest.mark.parametrize("page", PAGES)
def test_every_page_is_in_the_navigation_once(page: str) -> None:
    assert NAVIGATION.count(HOOKS.site_path(page)) == 1


@pytest.mark.parametrize(
    ("origin", "markdown", "expected"),
    [
        ("README.md", "[a](docs/views.md#b), ![c](docs/plan.png)", "[a](views.md#b), ![c](plan.png)"),
        ("README.md", "[![a](docs/plan.png)](CHANGELOG.md)", "[![a](plan.png)](changelog.md)"),
        ("README.md", '<img src="docs/plan.png"><a href="GLOSSARY.md#x">', '<img src="plan.png"><a href="glossary.md#x">'),
        ("README.md", "[a](LICENSE) and [b](warehouse/questions)", "[a](source/LICENSE.txt) and b"),
        ("docs/views.md", "[a](../README.md) [b](tables.md) [c](#d)", "[a](index.md) [b](tables.md) [c](#d)"),
        ("docs/views.md", "[a](../schemas/record.py)", "[a](source/schemas/record.py.txt)"),
        ("docs/views.md", "[a](analysis.py)", "[a](source/docs/analysis.py.txt)"),
        ("docs/views.md", "[a](https://example.org/README.md) [b](nosuch.md)", "[a](https://example.org/README.md) [b](nosuch.md)"),
        ("docs/views.md", "```\n[a](../README.md)\n```\n[a](../README.md)", "```\n[a](../README.md)\n```\n[a](index.md)"),
        ("docs/views.md", "| `a\\|b` | a\\|b |", "| `a|b` | a\\|b |"),
    ],
)  # fmt: skip
def test_links_lead_to_the_same_in_the_site(origin: str, markdown: str, expected: str) -> None:
    assert HOOKS.site_text(markdown, origin) == expected


def test_every_module_of_the_product_has_its_place_in_the_api() -> None:
    shown = [name for folder in HOOKS.api_folders() for name in re.findall(r"(?m)^::: (\S+)$", HOOKS.api_text(folder))]
    modules = {path for room in HOOKS.ROOMS for path in (REPOSITORY / room).rglob("*.py") if path.stem != "__main__"}
    names = {".".join(path.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__") for path in modules}
    assert sorted(shown) == sorted(names)


def named(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def test_the_data_path_of_the_architecture_is_that_of_the_declarations() -> None:
    page = (REPOSITORY / "ARCHITECTURE.md").read_text()
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in page.splitlines() if line.startswith("| `")]
    path = {named(row[0])[0]: row[1:] for row in rows if named(row[0])[0] in MODULES}
    assert list(path) == [stage.name for stage in STAGES]
    for stage in STAGES:
        outside, reads, writes = path[stage.name]
        assert [word.replace(" ", "_") for word in outside.split(", ") if word] == list(stage.outside)
        assert named(reads) == [*stage.reads, *stage.streams, *stage.history]
        assert named(writes) == list(stage.writes)


@pytest.mark.parametrize("room", ["warehouse", "flows"])
def test_the_folders_of_a_room_are_those_of_the_architecture(room: str) -> None:
    (line,) = re.findall(rf"(?m)^- `{room}/`: (.*)$", (REPOSITORY / "ARCHITECTURE.md").read_text())
    assert sorted(named(re.sub(r"\([^)]*\)", "", line))) == sorted(path.parent.name for path in (REPOSITORY / room).glob("*/__init__.py"))


def pins(name: str) -> dict[str, str]:
    lines = (REPOSITORY / "requirements" / f"{name}.lock").read_text().splitlines()
    return dict(line.split("==") for line in lines if not line.startswith("#"))


def test_the_lock_of_the_site_names_versions_that_go_with_the_other_locks() -> None:
    run, test, docs = pins("run"), pins("test"), pins("docs")
    assert not docs.keys() & run.keys()
    assert {name: test[name] for name in docs.keys() & test.keys()} == {name: docs[name] for name in docs.keys() & test.keys()}
    extra = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]["optional-dependencies"]["docs"]
    assert {re.split(r"[\[<>=]", package)[0] for package in extra} <= docs.keys()


@pytest.mark.slow
def test_the_site_is_whole_and_fetches_nothing_from_elsewhere(tmp_path: Path) -> None:
    pytest.importorskip("material", reason="the site's tools are not installed (make docs)")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(command, capture_output=True, text=True, cwd=REPOSITORY, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    pages = {page.relative_to(tmp_path / "site").as_posix(): page.read_text() for page in (tmp_path / "site").rglob("*.html")}
    for page in PAGES:
        assert HOOKS.site_path(page).replace(".md", ".html") in pages
    for name, text in pages.items():
        sources = re.findall(r"<(?:script|img|iframe|source)\b[^>]*\bsrc=\"?([^\"\s>]+)", text) + re.findall(
            r"<link\b(?=[^>]*\brel=\"?(?:stylesheet|icon|preload|preconnect))[^>]*\bhref=\"?([^\"\s>]+)", text
        )
        assert sources, name
        assert [source for source in sources if re.match(r"(\w+:)?//", source)] == []
    index = (tmp_path / "site" / "search" / "search_index.json").read_text()
    for word in ("views.html#stability", "commands.html#metascenes-lake-vacuum", "api/warehouse.html#warehouse.lake.Lake.commit"):
        assert f'"{word}"' in index
