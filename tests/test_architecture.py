"""The shape of the project, tested: rooms and their boundaries, the stages, one stem per stage."""

from __future__ import annotations

import ast
import graphlib
import inspect
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Collection, Iterable
from pathlib import Path

import pytest

from schemas.tables import TABLES
from tasks.pipeline import MODULES, SCENE_STAGES, STAGES, upstream
from tests.conftest import REPOSITORY
from tests.contributing.parsed import nodes_of, tree_of

ROOMS = {
    "schemas": {"schemas"},
    "tasks": {"schemas", "tasks"},
    "warehouse": {"schemas", "warehouse"},
    "flows": {"schemas", "tasks", "warehouse", "flows"},
    "bench": {"schemas", "tasks", "warehouse", "flows", "bench"},
}
PRODUCT = tuple(room for room in ROOMS if room != "bench")
"""What is in the wheel."""
_BENCHES = ("__init__", "acting", "capturing", "comparing", "drawing", "furnished", "matching", "modeling")
DOORS = {(f"flows/commands/bench/{name}.py", "bench") for name in _BENCHES}
"""Modules that import what their room does not, where a command asks for it."""
WIDEST = 20
"""Modules of a folder, besides its `__init__`."""
HEAVY = {
    "torch",
    "diffusers",
    "open3d",
    "pxr",
    "transformers",
    "numba",
    "igl",
    "trimesh",
    "shapely",
    "scipy",
    "matplotlib",
    "PIL",
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
    "lightning_fabric",
    "safetensors",
}
FLOWS = {
    REPOSITORY / "flows" / name
    for name in (
        "pipeline.py",
        "stats/flow.py",
        "watch.py",
        "releases.py",
        "exporting.py",
        "upkeep.py",
        "training/flow.py",
        "evaluation/flow.py",
        "comparison/flow.py",
        "server/scene_tasks.py",
        "robot/flow.py",
    )
}
"""The flows themselves, with what they are made of; nothing imports them but a run that has work."""
ONLY_IN = {"prefect": {"flows"}, "duckdb": {"warehouse", "flows", "bench"}, "deltalake": {"warehouse"}, "igl": {"tasks"}}


def modules(room: str) -> list[Path]:
    return sorted((REPOSITORY / room).rglob("*.py"))


def imported(nodes: Iterable[ast.AST]) -> list[str]:
    names = []
    for node in nodes:
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
        for name in imported(nodes_of(path.read_text())):
            top = name.split(".")[0]
            if (path.relative_to(REPOSITORY).as_posix(), top) in DOORS:
                continue
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
    ("tasks", "import igl.copyleft.cgal"),
    ("tasks", "from igl.copyleft import tetgen"),
    ("tasks", "from igl import copyleft"),
    ("tasks", "import igl.triangle"),
    ("warehouse", "from tasks import capture"),
    ("warehouse", "import prefect"),
    ("flows", "import bench"),
]


@pytest.mark.parametrize(("room", "statement"), FORBIDDEN)
def test_the_linter_enforces_the_boundary_in_the_folder_that_it_protects(room: str, statement: str) -> None:
    command = [sys.executable, "-m", "ruff", "check", "--no-cache", "--select", "TID251", "--stdin-filename", f"{room}/wrong.py", "-"]
    found = subprocess.run(command, input=statement + "\n", capture_output=True, text=True, cwd=REPOSITORY)
    assert found.returncode == 1
    assert "TID251" in found.stdout


NETWORKS = "networks"
"""Folders of classes that are torch's: their modules import it at once, and are imported as it is, inside the function that needs them."""


@pytest.mark.parametrize("room", ROOMS)
def test_heavy_packages_are_imported_where_they_are_used(room: str) -> None:
    wrong = []
    for path in modules(room):
        if path in FLOWS or path.name.endswith("_script.py"):  # which are run, and never imported
            continue
        text = path.read_text()
        if path.parent.name == NETWORKS:
            heavy = {n.split(".")[0] for n in imported(nodes_of(text))} & HEAVY
            wrong += [f"{path.relative_to(REPOSITORY)}: {n}" for n in sorted(heavy - {"torch"})]
            continue
        at_once = imported(tree_of(text).body)
        wrong += [f"{path.relative_to(REPOSITORY)}: {n}" for n in at_once if NETWORKS in n.split(".") or n.split(".")[0] in HEAVY]
    assert not wrong


@pytest.mark.parametrize("module", ["flows.worker", "flows.cli", "flows.run.plan", "flows.commands.run", "flows.stats"])
def test_what_workers_and_idle_runs_import_is_light(module: str) -> None:
    code = f"import sys, {module}; print(*sorted(sys.modules))"
    loaded = set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY).stdout.split())
    assert not loaded & (HEAVY - {"deltalake", "duckdb", "PIL"})
    assert "prefect" not in loaded


def test_the_order_of_the_stages_follows_from_their_declarations() -> None:
    written: set[str] = set()
    for stage in STAGES:
        assert {*stage.reads, *stage.streams} - set(stage.history) <= written, f"{stage.name} reads what no stage before it writes"
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
    for room in ("schemas", "tasks"):
        assert (REPOSITORY / room / f"{stage.name}.py").is_file() or (REPOSITORY / room / stage.name / "__init__.py").is_file()
    assert list((REPOSITORY / "tests").rglob(f"test_{stage.name}*.py"))


def test_modules_are_nouns_of_a_screenful() -> None:
    paths = [path for room in ROOMS for path in modules(room)]
    assert not [p for p in paths if p.stem in {"utils", "util", "helpers", "helper", "common", "manager", "base", "misc"}]
    assert not [f"{p.relative_to(REPOSITORY)}: {n}" for p in paths if (n := p.read_text().count("\n")) > 400]


def test_no_folder_is_wider_than_a_glance() -> None:
    folders = {path.parent for room in (*ROOMS, "tests") for path in modules(room)}
    width = {folder: len([p for p in folder.glob("*.py") if p.stem not in ("__init__", "__main__")]) for folder in folders}
    assert not {str(folder.relative_to(REPOSITORY)): n for folder, n in width.items() if n > WIDEST}


LATE = {"warehouse.storage.files": "opens the storage of an address by its kind; the kinds hold to its protocol"}
"""Modules whose imports inside of functions may lead back to them, and why."""


def graph_of(sources: dict[str, str], late: Collection[str] = ()) -> dict[str, set[str]]:
    """The modules that each one imports, wherever it does, but for the type checker; of `late` ones those that are imported at once."""

    def names(node: ast.Import | ast.ImportFrom) -> list[str]:
        (module, *others) = imported([node])
        aliases = [f"{module}.{alias.name}" for alias in node.names] if isinstance(node, ast.ImportFrom) else [module, *others]
        return [alias if alias in sources else module for alias in aliases]

    graph = {}
    for name, text in sources.items():
        skipped = ast.FunctionDef if name in late else ()
        left: list[ast.AST] = [tree_of(text)]
        graph[name] = set()
        while left:
            node = left.pop()
            if isinstance(node, ast.Import | ast.ImportFrom):
                graph[name] |= {other for other in names(node) if other in sources and other != name}
            elif isinstance(node, ast.stmt | ast.Module | ast.ExceptHandler | ast.match_case) and not isinstance(node, skipped):
                is_for_types = isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
                left += [] if is_for_types else ast.iter_child_nodes(node)
    return graph


def sources() -> dict[str, str]:
    paths = [path for room in ROOMS for path in modules(room)]
    named = {".".join(path.relative_to(REPOSITORY).with_suffix("").parts).removesuffix(".__init__"): path for path in paths}
    return {name: path.read_text() for name, path in named.items()}


def test_no_module_imports_what_imports_it() -> None:
    text = sources()
    graphlib.TopologicalSorter(graph_of(text, LATE)).prepare()  # names the circle
    for name in LATE:
        with pytest.raises(graphlib.CycleError):
            graphlib.TopologicalSorter(graph_of(text, set(LATE) - {name})).prepare()


def test_the_look_for_circles_sees_those_inside_of_functions() -> None:
    late = {"a": "def f():\n    from b import c\n", "b": "", "b.c": "import a\n"}
    with pytest.raises(graphlib.CycleError):
        graphlib.TopologicalSorter(graph_of(late)).prepare()
    graphlib.TopologicalSorter(graph_of(late, {"a"})).prepare()
    checked = late | {"b.c": "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import a\n"}
    assert graph_of(checked) == {"a": {"b.c"}, "b": set(), "b.c": set()}


STORED = {"HabitatConfig": "identities of configs hold the names of their types"}
"""Names of several classes, and why they stay."""


def test_every_class_has_a_name_of_its_own() -> None:
    classes = Counter(
        node.name
        for text in sources().values()
        for node in tree_of(text).body
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
    )
    assert {name for name, count in classes.items() if count > 1} == set(STORED)


def test_every_prefect_task_and_flow_has_a_name() -> None:
    found = 0
    for path in modules("flows"):
        for node in nodes_of(path.read_text()):
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


OPENERS = {"read_text", "read_bytes", "load_mesh", "ZipFile", "from_xml_path"}
OWN = {
    "schemas/files.py": "the one place",
    "tasks/calls/prompts.py": "prompts of the package",
    "flows/server/erasure.py": "files in Prefect's home",
    "warehouse/upkeep/erasure/proof.py": "files in Prefect's home and temporary ones",
    "tasks/kernels/ahead.py": "kernels of the package",
    "flows/run/bounds.py": "the null device",
    "flows/server/access.py": "tokens of servers of this machine, in files of our own",
    "flows/questions/bounds.py": "the answer that is written, and /proc",
    "flows/questions/editor.py": "the history of this user",
    "flows/inputs/demo.py": "what the demo wrote",
    "flows/server/deployments.py": "prefect.yaml of the package",
    "flows/scans/erasure.py": "caches of this machine",
    "flows/outputs/export.py": "the export that is written",
    "flows/run/fingerprints.py": "code, and caches of this machine",
    "flows/scans/mirror.py": "the mirror of this machine",
    "flows/stats/flow.py": "the report that was written",
    "flows/stats/pictures.py": "code of the project",
    "flows/terminal.py": "descriptors of the process",
    "flows/view/annotating/drafts.py": "drafts of this server, in a file of ours",
    "flows/view/bundle.py": "the client of the package",
    "tasks/batches.py": "the schema of the package",
    "tasks/calls/guard.py": "/proc",
    "tasks/captions/physics.py": "tables of the package",
    "tasks/capture/point_cloud/child.py": "columns that it writes for its parent",
    "tasks/capture/record3d/archive.py": "what its reader checked",
    "tasks/capture/instances/naming.py": "a table of the package",
    "tasks/capture/poses/open3d.py": "what a child process of ours reads",
    "tasks/capture/poses/open3d_script.py": "what its parent wrote",
    "tasks/exports/files.py": "the export that is written",
    "tasks/geometry/gltf/child.py": "what its parent wrote",
    "tasks/exports/mjcf/rules.py": "MuJoCo opens by itself",
    "tasks/exports/usd/package.py": "a file that is open",
    "tasks/kernels/__init__.py": "code of the project",
    "tasks/navigation/habitat.py": "what a child process of ours wrote",
    "tasks/optimization/engines/newton_engine.py": "what a child process of ours wrote",
    "tasks/optimization/engines/newton_script.py": "what its parent wrote",
    "tasks/scanner/folder.py": "the scan that is written",
    "tasks/stats/page/report.py": "the template of the package",
    "warehouse/questions/macros.py": "SQL of the package",
    "warehouse/release/__init__.py": "the release that is written",
    "warehouse/release/tables.py": "the release that is written",
    "warehouse/storage/files.py": "the lake",
    "warehouse/storage/locks.py": "the lake",
    "schemas/machine/processes.py": "/proc, and the name of the host",
}
"""Modules that open files by themselves, and which: never what people hand in. That goes through `schemas.files`."""


def opens(node: ast.AST) -> bool:
    """Whether a call opens a file by its path."""
    if not isinstance(node, ast.Call):
        return False
    if isinstance(node.func, ast.Name):
        return node.func.id in {"open", "ZipFile"}
    if not isinstance(node.func, ast.Attribute):
        return False
    owner, name = node.func.value.id if isinstance(node.func.value, ast.Name) else "", node.func.attr
    first = node.args[0] if node.args else next((k.value for k in node.keywords if k.arg == "mode"), None)
    is_bytes = isinstance(first, ast.Call) and ast.unparse(first.func) == "io.BytesIO"
    if name in OPENERS:
        return not is_bytes
    if (owner, name) in {("Image", "open"), ("np", "load"), ("gzip", "open"), ("trimesh", "load"), ("trimesh", "load_scene")}:
        return not is_bytes and not (isinstance(first, ast.Name) and first.id == "file")
    is_mode = isinstance(first, ast.Constant) and isinstance(first.value, str) and set(first.value) <= set("rwxabt+")
    return (owner, name) == ("os", "open") or (name == "open" and (is_mode or any(k.arg in ("newline", "encoding") for k in node.keywords)))


def test_what_people_hand_in_is_opened_in_one_place() -> None:
    found = {
        path.relative_to(REPOSITORY).as_posix() for room in PRODUCT for path in modules(room) if any(map(opens, nodes_of(path.read_text())))
    }
    assert found - set(OWN) == set(), "open what people hand in with schemas.files"
    assert set(OWN) - found == set(), "they open nothing any more"


@pytest.mark.parametrize(
    "text",
    ["open(path)", "path.open('rb')", "path.read_bytes()", "path.read_text(encoding='utf-8')", "Image.open(path)", "np.load(path)",
     "os.open(path, 0)", "path.open(newline='')", "trimesh.load_scene(path)", "zipfile.ZipFile(path)", "gzip.open(path)"],
)  # fmt: skip
def test_the_look_for_what_is_opened_sees_it(text: str) -> None:
    assert any(map(opens, ast.walk(ast.parse(text))))
    assert not any(map(opens, ast.walk(ast.parse("Lake.open(path), tables.open('scenes'), Image.open(io.BytesIO(data))"))))


def test_no_example_of_a_property_has_a_time_limit() -> None:
    """Neither in `make test`, nor in `make test-all`, nor by a limit that a test sets for itself."""
    from hypothesis import settings

    assert settings().deadline is None
    for profile in ("same", "new"):
        assert settings.get_profile(profile).deadline is None
    named = re.findall(r"--hypothesis-profile[= ](\S+)", (REPOSITORY / "Makefile").read_text())
    assert set(named) <= {"same", "new"}
    limits = [
        f"{file.name}: {found}"
        for file in (REPOSITORY / "tests").rglob("*.py")
        for found in re.findall(r"\bdeadline=(?!None)[\d.t][^,)\s]*", file.read_text())
    ]
    assert limits == []


REPEATED = {
    ("tasks/navigation/visibility.py",): "compiled: cells along a line, counted and then filled",
    ("tasks/optimization/shapes.py", "tasks/optimization/support/tipping.py"): "compiled: vertices in another body's frame",
    ("warehouse/questions/answers.py",): "values as text and as JSON look through the same wrappers",
}
"""Places that may be alike, and why: mostly loops that must be inlined to be fast."""
NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*")


def runs_of_six(function: ast.AST) -> set[str]:
    """Runs of statements of function bodies that fill six lines or more, written alike, names by their order."""
    runs = set()
    text = ast.unparse(function)
    written = text.splitlines()
    bodies = [getattr(node, field, None) for node in ast.walk(ast.parse(text)) for field in ("body", "orelse", "finalbody")
              if not isinstance(node, ast.Module | ast.ClassDef)]  # fmt: skip
    for body in bodies:
        if not isinstance(body, list):
            continue
        passive = (ast.Import, ast.ImportFrom)
        plain = [s for s in body if not isinstance(s, passive) and not (isinstance(s, ast.Expr) and isinstance(s.value, ast.Constant))]
        texts = [[line[s.col_offset :] for line in written[s.lineno - 1 : s.end_lineno]] for s in plain]
        for start in range(len(texts)):
            lines: list[str] = []
            for statement in texts[start:]:
                lines += statement
                if len(lines) >= 6:
                    names: dict[str, str] = {}
                    runs.add(NAME.sub(lambda word, names=names: names.setdefault(word[0], f"n{len(names)}"), "\n".join(lines)))
                    break
    return runs


def repeated(sources: dict[str, str]) -> set[tuple[str, ...]]:
    """Names of sources that hold the same run of six lines; a name alone where it holds one twice."""
    holders: dict[str, list[str]] = {}
    for name, source in sources.items():
        functions = [node for node in tree_of(source).body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)]
        for function in functions:
            for run in runs_of_six(function):
                holders.setdefault(run, []).append(name)
    return {tuple(sorted(set(names))) for names in holders.values() if len(names) > 1}


def test_no_six_equal_lines_in_two_places() -> None:
    sources = {path.relative_to(REPOSITORY).as_posix(): path.read_text() for room in PRODUCT for path in modules(room)}
    assert repeated(sources) == set(REPEATED)


def test_six_equal_lines_are_seen_whatever_their_names() -> None:
    body = ["b = a + 1", "c = b * a", "for d in c:", "    if d > b:", "        g(d, a.x)", "e = c[b]", "return e"]
    first = "\n    ".join(["def f(a):", *body]) + "\n"
    second = first.replace("a", "alpha").replace("c", "count").replace("def f", "def other")
    assert repeated({"first": first, "second": second}) == {("first", "second")}
    assert repeated({"first": first + second}) == {("first",)}
    assert not repeated({"first": first, "second": second.replace("+ 1", "+ 2").replace("return", "return -")})


VAGUE = {"said", "told", "found", "one", "others", "thing", "things"}


def test_variables_are_named_after_what_they_hold() -> None:
    vague = {
        f"{path.relative_to(REPOSITORY)}:{node.lineno}: {name}"
        for room in ROOMS
        for path in modules(room)
        for node in nodes_of(path.read_text())
        if (name := node.arg if isinstance(node, ast.arg) else node.id if isinstance(node, ast.Name) else "") in VAGUE
    }
    assert vague == set()
