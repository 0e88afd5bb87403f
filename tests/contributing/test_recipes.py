"""The recipes of CONTRIBUTING.md: each is followed as it stands, in a copy of the repository, and gives what it promises."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY

pytestmark = pytest.mark.whole

PAGE = (REPOSITORY / "CONTRIBUTING.md").read_text()
BLOCK = re.compile(r"^([^\n]*)\n\n```(\w+)\n(.*?\n)(?=```$)", re.DOTALL | re.MULTILINE)
FILE = re.compile(r"`([\w./-]+/[\w.-]+\.\w+)`")
HEADINGS = ("A scan format", "A candidate provider", "A stage", "An export format", "A SQL view")


def blocks(heading: str) -> list[tuple[str, str, str]]:
    """The blocks below a heading: the line above, the kind, the text."""
    return [match.groups() for match in BLOCK.finditer(PAGE.split(f"\n## {heading}\n")[1].split("\n## ")[0])]


PREPARE = next(text for _, kind, text in BLOCK.findall(PAGE.split("\n## ")[0]) if kind == "bash" and "tryout" in text)


class Copy:
    """A copy of the tracked files, with an environment of its own that has this interpreter and its packages."""

    def __init__(self, folder: Path, home: Path) -> None:
        self.folder = folder
        environment = folder / ".venv"
        environment.mkdir(parents=True)
        for path in Path(sys.prefix).iterdir():
            if not path.name.startswith("."):
                (environment / path.name).symlink_to(path)
        kept = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "METASCENES_", "NUMBA_", "PYTEST_"))}
        path = os.pathsep.join([str(environment / "bin"), os.environ["PATH"]])
        caches = {"HOME": str(home), "XDG_CACHE_HOME": str(home / ".cache"), "MYPY_CACHE_DIR": str(home / "mypy")}
        self.environment = {**kept, **caches, "PATH": path, "PYTHONPATH": str(folder), "NO_COLOR": "1", "COLUMNS": "200"}
        self.restore()

    def restore(self) -> None:
        """Make all files those of the repository again. What was compiled is kept: the times of sources are theirs."""
        for path in self.folder.rglob("*"):
            if path.is_file() and not path.is_relative_to(self.folder / ".venv") and path.suffix not in (".nbi", ".nbc"):
                path.unlink()
        listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        names = subprocess.run(listed, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout.split("\0")
        compiled = [path.relative_to(REPOSITORY).as_posix() for path in (REPOSITORY / "tasks").rglob("*.nb[ic]")]
        for name in filter(None, [*names, *compiled]):
            path = self.folder / name
            if (REPOSITORY / name).is_file() and not path.exists():
                path.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(REPOSITORY / name, path)
        for name in (".made", ".run-ready", ".train-ready", ".test-ready"):
            (self.folder / ".venv" / name).touch()

    def run(self, text: str, code: int = 0) -> str:
        """What commands print."""
        done = subprocess.run(["bash", "-euc", text], cwd=self.folder, env=self.environment, capture_output=True, text=True, timeout=3550)
        assert done.returncode == code, done.stdout + done.stderr
        return done.stdout

    def ask(self, query: str) -> list[list[object]]:
        """Rows that a query on the lake of the recipe gives, as lists."""
        done = self.run(f"metascenes sql {json.dumps(query)} --lake tryout/lake --json")
        return [list(row.values()) for row in json.loads(done)]

    def read(self, name: str) -> str:
        return (self.folder / name).read_text()

    def follow(self, heading: str) -> list[str]:
        """Do what a recipe says, block by block; what each block of commands printed."""
        printed: list[str] = []
        for above, kind, text in blocks(heading):
            if kind == "bash":
                printed.append(self.run(text))
            elif kind == "text":
                shows(printed[-1], text)
            else:
                self.write(above, kind, text)
        return printed

    def write(self, above: str, kind: str, text: str) -> None:
        """Write or change the file that the line above a block names."""
        named = FILE.search(above)
        assert named, f"names no file: {above}"
        path = self.folder / named[1]
        if kind != "diff":
            assert not path.exists(), named[1]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text)
            return
        old, new = ("".join(line[1:] for line in text.splitlines(keepends=True) if line[0] in signs) for signs in (" -", " +"))
        assert path.read_text().count(old) == 1, f"{named[1]} has not, once:\n{old}"
        path.write_text(path.read_text().replace(old, new))


def shows(printed: str, expected: str) -> None:
    """Assert that lines are printed in their order, blanks and what stands around them aside."""
    lines: Iterator[str] = (" ".join(line.split()) for line in printed.splitlines())
    for wanted in expected.splitlines():
        assert any(" ".join(wanted.split()) in line for line in lines), f"{wanted!r} is not in its place in:\n{printed}"


@pytest.fixture(scope="module")
def prepared(tmp_path_factory: pytest.TempPathFactory) -> Copy:
    """A copy with the lake that all recipes build on."""
    folder = tmp_path_factory.mktemp("recipes")
    copy = Copy(folder / "copy", folder / "home")
    copy.run(PREPARE)
    shutil.move(copy.folder / "tryout", folder / "tryout")
    return copy


@pytest.fixture
def copied(prepared: Copy) -> Copy:
    prepared.restore()
    shutil.rmtree(prepared.folder / "tryout", ignore_errors=True)
    shutil.copytree(prepared.folder.parent / "tryout", prepared.folder / "tryout")
    return prepared


def test_every_recipe_is_followed_here() -> None:
    assert tuple(re.findall(r"^## (.*)$", PAGE, re.MULTILINE)[:-1]) == HEADINGS
    assert len(BLOCK.findall(PAGE)) == PAGE.count("\n```") // 2, "a line that says what it is stands above each block"
    assert all({"bash", "text"} <= {kind for _, kind, _ in blocks(heading)} for heading in HEADINGS)


@pytest.mark.slow
def test_a_scan_format(copied: Copy) -> None:
    copied.follow("A scan format")
    scenes = "SELECT scene_id, room_id, scan_format FROM scenes ORDER BY scene_id"
    assert copied.ask(scenes) == [["scannet/scene0000_00", "scannet/scene0000", "scannet"], ["spans/room_1", "spans/room_1", "spans"]]
    labels = "SELECT category, count(*) FROM instances WHERE scene_id = 'spans/room_1' GROUP BY category ORDER BY category"
    assert copied.ask(labels) == [["ceiling", 1], ["chair", 1], ["floor", 1], ["wall", 4]]
    for command in ("run", "watch"):
        assert "spans" in copied.run(f"metascenes {command} --help")


@pytest.mark.slow
def test_a_candidate_provider(copied: Copy) -> None:
    copied.follow("A candidate provider")
    assert copied.ask("SELECT DISTINCT provider, provider_version, is_fallback, outcome FROM candidates") == [
        ["point_hull", "1", False, "filled"]
    ]
    assert copied.ask("SELECT provider, is_watertight, license FROM assets") == [["point_hull", True, "LicenseRef-scan"]]
    assert "| `candidates.slots[].provider.min_points` | whole number | `50` | at least 1 | fewer leave out whole sides |" in copied.read(
        "docs/configuration.md"
    )


@pytest.mark.slow
def test_a_stage(copied: Copy) -> None:
    printed = copied.follow("A stage")
    assert copied.ask("SELECT count(*), bool_and(floor_share BETWEEN 0 AND 1) FROM footprints") == [[1, True]]
    assert copied.ask("SELECT stage, attempt, outcome FROM stage_runs WHERE stage = 'footprints'") == [["footprints", 1, "done"]]
    assert "\n## `footprints`\n" in copied.read("docs/tables.md")
    assert "\n## `footprints`\n" in copied.read("docs/configuration.md")
    assert "footprints" in printed[-1]


@pytest.mark.slow
def test_an_export_format(copied: Copy) -> None:
    printed = copied.follow("An export format")
    assert copied.ask("SELECT DISTINCT format, passed FROM export_checks") == [["inventory", True]]
    (file,) = (copied.folder / "tryout" / "out" / "inventory").glob("*.inventory.json")
    (entry,) = json.loads(file.read_text())["objects"]
    assert entry["name"] in printed[-1]
    explained = copied.run(f"metascenes explain {file}:{entry['name']} --lake tryout/lake")
    assert "scannet scan scene0000_00" in explained
    file.write_text(json.dumps({"objects": [entry | {"mass_kg": 0}]}))
    assert "mass: scannet_scene0000_00.inventory.json object 0: is not above zero" in copied.run(
        f"metascenes doctor inventory {file}", code=1
    )


@pytest.mark.slow
def test_a_sql_view(copied: Copy) -> None:
    copied.follow("A SQL view")
    assert "\n## `floor_by_category`\n" in copied.read("docs/views.md")
    golden = json.loads(copied.read("tests/golden/views/floor_by_category.json"))
    assert (golden["version"], list(golden["columns"])) == (1, ["category", "objects", "area_m2", "floor_share"])


TOUCHED = (
    "test_architecture.py", "test_families.py", "contributing/test_golden.py", "test_fuzzing.py", "schemas",
    "tasks/candidates/test_candidates.py", "tasks/exports/test_exports.py", "tasks/exports/test_exports_agreement.py",
    "tasks/capture/test_capture_errors.py",
    "warehouse/test_lake.py", "warehouse/questions", "flows/run/test_configuration.py", "flows/run/test_settings.py",
    "flows/run/test_status.py", "flows/documentation", "bench/test_bench_warehouse.py",
)  # fmt: skip
"""Tests of what derives from tables, stages, families and views."""


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_after_all_recipes_the_house_is_in_order(copied: Copy) -> None:
    """No list, generator or test elsewhere has to be told of any of them."""
    for heading in HEADINGS:
        for above, kind, text in blocks(heading):
            if kind not in ("bash", "text"):
                copied.write(above, kind, text)
    copied.run("make golden")
    assert copied.run("make golden") == ""
    copied.run("make check")
    copied.run(f"pytest -q -n 2 --dist loadfile -m 'not slow' --hypothesis-profile same {' '.join(f'tests/{path}' for path in TOUCHED)}")
