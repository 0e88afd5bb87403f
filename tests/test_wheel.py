"""The wheel: it holds what the product needs and nothing else, and works where there is no checkout."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import zipfile
from pathlib import Path

import pytest

from flows.cli import COMMANDS
from flows.view.bundle import is_built
from tests.conftest import REPOSITORY
from tests.test_architecture import PRODUCT
from warehouse.lake import Lake

pytestmark = pytest.mark.whole

CLIENT = REPOSITORY / "flows" / "view" / "client"


def without_checkout(arguments: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """A command in `folder`, with no path to the checkout in its environment."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "METASCENES", "PREFECT"))}
    return subprocess.run(arguments, cwd=folder, env=environment, text=True, capture_output=True, timeout=300)


@pytest.fixture(scope="session")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel as pip builds it, from the checkout and the build backend that the lock pins."""
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--no-index", "--no-deps", "--no-build-isolation", "-w", str(folder), str(REPOSITORY)]
    made = without_checkout(build, folder)
    assert made.returncode == 0, made.stderr
    (file,) = folder.glob("*.whl")
    return file


@pytest.fixture(scope="session")
def installed(wheel: Path) -> Path:
    """Folder of the programs of an environment with the wheel; it sees our dependencies, and not our checkout.

    Python reads no `.pth` files in folders that a `.pth` file names, the one of the editable install included.
    """
    place = wheel.parent / "environment"
    made = without_checkout([sys.executable, "-m", "venv", "--without-pip", str(place)], wheel.parent)
    assert made.returncode == 0, made.stderr
    python = place / "bin" / "python"
    asked = without_checkout([str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], wheel.parent)
    Path(asked.stdout.strip(), "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--no-index", "--no-deps", "--ignore-installed", str(wheel)]
    made = without_checkout(pip, wheel.parent)
    assert made.returncode == 0, made.stderr
    return place / "bin"


def test_it_holds_the_product_and_nothing_else(wheel: Path) -> None:
    """Every file of the product's rooms: code, SQL, labels, JSON schemas, the report's template, the viewer's client as it was built.

    Neither benchmarks nor tests, nor what the client is built from.
    """
    ours = {
        path.relative_to(REPOSITORY).as_posix()
        for room in PRODUCT
        for path in (REPOSITORY / room).rglob("*")
        if path.is_file()
        and not any(part == "__pycache__" or part.startswith(".") for part in path.relative_to(REPOSITORY).parts)
        and not path.is_relative_to(CLIENT)
    }
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if ".dist-info/" not in name}
        assert archive.read("flows/prefect.yaml") == (REPOSITORY / "prefect.yaml").read_bytes()
    assert held == ours | {"flows/prefect.yaml"}
    if is_built():
        assert {f"flows/view/built/{name}" for name in ("view.html", "view.js", "view.css", "three.LICENSE")} <= held
    for name in ("tasks/capture/labels.csv", "tasks/annotation/batch.schema.json", "schemas/lineage/lineage.schema.json"):
        assert name in held
    assert {Path(name).suffix for name in held} >= {".py", ".sql", ".csv", ".json", ".jinja", ".yaml", ".typed"}


def test_it_is_what_runs(installed: Path, tmp_path: Path) -> None:
    code = "import flows.cli, schemas, tasks, warehouse; print(flows.cli.__file__, schemas.__file__, tasks.__file__, warehouse.__file__)"
    ran = without_checkout([str(installed / "python"), "-c", code], tmp_path)
    assert ran.returncode == 0, ran.stderr
    assert all(Path(file).is_relative_to(installed.parent) for file in ran.stdout.split())


@pytest.mark.parametrize("name", [None, *COMMANDS])
def test_every_command_has_its_help(installed: Path, tmp_path: Path, name: str | None) -> None:
    ran = without_checkout([str(installed / "metascenes"), *([name] if name else []), "--help"], tmp_path)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert ran.stdout.startswith("Usage: metascenes")
    assert "Example: metascenes" in ran.stdout


def test_benchmarks_want_a_checkout(installed: Path, tmp_path: Path) -> None:
    ran = without_checkout([str(installed / "metascenes"), "bench", "exports"], tmp_path)
    assert (ran.returncode, ran.stdout) == (2, "")
    assert ran.stderr == "metascenes: metascenes bench: is not part of the installed package; run it in a checkout of the project\n"


def test_it_answers_in_sql(installed: Path, tmp_path: Path) -> None:
    """With the SQL files that came with it: every view, and nothing else."""
    Lake.open(str(tmp_path / "lake"))
    listed = without_checkout([str(installed / "metascenes"), "sql", "--list", "--lake", "lake"], tmp_path)
    assert listed.returncode == 0, listed.stderr
    views = {file.stem for file in (REPOSITORY / "warehouse" / "questions" / "views").rglob("*.sql")}
    assert views
    assert {line.split()[1] for line in listed.stdout.splitlines() if line.startswith("view")} == views
