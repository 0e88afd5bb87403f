"""Fuzzing in little: every door has a target, every reader is come by, faults of readers are found, inputs that failed once do not."""

from __future__ import annotations

import ast
import gzip
import io
import json
import tracemalloc
import zipfile
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import pytest

from schemas.families.export_formats import EXPORT_FORMATS
from tests.conftest import REPOSITORY
from tests.fuzzing import broken
from tests.fuzzing.campaign import Campaign, Reading, Record, child, events, read_inputs
from tests.fuzzing.cases import Odd, packed, read_case, unpacked, write_case
from tests.fuzzing.child import Limits
from tests.fuzzing.doors import PARSER
from tests.fuzzing.mutations import changed
from tests.fuzzing.targets import targets

COUNTEREXAMPLES = sorted((REPOSITORY / "tests" / "counterexamples" / "inputs").glob("*.json"))

OPENERS = {
    "open", "open_file", "read_file", "read_bytes", "read_text", "read_limited", "read_json", "frombuffer", "fromstring", "unpack",
    "unpack_from", "loads", "load", "load_scene", "load_mesh", "from_xml_path", "from_xml_string", "Open", "DictReader", "decompress",
    "iterparse", "ZipFile", "safe_load", "loadtxt", "genfromtxt",
}  # fmt: skip
"""Names of what takes bytes that were read, or reads them."""

OWN = {
    "tasks/stats/": "draws rows of the lake",
    "tasks/lineage/": "draws rows of the lake",
    "tasks/optimization/": "reads answers of its own child",
    "tasks/scanner/": "reads what it wrote",
    "tasks/furniture/wild/foreign.py": "reads models that a benchmark of ours is given",
    "tasks/kernels/": "reads the code of the project, and its own list",
    "tasks/navigation/habitat.py bake_stage": "reads what habitat-sim wrote",
    "tasks/navigation/recast.py RecastPathFinder.": "is given navmeshes that were read",
    "tasks/exports/habitat/dataset.py": "joins our own exports",
    "tasks/exports/files.py files_below": "reads what was just exported",
    "tasks/exports/usd/layers.py new_stage": "opens what was just written",
    "tasks/exports/usd/package.py package": "packs what was just exported",
    "tasks/capture/record3d/archive.py main": "calls `unpack`, which is fuzzed",
    "tasks/exports/visuals.py Texture.baked": "turns textures of the lake",
    "tasks/exports/wavefront.py as_png": "turns textures of the lake",
    "tasks/captions/physics.py materials": "reads the package's own table",
    "tasks/capture/instances/naming.py _shapes": "reads the package's own table",
    "tasks/geometry/encoded_images.py encoded_image": "reads blobs of the lake",
    "tasks/geometry/meshes.py asset_surface": "reads blobs of the lake",
    "tasks/geometry/meshes.py read_points": "reads blobs of the lake",
    "tasks/geometry/pieces.py _unpacked": "reads its own cache",
    "tasks/geometry/gltf/child.py": "is the child of `tasks.geometry.gltf.decoding.decode`, which is fuzzed",
    "tasks/replica.py": "reads blobs of the lake",
    "tasks/robot/cart.py": "reads the scene that it just wrote",
    "tasks/views/crops.py decoded": "reads blobs of the lake",
    "tasks/capture/storeys/folder.py _write_frames": "copies images unread, which a reader of the scan has named",
    "tasks/selection/methods/encoders.py": "reads weights that the user names; tests/tasks/selection/test_foreign_methods.py damages them",
    "tasks/calls/": "reads answers of a server; tests/tasks/calls and tests/tasks/captions damage them",
    "tasks/capture/poses/open3d": "reads answers of its own child, and there its own settings",
    "tasks/capture/small_objects/supports.py": "reads a table that the user edits; damaged in test_supports.py",
    "tasks/capture/small_objects/detectors/commanded.py": "reads what a program of the user wrote; damaged in test_detectors.py",
    "tasks/capture/small_objects/items/": "reads prompts and lists of the package or the user; damaged in test_items.py",
    "tasks/weights.py": "reads weights that the user names; damaged in tests/tasks/test_weights.py",
    "tasks/library/": "reads models of libraries and their catalogs; tests/tasks/library damages them, and USD is read by a child",
    "tasks/texturing/": "reads assets of the lake, and what programs wrote; damaged in tests/tasks/texturing",
    "tasks/candidates/served.py": "reads answers of a server; tests/tasks/candidates/generation damages them",
    "tasks/candidates/commanded.py": "reads what a program wrote that the user named; damaged as above",
    "tasks/candidates/shap_e.py": "reads weights that the user names; damaged as above",
    "tasks/selection/methods/model.py _scorer": "reads models of the lake, which were checked when they came in",
    "tasks/selection/model/clouds.py unpacked": "reads its own cache",
    "tasks/selection/model/foreign.py checkpoint": "reads weights that the user names; damaged in tests/tasks/selection/model",
    "tasks/selection/model/sight.py config_from": "reads models of the lake, which were checked when they came in",
    "tasks/policy/inference/actor.py load_model": "reads models of the lake; damaged in tests/tasks/policy/test_policy_inference.py",
    "tasks/policy/model/config.py config_from": "reads models of the lake; damaged in tests/tasks/policy/test_policy_config.py",
    "tasks/policy/model/shapes.py Vocabulary.array": "reads nothing: it makes arrays of text",
    "tasks/policy/model/shapes.py vocabulary_in": "reads models of the lake; damaged in tests/tasks/policy/test_policy_config.py",
    "tasks/training/systems/navigation.py trained_on": "loads weights that it has just trained",
    "tasks/micro_scenes/categories.py": "reads a table that the user edits; damaged in tests/tasks/micro_scenes/test_categories.py",
    "tasks/synthesis/metrics/renders.py torchscript_features": "reads a network that the user names; damaged in test_metrics_learned.py",
    "tasks/synthesis/model/config.py config_from": "reads models of the lake, which were checked when they came in",
    "tasks/synthesis/model/encoding.py Encoding.arrays": "reads nothing: it makes arrays of text",
    "tasks/synthesis/model/encoding.py encoding_in": "reads models of the lake; damaged in tests/tasks/synthesis/test_encoding.py",
    "tasks/synthesis/model/foreign/": "reads weights that the user names; damaged in tests/tasks/synthesis",
    "tasks/training/checkpoints.py newest": "reads its own cache",
    "tasks/fidelity/marked_points.py": "reads blobs of the lake",
    **{
        f"tasks/exports/{name}/places.py": "reads what was exported, and of a file at hand in a process with bounds"
        for name in EXPORT_FORMATS
    },
}
"""Where files are read that nobody else has written, and what they are. Everywhere else, a function that reads is to be fuzzed."""


@pytest.fixture(scope="module")
def seeds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("seeds")


@pytest.fixture(scope="module")
def sound(seeds: Path) -> set[str]:
    """Functions that sound inputs of every target come by."""
    reached: set[str] = set()
    read_inputs(dict.fromkeys(targets(), 0), 12, Reading(seeds, within=True), {name: Record(name, 0) for name in targets()}, reached)
    return reached


def test_every_format_has_a_target() -> None:
    """The list is made from what the project declares; a new door without a sound input does not even make a list."""
    assert {f"doctor {name}" for name in EXPORT_FORMATS} <= set(targets())
    assert all(target.seeds() for target in targets().values())
    published = {path.parent.name for path in (REPOSITORY / "tasks").rglob("*.schema.json")}
    assert published == {"annotation", "evaluation"}, "a new kind of batch: it comes in as an outside input of a stage"


@pytest.mark.parametrize(("name", "members", "size"), [("a.json.gz", 1, 2**28), ("a.zip", 1, 2**28), ("a.zip", 100, 2**22)])
def test_a_change_of_an_input_that_unpacks_to_much_takes_little_memory(name: str, members: int, size: int) -> None:
    """The process that changes inputs also reads them, and its memory is limited for the reader."""
    stream, content = io.BytesIO(), b"[" * size
    if name.endswith("zip"):
        with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for number in range(members):
                archive.writestr(f"{number}.json", content)
    else:
        stream.write(gzip.compress(content, 1))
    del content
    tracemalloc.start()
    try:
        for number in range(60):
            assert changed({name: stream.getvalue()}, [], [number])
        assert tracemalloc.get_traced_memory()[1] < 2**27
    finally:
        tracemalloc.stop()


@pytest.mark.slow
@pytest.mark.whole
def test_few_inputs_of_every_target_are_read_or_refused(seeds: Path) -> None:
    counts = {name: 6 if target.count == PARSER else 1 for name, target in targets().items()}
    records = {name: Record(name, count) for name, count in counts.items()}
    read_inputs(counts, 12, Reading(seeds, within=True), records)
    assert {name: [f.error for f in record.failures.values()] for name, record in records.items() if record.failures} == {}
    assert all(record.inputs == record.wanted for record in records.values())
    assert sum(record.read for record in records.values()) > 100
    assert sum(record.refused for record in records.values()) > 100


def _functions(path: Path) -> Iterator[tuple[str, ast.FunctionDef]]:
    def below(node: ast.AST, prefix: str) -> Iterator[tuple[str, ast.FunctionDef]]:
        for inner in ast.iter_child_nodes(node):
            if isinstance(inner, ast.FunctionDef):
                yield prefix + inner.name, inner
                yield from below(inner, f"{prefix}{inner.name}.<locals>.")
            elif isinstance(inner, ast.ClassDef):
                yield from below(inner, f"{prefix}{inner.name}.")
            else:
                yield from below(inner, prefix)

    yield from below(ast.parse(path.read_text()), "")


def _opens(function: ast.FunctionDef) -> bool:
    for node in ast.walk(function):
        if isinstance(node, ast.Call):
            name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if name in OPENERS:
                return True
    return False


@pytest.mark.whole
def test_every_function_that_reads_a_file_is_come_by(sound: set[str]) -> None:
    forgotten = []
    for path in sorted((REPOSITORY / "tasks").rglob("*.py")):
        name = path.relative_to(REPOSITORY).as_posix()
        readers = [f"{name} {function}" for function, node in _functions(path) if _opens(node)]
        forgotten += [reader for reader in readers if reader not in sound and not reader.startswith(tuple(OWN))]
    assert forgotten == [], "add a sound input that comes by there to tests/fuzzing/seeds.py, or say in OWN whose files these are"


@pytest.fixture(scope="module")
def replayed(seeds: Path) -> dict[str, str]:
    """What came of inputs that failed once, by file."""
    found: dict[str, str] = {}
    left = list(COUNTEREXAMPLES)
    while left:
        files: dict[str, list[str]] = defaultdict(list)
        for path in left:
            files[json.loads(path.read_text())["target"]].append(str(path))
        begun = ""
        with child(dict.fromkeys(files, 0), 0, Reading(seeds, within=True), files=files) as (process, _):
            for event in events(process, Reading(seeds).patience):
                if event["event"] == "start":
                    begun = files[event["target"]][event["sound"]]
                elif event["event"] == "read":
                    found[begun] = f"{event['outcome']} {event['error']}"
                    begun = ""
            process.wait()
        if begun:
            found[begun] = f"failed: the process ended with {process.returncode}"
        elif any(str(path) not in found for path in left):
            raise AssertionError("the child ended without a word")
        left = [path for path in left if str(path) not in found]
    return found


@pytest.mark.whole
@pytest.mark.parametrize("path", COUNTEREXAMPLES, ids=lambda path: path.stem)
def test_an_input_that_failed_once_is_read_or_refused(path: Path, replayed: dict[str, str]) -> None:
    assert replayed[str(path)].split()[0] in ("read", "refused"), replayed[str(path)]


EXPECTED = {
    "raises": "KeyError", "spins": "took more seconds", "waits": "waited for ever", "fills": "took 0.", "hides": "MemoryError",
    "dies": "ended its process with SIGSEGV", "leaves": "SystemExit", "says_lines": "refusal of several lines",
    "says_what_cannot_be_printed": "refusal that cannot be printed",
}  # fmt: skip


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Record]]:
    out = tmp_path_factory.mktemp("broken")
    reading = Reading(out / "seeds", "tests.fuzzing.broken", Limits(seconds=1.0, bytes=170 << 20), patience=3.0)
    counts = {name: 2 if name in ("spins", "waits", "dies", "fills") else 5 for name in broken.targets()}
    campaign = Campaign(out, counts, 0, reading=reading)
    campaign.run(2, 60.0, lambda record: None)
    return out, campaign.records


@pytest.mark.slow
@pytest.mark.whole
@pytest.mark.parametrize("name", sorted(broken.targets()))
def test_a_fault_is_found_told_and_kept(name: str, found: tuple[Path, dict[str, Record]]) -> None:
    out, records = found
    record = records[name]
    assert record.inputs == record.wanted
    if name == "refuses":
        assert record.failed == 0
        assert record.refused > 0
        return
    assert record.failed > 0
    assert record.read + record.failed == record.wanted, "an input that is as it was is read, every other fails"
    assert [failure.error.startswith(EXPECTED[name]) for failure in record.failures.values()] == [True]
    (kept,) = (out / "failures" / name).glob("*.json")
    document = json.loads(kept.read_text())
    assert document["target"] == name
    assert unpacked(document["files"]) != {"a.json": broken.SOUND}


@pytest.mark.whole
def test_a_campaign_goes_on_where_it_stopped(tmp_path: Path) -> None:
    reading = Reading(tmp_path / "seeds", "tests.fuzzing.broken")
    first = Campaign(tmp_path, {"refuses": 5, "raises": 5}, 0, reading=reading)
    first.run(1, 60.0, lambda record: None)
    again = Campaign(tmp_path, {"refuses": 8}, 0, reading=reading)
    assert again.records["refuses"].inputs == 5
    again.run(1, 60.0, lambda record: None)
    assert again.records["refuses"].inputs == 8
    assert Campaign(tmp_path, {"raises": 5}, 0, reading=reading).records["raises"].inputs == 5
    assert Campaign(tmp_path, {"raises": 5}, 1, reading=reading).records["raises"].inputs == 0


def test_a_case_is_the_same_on_disk_and_as_a_counterexample(tmp_path: Path) -> None:
    case = {"a/b.json": b"{}\r\n", "c.bin": bytes(range(256)), "d": Odd("link", "nowhere"), "e": Odd("folder"), "f.txt": b"x\n" * 5000}
    write_case(case, tmp_path / "case")
    assert read_case(tmp_path / "case") == {name: content for name, content in case.items() if isinstance(content, bytes)}
    assert unpacked(json.loads(json.dumps(packed(case)))) == case
