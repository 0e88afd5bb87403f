"""Scenes to compare engines on: the demo's, generated ones, a house, those of a lake; exported by the project as anybody would."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.realdata import HOUSE, HOUSE_VOXEL_M, MODELS
from bench.replicas import as_replica
from bench.rooms import generated_scene
from flows.outputs.export import write_exports
from flows.run.pool import WorkerPool
from schemas.errors import InputError
from schemas.optimization import Certificate, Placement
from tasks import exports
from tasks.exports import ExportsConfig
from tasks.exports.bodies import stem
from tasks.exports.urdf.places import places
from tasks.geometry.transforms import matrix
from tasks.navigation import NavigationConfig
from tasks.stage import Context
from warehouse.lake import Lake

FILES = {"mjcf": "scene.xml", "urdf": "poses.json", "usd": "scene.usda"}
"""Formats that engines read, and the file of a scene to begin with."""


@dataclasses.dataclass(frozen=True)
class SceneFiles:
    """A scene in files. source: what made it. objects: how many, fixed ones too. files: to begin with, by format.

    Of its free objects: names: of their bodies, `<category>_<instance>`. poses: exported, asset to world, 4x4 [m].
    certified: by the certificate, stable at 1 cm.
    """

    scene_id: str
    source: str
    objects: int
    files: Mapping[str, Path]
    names: Mapping[str, str]
    poses: Mapping[str, NDArray[np.float64]]
    certified: Mapping[str, bool]


@dataclasses.dataclass(frozen=True)
class SceneChoice:
    """Which scenes. demo, rooms: how many. realdata: folder of the house, lake: address of more scenes; None for none.

    folder: where lakes and exports are made; what is there and unchanged is not made again.
    """

    folder: Path
    demo: int = 3
    rooms: int = 10
    realdata: Path | None = None
    lake: str | None = None
    seed: int = 0
    processes: int = 1

    @property
    def steps(self) -> int:
        """How often the making of scenes advances."""
        return self.rooms + sum(map(bool, (self.demo, self.realdata, self.lake)))

    @property
    def left_out(self) -> list[str]:
        """What belongs to the whole set and was not asked for, a line each."""
        lines = [] if self.realdata else ["the house: METASCENES_REALDATA or --realdata names the folder that holds it"]
        lines += [] if self.demo >= 3 else [f"{3 - self.demo} of the demo's 3 scenes"]
        return lines + ([] if self.rooms >= 10 else [f"{10 - self.rooms} of 10 generated rooms"])


def exported_scenes(choice: SceneChoice, advance: Callable[[str], None]) -> list[SceneFiles]:
    """All scenes of the choice. `advance` is given the name of each part that is made.

    Raises:
        InputError: the house is not where it should be, a run failed, or a lake has no exports.
    """
    scenes: list[SceneFiles] = []
    options = ("--seed", str(choice.seed), "--workers", str(choice.processes))
    if choice.demo:
        out = choice.folder / "demo"
        _metascenes("demo", "--out", out, "--scenes", choice.demo, *options)
        scenes += of_lake(str(out / "lake"), choice.folder / "exports" / "demo", "demo")
        advance("demo")
    if choice.rooms:
        shutil.rmtree(choice.folder / "exports" / "generated", ignore_errors=True)
        with WorkerPool(choice.processes) as pool, ThreadPoolExecutor(choice.processes) as threads:
            for scene in threads.map(partial(pool.call, generated, choice), range(choice.rooms)):
                scenes.append(scene)
                advance(scene.scene_id)
    if choice.realdata is not None:
        scenes += of_lake(str(_house(choice, choice.realdata, options)), choice.folder / "exports" / "house", "house")
        advance("house")
    if choice.lake is not None:
        scenes += of_lake(choice.lake, choice.folder / "exports" / "lake", "lake")
        advance("lake")
    return scenes


def generated(choice: SceneChoice, index: int) -> SceneFiles:
    """A generated room, disturbed, optimized and exported. Runs in a worker."""
    caches: Any = defaultdict(dict)
    scene = generated_scene(index, choice.rooms, choice.seed)
    rows, blobs, _ = as_replica(scene, choice.seed, caches, NavigationConfig(train_episodes=0, test_episodes=0))
    context = Context(scene.scene_id, "exports", choice.seed, blobs, caches)
    tables = {table: rows[table] for table in exports.STAGE.reads}
    outcome = exports.run(**tables, context=context, config=ExportsConfig(formats=tuple(FILES)))
    out = choice.folder / "exports" / "generated"
    for format_ in FILES:
        files = {row.path: outcome.blobs[row.file_blob] for row in outcome.rows["export_files"] if row.format == format_}
        exports.write_folder(out / format_, files)
    return _exported(scene.scene_id, "generated", out, rows["placements"], rows["certificates"])


def of_lake(address: str, out: Path, source: str) -> list[SceneFiles]:
    """The scenes of a lake, exported to `out`."""
    lake = Lake.open(address)
    reader = lake.snapshot()
    write_exports(lake, out, tuple(FILES))
    placements, certificates = defaultdict(list), defaultdict(list)
    for placement in reader.rows(Placement):
        placements[placement.scene_id].append(placement)
    for certificate in reader.rows(Certificate):
        certificates[certificate.scene_id].append(certificate)
    return [_exported(scene, source, out, placements[scene], certificates[scene]) for scene in sorted(placements)]


def _exported(scene_id: str, source: str, out: Path, placements: Iterable[Placement], certificates: Iterable[Certificate]) -> SceneFiles:
    """The scene as its files, and what the certificates say of its free objects."""
    poses = {row.instance_id: matrix(row.optimized_pose) for row in placements}
    judged = [row for row in certificates if row.engine == "mujoco" and not row.is_fixed]
    certified = {row.instance_id: row.is_stable_1cm and row.is_stable_nudged is not False for row in judged}
    files = {format_: (out / format_ / stem(scene_id) / name).resolve() for format_, name in FILES.items()}
    names = {about["instance_id"]: name for name, about in places(files["urdf"].read_bytes())}
    free = sorted(certified)
    return SceneFiles(
        scene_id, source, len(poses), files, {key: names.get(key, key) for key in free}, {key: poses[key] for key in free}, certified
    )  # fmt: skip


def _house(choice: SceneChoice, realdata: Path, options: tuple[str, ...]) -> Path:
    """The lake of the house, scanned once and rebuilt with its authors' own models."""
    house, folder = realdata / HOUSE, choice.folder / "house"
    if not house.is_file():
        raise InputError(str(realdata), "--realdata", f"holds no {HOUSE}", "name the folder that does, or leave the option out")
    if not (folder / "scans" / "house.truth.json").exists():
        shutil.rmtree(folder / "scans", ignore_errors=True)
        _metascenes("scan", house, "--out", folder / "scans", "--voxel", HOUSE_VOXEL_M)
    library = ("--dataset", "house", "--library", realdata / MODELS)
    _metascenes("run", "--scans", folder / "scans", *library, "--lake", folder / "lake", *options)
    return folder / "lake"


def _metascenes(*words: object) -> None:
    """A command of the project's, as it is typed."""
    done = subprocess.run([sys.executable, "-m", "flows.cli", *map(str, words)], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        last = (done.stderr.strip() or "it does not say why").splitlines()[-1]
        raise InputError(f"metascenes {words[0]}", "", f"ended with code {done.returncode}: {last}", "run it alone to see more")
