"""The open families: one tuple lists a family, nothing else names its members, and a further member is reached from everywhere."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from schemas.families.alignment_methods import ALIGNMENT_METHODS
from schemas.families.candidate_providers import CANDIDATE_PROVIDERS
from schemas.families.export_formats import EXPORT_FORMATS
from schemas.families.path_finders import PATH_FINDERS
from schemas.families.policies import POLICIES
from schemas.families.scan_formats import SCAN_FORMATS
from schemas.families.selection_methods import SELECTION_METHODS
from tasks.alignment import methods as alignment_methods
from tasks.candidates import providers
from tasks.capture import formats as scan_formats
from tasks.evaluation import policies
from tasks.exports import formats as export_formats
from tasks.families import member, members, part
from tasks.lineage.places import places_of
from tasks.navigation import path_finders
from tasks.selection.methods import members as selection_methods
from tests.conftest import REPOSITORY
from tests.contributing.parsed import nodes_of
from tests.scans import OBJECTS, write_scan
from tests.test_pipeline import QUICK

FAMILIES: dict[str, tuple[tuple[str, ...], tuple[Any, ...]]] = {
    "tasks.capture": (SCAN_FORMATS, scan_formats.FORMATS),
    "tasks.exports": (EXPORT_FORMATS, export_formats.FORMATS),
    "tasks.candidates": (CANDIDATE_PROVIDERS, providers.PROVIDERS),
    "tasks.navigation": (PATH_FINDERS, path_finders.PATH_FINDERS),
    "tasks.evaluation.policies": (POLICIES, policies.POLICIES),
    "tasks.alignment": (ALIGNMENT_METHODS, alignment_methods.METHODS),
    "tasks.selection.methods": (SELECTION_METHODS, selection_methods.METHODS),
}
"""Names and objects of every family, by the package that its members lie in."""

NAMES = {name for names, _ in FAMILIES.values() for name in names}
ROOMS = ("schemas", "tasks", "warehouse", "flows", "bench")

ELSEWHERE = {
    "bench/capture/meshes.py bare_mesh": "names of nodes are withheld by asking for the format that reads none",
    "bench/capture/rooms.py posed_rgbd": "the benchmark fuses frames of that format, which a generated room was written in",
    "bench/colliders.py library": "where measured assets come from: a folder of models",
    "bench/engines/scenes.py mjcf": "the files that the benchmark's engines read, each of one format",
    "bench/engines/scenes.py urdf": "as above",
    "bench/engines/scenes.py usd": "as above",
    "bench/engines/setups.py mjcf": "as above",
    "bench/engines/setups.py urdf": "as above",
    "bench/engines/setups.py usd": "as above",
    "bench/exports.py mjcf": "the benchmark simulates what is written in two formats, each with a reader of its own",
    "bench/exports.py usd": "as above",
    "bench/files/comparison.py extents": "the size of what a file shows",
    "bench/files/readers.py glb": "the kind of file of a reader",
    "bench/files/readers.py library": "a reader's name in the table",
    "bench/files/readers.py usd": "the kind of file of a reader",
    "bench/files/report.py library": "a reader's name in the table",
    "bench/files/report.py usd": "a judge's name in the table",
    "bench/navigation.py planar": "the benchmark holds one path finder against another",
    "bench/navigation.py recast": "as above",
    "bench/replicas.py glb": "the format that a generated scene would have been read from",
    "bench/rooms.py procedural": "generated rooms hold models of that provider's generator",
    "bench/selection/data.py extents": "the size of a model",
    "bench/selection/data.py model": "the kind of a lineup's candidate",
    "bench/selection/foreign.py model": "as above",
    "bench/selection/lineups.py parametric": "as above",
    "bench/selection/report.py acdc": "the benchmark says which methods it measures and which it cannot",
    "bench/selection/report.py clip": "as above",
    "bench/selection/report.py color_histogram": "as above",
    "bench/selection/report.py extents": "as above",
    "bench/selection/report.py geometric": "as above",
    "bench/selection/report.py image_similarity": "as above",
    "bench/selection/report.py model": "as above",
    "bench/selection/report.py vision_language": "as above",
    "bench/synthesis/house.py library": "the parameter, a folder",
    "bench/synthesis/rooms.py glb": "a row of a scene that was never scanned",
    "bench/synthesis/rooms.py procedural": "generated rooms hold models of that provider's generator",
    "bench/warehouse/contention.py glb": "a row of a scene that was never scanned",
    "bench/warehouse/library.sql library": "rows of a generated lake, in shares that are like those of real ones",
    "bench/warehouse/library.sql procedural": "as above",
    "bench/warehouse/rows/assets.sql procedural": "as above",
    "bench/warehouse/rows/candidates.sql library": "as above",
    "bench/warehouse/rows/candidates.sql procedural": "as above",
    "bench/warehouse/rows/candidates.sql textured": "as above",
    "bench/warehouse/rows/captions.sql vision_language": "rows of a generated lake, whose captions such a model wrote",
    "bench/warehouse/rows/episodes.sql planar": "as above",
    "bench/warehouse/rows/navmeshes.sql planar": "as above",
    "bench/warehouse/rows/robot_runs.sql expert": "rows of a generated lake, of ways that the expert went",
    "bench/warehouse/rows/robot_runs.sql planar": "a body that moves in the plane",
    "bench/warehouse/rows/scenes.sql posed_rgbd": "as above",
    "bench/warehouse/rows/scenes.sql scannet": "as above",
    "bench/warehouse/rows/selections.sql geometric": "rows of a generated lake, in shares that are like those of real ones",
    "bench/warehouse/rows/texture_charts.sql procedural": "rows of a generated lake: what has no layout of its own",
    "bench/warehouse/rows/trajectories.sql expert": "as above",
    "bench/warehouse/rows/trajectories.sql planar": "as above",
    "bench/policy/frames.py mjcf": "what MuJoCo draws is an export of that format",
    "flows/commands/ingest.py habitat": "a layout of finished datasets, whose commands differ in what they take",
    "flows/commands/library/__init__.py model": "the noun of a count",
    "flows/commands/training/compare.py model": "as above",
    "flows/commands/training/models.py model": "a parameter, and the head of a column",
    "flows/commands/watch.py library": "the parameter, a folder",
    "flows/comparison/flow.py model": "the noun of a count",
    "flows/inputs/synthesis/batches.py model": "what draws layouts, in their facts and fingerprints",
    "flows/inputs/synthesis/models.py model": "as above",
    "flows/outputs/explain.py model": "the kind of what is explained",
    "flows/run/configuration.py library": "the parameter, a folder",
    "flows/run/plan.py library": "the outside input of a stage",
    "flows/run/plan.py model": "the outside input of a stage",
    "flows/view/annotating/work.py glb": "the file of a candidate, as the page asks for it",
    "flows/view/application.py glb": "the ending of a file",
    "flows/view/scene.py glb": "as above",
    "flows/view/shapes.py habitat": "the export that has convex pieces as files by object",
    "flows/worker.py model": "as above",
    "schemas/capture.py habitat": "a layout of finished datasets",
    "tasks/annotation/work.py extents": "the size of a candidate, in the folder that annotators get",
    "tasks/annotation/work.py glb": "the file of a candidate, in the folder that annotators get",
    "tasks/candidates/__init__.py library": "the outside input of the stage",
    "tasks/capture/glb.py model": "a file of a scan",
    "tasks/capture/glb.py textured": "a word in names of nodes that says nothing of what they are",
    "tasks/capture/replica_v1/__init__.py habitat": "a folder of that data set",
    "tasks/exports/mjcf/rules.py model": "an attribute of the file that the rules read",
    "tasks/exports/mesh_files.py glb": "the ending of a file that a robot's or a world's description names",
    "tasks/exports/usd/body_rules.py extents": "the size of a body",
    "tasks/exports/usd/rules.py extents": "as above",
    "tasks/geometry/meshes.py model": "the name of a file",
    "tasks/ingestion/habitat.py model": "a part of a dataset's layout",
    "tasks/ingestion/habitat_scenes.py habitat": "a layout of finished datasets",
    "tasks/ingestion/reading.py habitat": "as above",
    "tasks/ingestion/scene.py habitat": "the name of an agent, which files of that layout do not say",
    "tasks/ingestion/sources.py habitat": "a layout of finished datasets",
    "tasks/alignment/sampling.py library": "assets of this provider alone have a size of their own",
    "tasks/lineage/words.py extents": "the size of an object",
    "tasks/lineage/words.py model": "the kind of what is explained",
    "tasks/scanner/scenery.py model": "a file of a library",
    "schemas/robot/__init__.py planar": "a body that moves in the plane",
    "tasks/robot/configuration.py planar": "a body that moves in the plane",
    "tasks/selection/__init__.py model": "the outside input of the stage",
    "tasks/selection/methods/method.py clip": "weights that methods need",
    "tasks/selection/methods/method.py model": "as above",
    "tasks/selection/model/config.py clip": "a frozen encoder of a learned model",
    "tasks/exports/sdf/__init__.py model": "an element of SDF",
    "tasks/exports/sdf/places.py model": "as above",
    "tasks/exports/sdf/rules.py model": "as above",
    "tasks/exports/usd/body_rules.py sdf": "how PhysX is told to make a collider: a signed distance field",
    "tasks/selection/model/foreign.py model": "a part of the names in files of weights",
    "tasks/selection/model/frozen.py clip": "a frozen encoder of a learned model",
    "tasks/selection/model/sight.py model": "a field of a learned system's settings",
    "tasks/selection/scoring.py scan_crop": "a setting: rows of earlier versions count, whoever fills slots now",
    "tasks/stage.py library": "an outside input of stages",
    "tasks/stage.py model": "an outside input of stages",
    "tasks/training/systems/selection.py model": "as above",
    "warehouse/lineage/models.py model": "the kind of what is explained",
    "warehouse/lineage/nodes.py extents": "the size of an object",
    "warehouse/lineage/targets.py model": "the kind of what is explained",
    "tasks/synthesis/model/config.py clip": "the text encoder of a synthesis model",
    "tasks/synthesis/model/config.py model": "a field of settings",
    "tasks/synthesis/model/text.py model": "as above",
    "tasks/training/systems/synthesis.py model": "as above",
    "tasks/policy/model/config.py model": "a field of settings",
    "tasks/training/systems/navigation.py model": "as above",
    "warehouse/lineage/nodes.py model": "the kind of a node",
    "flows/run/ledger.py glb": "the kind of a file that a generator answered with",
    "tasks/calls/endpoint.py model": "the setting that names what is asked, and a field of the protocol",
    "tasks/candidates/served.py glb": "a field of the protocol: the kind of file that is asked for",
    "tasks/captions/vision_language.py vision_language": "the kind of a provider of captions",
    "warehouse/lineage/calls.py model": "the column that names who was asked",
    "bench/warehouse/rows/libraries.sql library": "rows of a generated lake: the column of libraries",
    "bench/warehouse/rows/library_models.sql glb": "the format of a model's file",
    "flows/cli.py library": "the command",
    "flows/commands/library/__init__.py library": "as above",
    "flows/library/adding.py library": "the grain of what is indexed, a library of the lake",
    "flows/run/libraries.py library": "the setting of a run, a library of the lake or a folder",
    "flows/worker.py library": "as above",
    "schemas/indexing/__init__.py library": "the column and grain of what is indexed",
    "schemas/record.py library": "as above",
    "tasks/indexing/__init__.py library": "as above",
    "tasks/library/catalog.py library": "what an error is about, a folder",
    "tasks/library/entry.py extents": "a field of an entry, its size",
    "tasks/library/indexing.py library": "who offers what is indexed",
    "tasks/lineage/words.py library": "where a candidate was found",
    "warehouse/lineage/libraries.py library": "as above",
    "schemas/capture.py refined": "whose a pose is",
    "tasks/capture/poses/provider.py refined": "as above",
    "warehouse/questions/views/retrieval_by_category.sql library": "the slot that candidates out of libraries have",
    "warehouse/release/hub.py habitat": "tags by which people look for data sets",
    "warehouse/release/hub.py mjcf": "as above",
    "warehouse/release/hub.py usd": "as above",
}
"""Where a word that is a member's name stands outside of the member's own modules, and what it means there."""


def own(package: str, name: str) -> str:
    """How paths of a member's own modules begin."""
    return f"{package.replace('.', '/')}/{name}"


def is_own(path: str, name: str) -> bool:
    begins = [own(package, name) for package, (names, _) in FAMILIES.items() if name in names]
    return path.startswith("schemas/families/") or any(path in (f"{begin}.py",) or path.startswith(f"{begin}/") for begin in begins)


def words_of(source: str) -> Iterator[str]:
    """Literals of a module that are a member's name, but for docstrings, and where they end the name of a file or blob."""
    endings = set()
    for node in nodes_of(source):
        if isinstance(node, ast.Call):
            is_blob = isinstance(node.func, ast.Attribute) and node.func.attr in ("add", "put") and len(node.args) == 2
            endings |= {id(node.args[1])} if is_blob else set()
            endings |= {id(keyword.value) for keyword in node.keywords if keyword.arg == "file_type"}
    for node in nodes_of(source):
        if isinstance(node, ast.Constant) and node.value in NAMES and id(node) not in endings:
            yield node.value


def test_nothing_but_its_family_names_a_member() -> None:
    found = set()
    for room in ROOMS:
        for path in sorted((REPOSITORY / room).rglob("*")):
            name = path.relative_to(REPOSITORY).as_posix()
            if path.suffix == ".py":
                words = set(words_of(path.read_text()))
            elif path.suffix == ".sql":
                words = set(re.findall(r"'(\w+)'", re.sub(r"--.*", "", path.read_text()))) & NAMES
            else:
                continue
            found |= {f"{name} {word}" for word in words if not is_own(name, word)}
    assert found - set(ELSEWHERE) == set(), "derive it from the family, or say in ELSEWHERE what else the word means there"
    assert set(ELSEWHERE) - found == set(), "these stand there no more"


@pytest.mark.parametrize(
    "text", ['{"usd": 1}', 'x == "glb"', 'f"{x}" + "planar"', 'Literal["expert"]', 'f(name="library")', '["a", "scannet"]']
)
def test_the_look_for_names_sees_them(text: str) -> None:
    assert len(list(words_of(text))) == 1
    assert list(words_of('blobs.add(data, "glb"), load(x, file_type="glb"), "usda", "a usd"')) == []


LISTED = re.compile(rf"\b({'|'.join(sorted(NAMES))})\b")


def test_no_text_lists_members_either() -> None:
    """Errors and remedies that say what there is are made of the tuple: no literal names two members of one family.

    A member may say which others stand in for it, and the page of settings has examples.
    """
    wrong = []
    for room in ROOMS:
        for path in sorted((REPOSITORY / room).rglob("*.py")):
            text = path.read_text()
            nodes = [node for node in nodes_of(text) if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)]
            docstrings = {id(node.body[0].value) for node in nodes if node.body and isinstance(node.body[0], ast.Expr)}
            for node in nodes_of(text):
                if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
                    named = set(LISTED.findall(node.value))
                    listed = any(len(named & set(names)) > 1 for names, _ in FAMILIES.values())
                    name = path.relative_to(REPOSITORY).as_posix()
                    if listed and name != "flows/documentation/settings.py" and not any(is_own(name, other) for other in NAMES):
                        wrong.append(f"{name}:{node.lineno}")
    assert wrong == []


@pytest.mark.parametrize("package", FAMILIES)
def test_a_family_is_a_frozen_object_for_each_name(package: str) -> None:
    names, family = FAMILIES[package]
    assert tuple(one.name for one in family) == names
    assert len(set(names)) == len(names)
    for one in family:
        assert type(one).__dataclass_params__.frozen
        assert member(family, one.name) is one
        assert getattr(one, "config", None) is None or one.config.kind == one.name
    with pytest.raises(KeyError):
        member(family, "nosuch")


def test_a_module_without_its_object_is_no_member() -> None:
    with pytest.raises(TypeError, match=r"tasks\.capture\.layout: LAYOUT must be the ScanFormat 'layout'"):
        members("tasks.capture", ("layout",), type(scan_formats.FORMATS[0]))
    with pytest.raises(TypeError, match="must be the Policy"):
        members("tasks.capture", ("scannet",), type(policies.POLICIES[0]))
    assert part("tasks.capture", "scannet", "nosuch") is None
    assert part("tasks.capture", "glb", "wholeness") is None, "a module has no parts"


def test_every_export_format_says_what_is_in_its_files() -> None:
    for one in export_formats.FORMATS:
        assert callable(places_of(one).places)
        assert not one.is_nested or callable(places_of(one).has_part)
        assert one.with_release is None or callable(places_of(one).stated_release)
        assert (one.package is None) == (one.suffix == "")
        assert all(callable(one.validator(option)) for option, _ in one.doctor.validators)
        assert list(one.rules)


def test_choices_of_members_load_none_of_them() -> None:
    code = (
        "import sys, flows.commands.run, flows.commands.watch, flows.commands.export, flows.commands.evaluate, flows.commands.demo\n"
        "print([name for name in ('tasks', 'numpy', 'pyarrow', 'trimesh', 'pxr', 'mujoco') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=600, cwd=REPOSITORY)
    assert done.stdout == "[]\n", done.stderr


MADE_UP = REPOSITORY / "tests" / "made_up"

Do = Callable[..., "subprocess.CompletedProcess[str]"]


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scan of the made-up format, which is not quite copied."""
    folder = tmp_path_factory.mktemp("further")
    write_scan(folder / "scans" / "room_1", "data", objects=OBJECTS[1:2])
    (folder / "scans" / "room_1" / "toy.txt").write_text("half of\n")
    return folder


@pytest.fixture(scope="module")
def do(place: Path) -> Do:
    """Runs Python in a process of its own in which every family has the further member of `tests/made_up`."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PREFECT_", "METASCENES_", "TOY_"))}
    home = {"HOME": str(place / "home"), "XDG_CACHE_HOME": str(place / "home" / ".cache"), "NO_COLOR": "1", "COLUMNS": "200"}
    paths = os.pathsep.join([str(MADE_UP), str(REPOSITORY)])

    def run(*arguments: object, code: int = 0, **environment: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, *map(str, arguments)]
        done = subprocess.run(
            command, env={**kept, **home, "PYTHONPATH": paths, **environment}, cwd=place, capture_output=True, text=True, timeout=600
        )
        assert done.returncode == code, done.stdout + done.stderr
        return done

    return run


@pytest.fixture(scope="module")
def command(do: Do) -> Do:
    return lambda *words, **options: do("-m", "flows.cli", *words, **options)


@pytest.fixture(scope="module")
def lake(place: Path, command: Do) -> Path:
    """A lake of a scene that made-up members were asked for in every stage."""
    (place / "scans" / "room_1" / "toy.txt").write_text("the end\n")
    told = {
        "candidates.slots": '[{provider = "toy_provider"}]',
        "selection.alignment.method": "toy_alignment",
        "selection.provider": "toy_method",
        "navigation.path_finder": "toy_finder",
        "navigation.train_episodes": 3,
        "navigation.test_episodes": 3,
        "exports.formats": '["toy_export", "glb"]',
    }
    settings = [word for name, value in told.items() for word in ("--set", f"{name}={value}")]
    done = command("run", "--scans", "scans", "--lake", "lake", "--workers", 1, *QUICK, *settings)
    assert "1 scene done" in done.stdout, done.stdout + done.stderr
    return place / "lake"


def answer(command: Do, lake: Path, query: str) -> list[Any]:
    """Rows of an answer, as lists."""
    return [list(row.values()) for row in json.loads(command("sql", "--lake", lake, query, "--json").stdout)]


@pytest.mark.parametrize(
    ("words", "name"),
    [("run", "toy_scan"), ("watch", "toy_scan"), ("export", "toy_export"), ("evaluate", "toy_policy"), ("doctor", "toy_export")],
)
def test_commands_offer_a_further_member(command: Do, words: str, name: str) -> None:
    assert name in command(words, "--help").stdout


def test_a_watch_knows_when_a_scan_of_a_further_format_is_whole(command: Do, place: Path) -> None:
    toy = place / "scans" / "room_1" / "toy.txt"
    before = toy.read_text()
    toy.write_text("half of\n")
    look = ("watch", "--scans", "scans", "--lake", "unmade", "--settle", 0, "--once", "--dry-run", "--json")
    try:
        assert json.loads(command(*look).stdout)["waiting"] == {"toys/room_1": "toy.txt: has no end"}
        toy.write_text("the end\n")
        seen = json.loads(command(*look).stdout)
        assert (seen["new"], seen["waiting"]) == (["toys/room_1"], {})
    finally:
        toy.write_text(before)


@pytest.mark.slow
@pytest.mark.whole
def test_further_members_make_rows_that_the_schemas_take(command: Do, lake: Path) -> None:
    assert answer(command, lake, "SELECT scene_id, room_id, scan_format FROM scenes") == [["toys/room_1", "toys/room", "toy_scan"]]
    assert answer(command, lake, "SELECT DISTINCT provider, outcome FROM candidates") == [["toy_provider", "filled"]]
    assert answer(command, lake, "SELECT DISTINCT scale FROM selections") == [[[1.0, 1.0, 1.0]]]
    assert answer(command, lake, "SELECT DISTINCT provider, provider_version, score FROM selections") == [["toy_method", "7", 0.1]]
    assert answer(command, lake, "SELECT path_finder FROM navmeshes UNION SELECT path_finder FROM episodes") == [["toy_finder"]]
    checks = "SELECT rule, passed FROM export_checks WHERE format = 'toy_export' ORDER BY rule"
    assert answer(command, lake, checks) == [["complete", True], ["toy_fault", True], ["toy_objects", True]]
    command("doctor", "lake", "--lake", lake)


@pytest.mark.slow
@pytest.mark.whole
def test_an_export_of_a_further_format_comes_before_its_gate(command: Do, lake: Path, place: Path) -> None:
    command("export", "--lake", lake, "--out", "out")
    (file,) = (place / "out" / "toy_export").glob("*.toy")
    command("doctor", "toy_export", file)
    fault = "toy_fault: toys_room_1.toy: it rattles"
    assert fault in command("doctor", "toy_export", file, code=1, TOY_FAULT="it rattles").stdout
    assert fault in command("export", "--lake", lake, "--out", "out", "--format", "toy_export", code=1, TOY_FAULT="it rattles").stderr


@pytest.mark.slow
@pytest.mark.whole
def test_objects_in_an_export_of_a_further_format_are_explained(command: Do, lake: Path, place: Path) -> None:
    command("export", "--lake", lake, "--out", "explained")
    (file,) = (place / "explained" / "toy_export").glob("*.toy")
    (obj,) = json.loads(file.read_text())["objects"]
    found = command("explain", f"{file}:{obj['name']}", "--lake", lake).stdout
    assert "toy_scan scan room_1" in found
    instance = json.loads(command("explain", f"{obj['scene_id']}/{obj['instance_id']}", "--lake", lake, "--json").stdout)
    shown = {node["facts"]["format"] for node in instance["nodes"] if node["kind"] == "export"}
    assert shown == {"toy_export", "glb"}
    assert instance["problems"] == []


@pytest.mark.slow
@pytest.mark.whole
def test_a_further_policy_acts(command: Do, lake: Path) -> None:
    said = json.loads(command("evaluate", "--policy", "toy_policy", "--lake", lake, "--json").stdout)
    assert [(row["policy"], row["run_name"], row["el"]) for row in said["metrics"]] == [("toy_policy", "built-in", 1.0)]


DERIVED = """
import json
from pathlib import Path
from typing import get_args
from bench.warehouse.generator import _rules
from flows.commands.demo import places_in
from flows.exporting import Format
from flows.run.parameters import stages_schema
from schemas.exports import ExportFile
from schemas.record import table_of
from warehouse.questions.documentation import table_section
stages = stages_schema()["properties"]
kinds = lambda field: field["anyOf"][0]["enum"]
print(json.dumps({
    "generator": _rules()["toy_export"],
    "demo": str(places_in(Path("demo"))["Toy lists"]),
    "form of exports": get_args(Format)[-1],
    "setting of exports": stages["exports"]["properties"]["formats"]["items"]["enum"][-1],
    "setting of alignment": kinds(stages["selection"]["properties"]["alignment"]["properties"]["method"])[-1],
    "setting of navigation": kinds(stages["navigation"]["properties"]["path_finder"])[-1],
    "setting of selection": kinds(stages["selection"]["properties"]["provider"])[-1],
    "setting of candidates": kinds(stages["candidates"]["properties"]["slots"]["items"]["properties"]["provider"])[-1],
    "documentation": "`toy_export`" in table_section(table_of(ExportFile)),
}))
"""


def test_forms_generators_the_demo_and_the_documentation_have_a_further_member(do: Do) -> None:
    assert json.loads(do("-c", DERIVED).stdout) == {
        "generator": ["complete", "toy_fault", "toy_objects"],
        "demo": "demo/toy_export",
        "form of exports": "toy_export",
        "setting of exports": "toy_export",
        "setting of alignment": "toy_alignment",
        "setting of navigation": "toy_finder",
        "setting of selection": "toy_method",
        "setting of candidates": "toy_provider",
        "documentation": True,
    }
