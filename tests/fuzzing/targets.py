"""What is fuzzed: every door at which files of others come in.

The list follows from what the project declares: the outside inputs of stages, scan formats, commands of `doctor`, layouts
and mesh files of imports, flows that are deployed. What each needs besides is a sound input, in `seeds`; a door without
one is an error. Readers within (a PLY, a container of frames) are fuzzed by themselves, too, many more times; that nothing
which opens a file is forgotten is the test in `tests/test_fuzzing.py`.
"""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable
from functools import cache, partial
from importlib import import_module
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import LakeError
from schemas.files import check_file, is_there, read_file
from tasks.exports.formats import FORMATS
from tasks.families import member
from tests.fuzzing import seeds
from tests.fuzzing.doors import PARSER, STAGE, Refused, Target


@cache
def targets() -> dict[str, Target]:
    """All doors by name."""
    found = [*_outside_inputs(), *_scan_formats(), *_doctors(), *_imports(), *_models(), *_readers()]
    names = [target.name for target in found]
    assert len(set(names)) == len(names)
    return {target.name: target for target in found}


def _outside_inputs() -> list[Target]:
    """What stages declare to come from outside of the lake, but for scans, which have formats."""
    from tasks.pipeline import STAGES

    # scans have formats; the others are rows and models of a lake
    own = ("scan", "batch_acts", "dataset", "start", "provenance", "compared_batches", "drive_batch", "rescanned_rooms")
    names = {name for stage in STAGES for name in stage.outside if name not in own}
    names |= {"verdict_batch", "label_studio_batch", "cvat_batch"}  # what acts are made from
    return [Target(name.removesuffix("_batch"), PARSER, getattr(seeds, name), globals()[f"_read_{name}"]) for name in sorted(names)]


def _scan_formats() -> list[Target]:
    from schemas.families.scan_formats import SCAN_FORMATS

    return [Target(f"capture {name}", STAGE, lambda name=name: seeds.capture(name), _captured(name)) for name in SCAN_FORMATS]


def _doctors() -> list[Target]:
    from flows.commands.doctor import command

    foreign = sorted(set(command.commands) - {"lake"})  # a lake is nobody else's file
    return [_doctor(name) for name in foreign]


def _doctor(name: str) -> Target:
    """A check of files. Those that run a parser of others, or read a whole dataset, are run as the command runs them."""
    sound = seeds.glb if name == "glb" else getattr(seeds, f"doctor_{name}", lambda: seeds.exported(name))
    if name in ("glb", "nav2", "sdf", "urdf"):
        return Target(f"doctor {name}", PARSER, sound, _checked(name))
    return Target(f"doctor {name}", STAGE, sound, _examined(name), within=_checked(name))


def _imports() -> list[Target]:
    from tasks.ingestion.scene import KINDS

    return [Target(f"import {kind}", STAGE, getattr(seeds, f"import_{kind}"), _imported(kind)) for kind in sorted(KINDS)]


def _models() -> list[Target]:
    from tasks.ingestion.models import ENDINGS

    return [Target(f"model {ending}", PARSER, lambda ending=ending: seeds.models(ending), _model(ending)) for ending in ENDINGS]


def _readers() -> list[Target]:
    """Parsers of files within those: they are cheap, so that much more can be tried."""
    from schemas.families.scan_formats import SCAN_FORMATS

    found = [
        Target("glb", PARSER, seeds.glb, _read_glb),
        Target("gltf", PARSER, seeds.gltf, _read_glb),
        Target("gltf packed", STAGE, seeds.packed_gltf, _read_glb),
        Target("ply", PARSER, seeds.ply, _read_ply),
        Target("sens", PARSER, seeds.sens, _read_sens),
        Target("poses", PARSER, seeds.poses, _read_poses),
        Target("images", PARSER, seeds.images, _read_images),
        Target("labels", PARSER, seeds.labels, _read_labels),
        Target("navmesh", PARSER, seeds.navmesh, _read_navmesh),
        Target("mesh", PARSER, seeds.meshes, _read_mesh),
        Target("confined", STAGE, seeds.confined, _read_confined),
        Target("settings", PARSER, seeds.settings, _read_settings),
        Target("records", PARSER, seeds.records, _read_records),
        Target("parameters", PARSER, seeds.parameters, _read_parameters),
    ]
    known = {target.name for target in found}
    scans = [Target(name, PARSER, lambda name=name: seeds.capture(name), _read_scan(name)) for name in SCAN_FORMATS if name not in known]
    return [*found, *scans]


def _read_library(folder: Path) -> None:
    from tasks.library.folder import library_in
    from tasks.library.indexing import IndexConfig

    library = library_in(folder, IndexConfig(), {})
    for file in library.search.files:
        with contextlib.suppress(LakeError):  # of a file that changed meanwhile
            library.asset_of(file)


def _read_models_folder(folder: Path) -> None:
    from tasks.indexing import ModelsFolder, run
    from tasks.library.catalog import catalog_of
    from tasks.library.indexing import IndexConfig
    from tasks.stage import Context
    from tests.tasks.indexing.test_indexing import Files

    catalog = catalog_of(folder / "models", sorted(path for path in folder.glob("*") if path.is_file()))
    config = IndexConfig()
    run(models_folder=ModelsFolder(folder / "models", catalog, Files()), context=Context("models", "indexing", 0, {}), config=config)


def _read_model(folder: Path) -> None:
    from tasks.models import ModelFolder

    assert ModelFolder(folder).model.weights


def _read_annotation_batch(folder: Path) -> None:
    from tasks.annotation.batch import read_answers, read_batch
    from tasks.batches import parse_json

    read_batch(folder / "batch.json")
    if len(list(folder.rglob("*.json"))) == 1:  # as a page hands it over
        read_answers(parse_json(read_file(folder / "batch.json", "batch.json", 2**20), "batch.json"), "batch.json")


def _read_label_studio_batch(folder: Path) -> None:
    from tasks.annotation.exported import accounts_of
    from tasks.annotation.label_studio import read_label_studio

    read_label_studio(read_file(folder / "export.json", "export.json", 2**20), "export.json", accounts_of(["1=ada"]))


def _read_cvat_batch(folder: Path) -> None:
    from tasks.annotation.cvat import read_cvat
    from tasks.annotation.exported import accounts_of

    read_cvat(read_file(folder / "annotations.xml", "annotations.xml", 2**20), "annotations.xml", accounts_of(["ada=bob"]))


def _read_review_batch(folder: Path) -> None:
    from tasks.annotation.review import read_reviews

    read_reviews(folder / "reviews.json")


def _read_verdict_batch(folder: Path) -> None:
    from tasks.annotation.verdicts import load_review_file, read_verdicts

    read_verdicts(load_review_file(folder / "verdicts.json"), "verdicts.json")


def _read_trajectory_batch(folder: Path) -> None:
    from tasks.evaluation.batch import read_batch

    for path in sorted(folder.glob("batch.*")) or [folder / "batch.json"]:
        read_batch(path)


def _captured(format_: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        from schemas.record import check
        from schemas.tables import TABLES
        from tasks import capture
        from tasks.capture.fusion import FusionConfig
        from tasks.capture.wholeness import find_gap
        from tasks.stage import Context

        config = capture.CaptureConfig(fusion=FusionConfig(voxel_m=0.2))  # as coarse as tells a room: more inputs in the same time
        scans, _ = capture.find_scans(folder, format_)
        for scan in scans:
            find_gap(scan)
            capture.scan_files(scan)
            outcome = capture.run(scan=scan, context=Context(scan.scene_id, "capture", 0, {}), config=config)
            for table, rows in outcome.rows.items():
                try:
                    check(rows, TABLES[table].record)
                except LakeError as error:
                    raise AssertionError(f"rows that break their schema: {error}") from error

    return read


def _files(name: str, folder: Path) -> list[Path]:
    return sorted(folder.glob("scene.*")) if member(FORMATS, name).doctor.takes == "a file" else [folder]


def _checked(name: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        for path in _files(name, folder):
            for finding in member(FORMATS, name).check(path):
                str(finding)

    return read


def _examined(name: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        import click

        import flows.run.bounds
        from flows.commands.doctor import command
        from flows.terminal import Terminal

        for module in (f"tasks.exports.{name}.rules", *_FOREIGN.get(name, ())):
            import_module(module)  # loaded once, then forked
        flows.run.bounds.START = "fork"
        for path in _files(name, folder):
            try:
                with contextlib.redirect_stdout(Terminal(io.TextIOWrapper(io.BytesIO(), encoding="utf-8"), is_answer=True)):
                    command.main([name, str(path)], prog_name="doctor", standalone_mode=False)
            except click.exceptions.Exit as done:
                if done.exit_code not in (0, 1):
                    raise
            except click.UsageError as error:
                raise Refused(str(error)) from error

    return read


_FOREIGN = {
    "mjcf": ("mujoco",),
    "usd": ("pxr.Usd", "pxr.UsdGeom", "pxr.UsdPhysics", "pxr.UsdShade", "pxr.UsdUtils", "pxr.UsdValidation"),
    "habitat": ("trimesh",),
}
"""What the checks import when they are used."""


def _imported(kind: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        from tasks.ingestion.navmeshes import navigation_rows
        from tasks.ingestion.reading import ingest
        from tasks.ingestion.scene import IngestionConfig
        from tasks.ingestion.sources import find_sources
        from tasks.stage import Context

        names = folder / "instance_id_to_name" if kind == "metascenes" else None
        config = IngestionConfig()
        refused: LakeError | None = None
        for source in find_sources(kind, folder, "others", names):  # type: ignore[arg-type]
            try:
                ingest(source, Context(source.scene_id, "capture", 0, {}), config)
                navigation_rows(source, config)
            except LakeError as error:
                refused = error
        if refused is not None:
            raise refused

    return read


def _model(ending: str) -> Callable[[Path], None]:
    def read(folder: Path) -> None:
        from tasks.ingestion.materials import material_files
        from tasks.ingestion.models import is_convex, read_model

        path = folder / f"model{ending}"
        material_files(path, folder.resolve())
        parts, _ = read_model(path, folder.resolve(), is_z_up=True)
        is_convex(parts)

    return read


def _read_glb(folder: Path) -> None:
    from tasks.capture.files.documents import read_bytes
    from tasks.exports.gltf import open_glb
    from tasks.geometry.meshes import load_glb, surface_of

    data = read_bytes(folder / "scene.glb", "scene.glb", 2**26)
    with contextlib.suppress(LakeError):
        open_glb(data)
    surface_of(load_glb(data))


def _read_ply(folder: Path) -> None:
    from tasks.capture.files.ply import read_ply

    read_ply(folder / "mesh.ply", "mesh.ply")


def _read_sens(folder: Path) -> None:
    from tasks.capture.files.sens import open_sens

    container = open_sens(folder / "scan.sens", "scan.sens")
    for index in range(min(4, len(container.frames))):
        for image in (container.color, container.depth):
            with contextlib.suppress(LakeError):
                image(index)


def _read_poses(folder: Path) -> None:
    from tasks.capture.files.trajectory import read_trajectory

    for described in ("", "world-to-camera, OpenGL, qw qx qy qz", "left-handed"):
        for keys in (["0", "1", "2.5"], ["1", "2", "3"], ["1305031102.0", "1305031102_033000000"]):
            with contextlib.suppress(LakeError):
                read_trajectory(folder / "poses.txt", "poses.txt", keys, described)
    read_trajectory(folder / "poses.txt", "poses.txt", ["0", "1", "2.5"])


def _read_images(folder: Path) -> None:
    from tasks.capture.files.images import has_float_depth, image_size, read_color, read_depth

    for path in sorted(folder.iterdir()):
        size = image_size(path, path.name)
        has_float_depth(path, path.name)
        for read in (lambda path, size: read_color(path, path.name, size), lambda path, size: read_depth(path, path.name, size, 1000.0)):
            with contextlib.suppress(LakeError):
                read(path, size)


def _read_labels(folder: Path) -> None:
    from tasks.capture.labels import label_map

    label_map(str(folder / "labels.csv"))["chair"]


def _read_navmesh(folder: Path) -> None:
    from tasks.capture.files.documents import read_bytes
    from tasks.exports.habitat import navmesh_file
    from tasks.navigation.navmesh import polygon_areas, polygon_islands, read_navmesh
    from tasks.navigation.regions import walkable_region

    data = read_bytes(folder / "scene.navmesh", "scene.navmesh", 2**26)
    with contextlib.suppress(LakeError, ValueError):  # the second reader says ValueError, and what calls it knows
        _ = navmesh_file.read_polygons(data).islands
    found = read_navmesh(data)
    for tile in found.tiles:
        polygon_areas(tile)
        polygon_islands(tile)
    walkable_region(found)


def _read_scan(format_: str) -> Callable[[Path], None]:
    """A scan as far as its reader goes, with the pixels of two frames."""

    def read(folder: Path) -> None:
        from tasks.capture.formats import find_scans, format_of, room_of, scan_files
        from tasks.capture.wholeness import find_gap

        for scan in find_scans(folder, format_)[0]:
            find_gap(scan)
            scan_files(scan)
            frames = format_of(scan).read(scan).frames
            for frame in frames[:2]:
                for image in (frame.color, frame.depth):
                    with contextlib.suppress(LakeError):
                        _ = image is not None and image()
            room_of(scan)

    return read


def _read_mesh(folder: Path) -> None:
    from tasks.capture.bare_mesh import read_mesh
    from tasks.capture.formats import find_scans, scan_files

    for scan in find_scans(folder, "bare_mesh")[0]:
        scan_files(scan)
        read_mesh(scan)


def _read_confined(folder: Path) -> None:
    """Files of points and packed recordings by the functions that children with limits call."""
    from schemas.machine.scratch import temporary_folder
    from schemas.parsing import json_value
    from tasks.capture.files.video import _decode
    from tasks.capture.point_cloud.child import _read_e57, _read_las
    from tasks.capture.record3d.archive import unpack
    from tasks.confinement import FACTS, answer

    readers: dict[str, Callable[[Path, Path], dict[str, Any]]] = {
        ".las": lambda path, place: _read_las(path, path.name, place),
        ".e57": lambda path, place: _read_e57(path, path.name, place),
        ".mp4": lambda path, place: _decode(path, place, 1, 3),
        ".r3d": lambda path, place: unpack(path, place / "files"),
    }
    for path in sorted(folder.iterdir()):
        read = (lambda path, place: unpack(path.parent, place / "files")) if path.is_dir() else readers.get(path.suffix)
        if read is None:
            continue
        if not path.is_dir():  # as the parent does
            if not is_there(path):
                continue
            check_file(path, path.name, BUDGET.scene_bytes)
        with temporary_folder() as place:
            facts = {"refused": ["content", "takes more memory than a child has"]}
            with contextlib.suppress(MemoryError):  # a child dies of it, which its parent tells
                answer(place, partial(read, path, place), "export it again")
                facts = json_value((place / FACTS).read_bytes())
        if "refused" in facts:
            raise Refused(": ".join(facts["refused"]))


def _read_records(folder: Path) -> None:
    """JSON that the project wrote itself, to scans, caches and lakes, and that may be damaged."""
    from flows.run.fingerprints import FileHashes
    from flows.scans.mirror import facts_of
    from flows.scans.storeys import STOREYS_RECORD, _record
    from flows.view.annotating.keys import KeyFile
    from warehouse.sharing.held import parsed
    from warehouse.storage.files import storage_at
    from warehouse.tables.released import parse_release
    from warehouse.upkeep.erasure.plan import PATH, read_plan

    for file in sorted(folder.glob("*.json")):
        if file.name == STOREYS_RECORD:
            _record(folder)
        elif file.name == "file_hashes.json":
            FileHashes(file)
        elif file.name == "held.json":
            parsed(read_file(file, file.name, BUDGET.text_bytes))
        elif file.name == "release.json":
            parse_release(file.name, read_file(file, file.name, BUDGET.text_bytes))
        elif file.name == "version.json":
            facts_of(file)
        elif file.name == "tokens.json":
            KeyFile(file).read()
        elif file.name == PATH and file.is_file():
            read_plan(storage_at(folder))


def _read_settings(folder: Path) -> None:
    from flows.run.configuration import configure

    refused: LakeError | None = None
    lines = folder / "sets.txt"
    settings = lines.read_text(errors="replace").splitlines() if lines.is_file() and lines.stat().st_size < 2**24 else []
    for setting in settings:
        try:
            configure(settings=[setting])
        except LakeError as error:
            refused = error
    configure(file=folder / "settings.toml" if not settings else None, settings=settings)
    if refused is not None:
        raise refused


@cache
def deployed() -> dict[str, dict[str, Any]]:
    """Parameters of the deployments of `prefect.yaml`, by the flow that they run."""
    import yaml

    from flows.server.deployments import deployment_file

    found: dict[str, dict[str, Any]] = {}
    for one in yaml.safe_load(deployment_file().read_text())["deployments"]:
        found.setdefault(one["entrypoint"], {}).update(one.get("parameters", {}))
    return found


@cache
def _flow(entrypoint: str) -> Any:
    from prefect import Flow

    module, _, name = entrypoint.rpartition(".")
    found = getattr(import_module(module), name)
    if not isinstance(found, Flow):
        raise TypeError(f"{entrypoint} is no flow")
    return found


def _read_parameters(folder: Path) -> None:
    """What the server hands to a worker: JSON, held against the types of the flow."""
    from prefect.exceptions import ParameterBindError, ParameterTypeError, SignatureMismatchError
    from pydantic import TypeAdapter, ValidationError

    from flows.run.parameters import StageTables

    try:
        document = json.loads(read_file(folder / "parameters.json", "parameters.json", 2**24))
        flow, told = _flow(str(document["flow"])), dict(document["parameters"])
    except Exception as error:  # not ours: the server has read it before
        raise Refused("no parameters of a flow") from error
    try:
        if isinstance(told.get("stages"), dict):
            with contextlib.suppress(ValidationError):
                TypeAdapter(StageTables).validate_python(told["stages"])
        flow.validate_parameters(told)
    except (ParameterTypeError, ParameterBindError, SignatureMismatchError) as error:
        raise Refused(str(error)[:200]) from error
