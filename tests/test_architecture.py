"""The shape of the project, tested: rooms and their boundaries, the stages, one stem per stage."""

from __future__ import annotations

import ast
import inspect
import subprocess
import sys
from pathlib import Path

import pytest

from schemas.tables import TABLES
from tasks.pipeline import MODULES, SCENE_STAGES, STAGES, upstream
from tests.conftest import REPOSITORY

ROOMS = {
    "schemas": {"schemas"},
    "tasks": {"schemas", "tasks"},
    "warehouse": {"schemas", "warehouse"},
    "flows": {"schemas", "tasks", "warehouse", "flows"},
}
HEAVY = {
    "torch",
    "open3d",
    "pxr",
    "transformers",
    "numba",
    "trimesh",
    "shapely",
    "scipy",
    "matplotlib",
    "PIL",
    "coacd",
    "fcl",
    "manifold3d",
    "fast_simplification",
    "mujoco",
    "newton",
    "warp",
    "duckdb",
    "deltalake",
    "pandas",
    "prefect",
}
FLOWS = {REPOSITORY / "flows" / name for name in ("pipeline.py", "stats/flow.py", "watch.py", "releases.py", "exporting.py", "upkeep.py")}
"""The flows themselves; nothing imports them but a run that has work."""
ONLY_IN = {"prefect": {"flows"}, "duckdb": {"warehouse", "flows"}, "deltalake": {"warehouse"}}


def modules(room: str) -> list[Path]:
    return sorted((REPOSITORY / room).rglob("*.py"))


def imported(tree: ast.AST) -> list[str]:
    names = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert not node.level, "relative import"
            names.append(node.module or "")
    return names


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_imports_only_what_it_may(room: str) -> None:
    wrong = []
    for path in modules(room):
        for name in imported(ast.parse(path.read_text())):
            top = name.split(".")[0]
            if (top in ROOMS and top not in ROOMS[room]) or (top in ONLY_IN and room not in ONLY_IN[top]):
                wrong.append(f"{path.relative_to(REPOSITORY)}: {name}")
    assert not wrong
    assert modules(room), "the room is empty"


FORBIDDEN = [
    ("schemas", "import tasks.capture"),
    ("schemas", "import duckdb"),
    ("tasks", "from warehouse.lake import Lake"),
    ("tasks", "import prefect"),
    ("tasks", "import duckdb"),
    ("tasks", "from deltalake import DeltaTable"),
    ("warehouse", "from tasks import capture"),
    ("warehouse", "import prefect"),
]


@pytest.mark.parametrize(("room", "statement"), FORBIDDEN)
def test_the_linter_enforces_the_boundary_in_the_folder_that_it_protects(room: str, statement: str) -> None:
    command = [sys.executable, "-m", "ruff", "check", "--no-cache", "--select", "TID251", "--stdin-filename", f"{room}/wrong.py", "-"]
    found = subprocess.run(command, input=statement + "\n", capture_output=True, text=True, cwd=REPOSITORY)
    assert found.returncode == 1
    assert "TID251" in found.stdout


@pytest.mark.parametrize("room", ROOMS)
def test_heavy_packages_are_imported_where_they_are_used(room: str) -> None:
    wrong = []
    for path in modules(room):
        if path in FLOWS:
            continue
        for node in ast.parse(path.read_text()).body:
            wrong += [f"{path.relative_to(REPOSITORY)}: {n}" for n in imported(ast.Module([node], [])) if n.split(".")[0] in HEAVY
                      and isinstance(node, ast.Import | ast.ImportFrom)]  # fmt: skip
    assert not wrong


@pytest.mark.parametrize("module", ["flows.worker", "flows.cli", "flows.plan", "flows.commands.run", "flows.stats"])
def test_what_workers_and_idle_runs_import_is_light(module: str) -> None:
    code = f"import sys, {module}; print(*sorted(sys.modules))"
    loaded = set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY).stdout.split())
    assert not loaded & (HEAVY - {"deltalake", "duckdb", "PIL"})
    assert "prefect" not in loaded


def test_the_order_of_the_stages_follows_from_their_declarations() -> None:
    written: set[str] = set()
    for stage in STAGES:
        assert set(stage.reads) - set(stage.history) <= written, f"{stage.name} reads what no stage before it writes"
        assert not set(stage.writes) & written, f"{stage.name} writes another's table"
        written |= set(stage.writes)
    assert written == {name for name, table in TABLES.items() if table.stage}
    positions = {stage.name: i for i, stage in enumerate(STAGES)}
    for stage in STAGES:
        assert all(positions[above.name] < positions[stage.name] for above in upstream(stage))


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_a_stage_has_the_shape_of_its_family(stage) -> None:
    parameters = inspect.signature(stage.run).parameters
    assert set(parameters) == {*stage.reads, *stage.history, *stage.outside, "context", "config"}
    assert all(p.kind is inspect.Parameter.KEYWORD_ONLY for p in parameters.values())
    assert stage.config.__dataclass_params__.frozen
    stage.config()
    assert stage.run.__doc__
    assert __import__(MODULES[stage.name], fromlist=["STAGE"]).STAGE is stage


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_one_stem_per_stage_in_every_room(stage) -> None:
    assert stage.name not in sys.stdlib_module_names
    assert (REPOSITORY / "schemas" / f"{stage.name}.py").is_file()
    assert (REPOSITORY / "tasks" / f"{stage.name}.py").is_file() or (REPOSITORY / "tasks" / stage.name / "__init__.py").is_file()
    assert list((REPOSITORY / "tests").glob(f"test_{stage.name}*.py"))


def test_modules_are_nouns_of_a_screenful() -> None:
    paths = [path for room in ROOMS for path in modules(room)]
    assert not [p for p in paths if p.stem in {"utils", "util", "helpers", "helper", "common", "manager", "base", "misc"}]
    assert not [f"{p.relative_to(REPOSITORY)}: {n}" for p in paths if (n := p.read_text().count("\n")) > 400]


def test_every_prefect_task_and_flow_has_a_name() -> None:
    found = 0
    for path in modules("flows"):
        for node in ast.walk(ast.parse(path.read_text())):
            for decorator in getattr(node, "decorator_list", []):
                call = decorator.func if isinstance(decorator, ast.Call) else decorator
                if isinstance(call, ast.Name) and call.id in ("task", "flow"):
                    found += 1
                    assert isinstance(decorator, ast.Call), path
                    assert "name" in {k.arg for k in decorator.keywords}, path
    assert found >= 2


def test_shared_tables_name_who_shares_them() -> None:
    for table in TABLES.values():
        if table.rule == "share":
            assert table.key[0] in {c.name for c in TABLES[table.shared_by].columns}
    assert {stage.grain for stage in SCENE_STAGES} == {"scene"}
