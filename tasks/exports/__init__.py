"""Files for simulators: a USD scene with physics, the scene's part of a Habitat dataset with episodes, MJCF, URDF and GLB.

Nothing is exported unseen: every export is read back and checked, and `export_checks` has the verdict of every rule.
"""

from __future__ import annotations

import dataclasses
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath

from schemas.candidates import Asset
from schemas.captions import Caption
from schemas.capture import Instance, Room, Scene
from schemas.exports import ExportCheck, ExportFile
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Placement, Support
from tasks.exports.bodies import Replica, gather
from tasks.exports.config import ExportsConfig, HabitatConfig, MjcfConfig, UsdConfig
from tasks.exports.files import Export, File, files_below
from tasks.exports.findings import Finding, verdicts
from tasks.pieces import PieceConfig
from tasks.stage import Blobs, Context, Outcome, Stage

__all__ = ["STAGE", "ExportsConfig", "HabitatConfig", "MjcfConfig", "PieceConfig", "UsdConfig", "run", "write_folder"]

_USD_ROLES = {"scene.usda": "scene", "room": "stage", "textures": "texture"}


def run(
    *, scenes: Sequence[Scene], rooms: Sequence[Room], instances: Sequence[Instance], captions: Sequence[Caption], assets: Sequence[Asset],
    placements: Sequence[Placement], supports: Sequence[Support], navmeshes: Sequence[Navmesh], episodes: Sequence[Episode],
    context: Context, config: ExportsConfig,
) -> Outcome:  # fmt: skip
    """Export one scene in every format of `config.formats`, and check what came out.

    Raises:
        InputError: the scene has no room.
    """
    known = context.caches["tasks.pieces"]
    replica, missed = gather(scenes, rooms, instances, captions, assets, placements, supports, context.blobs, config, known)
    blobs = Blobs()
    files: list[ExportFile] = []
    checks: list[ExportCheck] = []
    scene = _Scene(replica, navmeshes, episodes, context.blobs, config)
    for format_ in config.formats:
        made = _MAKERS[format_](scene)
        passed = not any(finding.is_error for finding in made.findings)
        files += [_row(replica.scene_id, format_, file, passed, blobs) for file in made.files]
        checks += verdicts(replica.scene_id, format_, made.rules, made.findings)
        missed += made.missed
        complete = len(replica.bodies) == len(placements)
        message = None if complete else f"{len(replica.bodies)} of {len(placements)} objects"
        checks.append(ExportCheck(scene_id=replica.scene_id, format=format_, rule="complete", passed=complete, message=message))
    return Outcome(export_files=files, export_checks=checks, blobs=blobs, degradations=missed)


@dataclasses.dataclass(frozen=True)
class _Scene:
    """What a format is made of."""

    replica: Replica
    navmeshes: Sequence[Navmesh]
    episodes: Sequence[Episode]
    blobs: Mapping[str, bytes]
    config: ExportsConfig


def _usd(scene: _Scene) -> Export:
    """The USD scene: written to a temporary folder, checked there, read back."""
    from tasks.exports.usd import write_usd
    from tasks.exports.usd.rules import RULES, check_usd

    with tempfile.TemporaryDirectory(prefix="usd-") as place:
        root = Path(place).resolve()
        findings = check_usd(write_usd(root, scene.replica, scene.config))
        return Export(files_below(root, _usd_role), RULES, findings)


def _usd_role(name: str) -> str:
    """Role of a file of a USD scene, by its path."""
    parts = PurePosixPath(name).parts
    return next((role for part, role in _USD_ROLES.items() if part in parts), "asset")


def _habitat(scene: _Scene) -> Export:
    """The scene's part of the Habitat dataset, checked as a dataset of this one scene."""
    from tasks.exports.habitat import habitat_files
    from tasks.exports.habitat.rules import RULES, check_habitat
    from tasks.exports.layout import dataset_of

    config, replica = scene.config, scene.replica
    navmesh = _navmesh(scene.navmeshes, scene.episodes, config)
    missed = [] if navmesh is not None else ["no navmesh: the Habitat scene has neither navmesh nor episodes"]
    others = sorted(row.agent for row in scene.navmeshes if navmesh is not None and row.agent != navmesh.agent)
    missed += [f"navmesh and episodes of agent {agent!r} are left out: a Habitat scene has one navmesh" for agent in others]
    files, lost = habitat_files(
        replica, None if navmesh is None else (navmesh, scene.blobs[navmesh.navmesh_blob]), scene.episodes, config
    )  # fmt: skip
    with tempfile.TemporaryDirectory(prefix="dataset-") as place:
        root = Path(place).resolve() / "habitat"
        write_folder(root, {file.path: file.data for file in files} | dataset_of(files))
        return Export(files, RULES, check_habitat(root), [*missed, *lost])


def _mjcf(scene: _Scene) -> Export:
    """The MuJoCo model, compiled and stepped once."""
    from tasks.exports.mjcf import mjcf_files
    from tasks.exports.mjcf.rules import RULES, check_mjcf

    files = mjcf_files(scene.replica, scene.config)
    return _checked(files, RULES, lambda root: check_mjcf(root / scene.replica.stem / "scene.xml"))


def _urdf(scene: _Scene) -> Export:
    """A URDF file per object, and where they stand."""
    from tasks.exports.urdf import urdf_files
    from tasks.exports.urdf.rules import RULES, check_urdf

    files = urdf_files(scene.replica, scene.config)
    return _checked(files, RULES, lambda root: check_urdf(root / scene.replica.stem))


def _glb(scene: _Scene) -> Export:
    """The whole scene in one glTF binary."""
    from tasks.exports.glb import glb_files
    from tasks.exports.glb.rules import RULES, check_glb

    files = glb_files(scene.replica, scene.config)
    return _checked(files, RULES, lambda root: check_glb(root / files[0].path))


def _checked(files: Sequence[File], rules: Iterable[str], check: Callable[[Path], Sequence[Finding]]) -> Export:
    """Files written to a temporary folder and checked there."""
    with tempfile.TemporaryDirectory(prefix="export-") as place:
        root = Path(place).resolve()
        write_folder(root, {file.path: file.data for file in files})
        return Export(files, rules, check(root))


def write_folder(root: Path, files: Mapping[str, bytes]) -> None:
    """Write files by path, below `root`."""
    for path, data in files.items():
        target = root / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(data)


def _navmesh(navmeshes: Sequence[Navmesh], episodes: Sequence[Episode], config: ExportsConfig) -> Navmesh | None:
    """The navmesh to export: of the agent that is asked for, else of the one with the most episodes."""
    wanted = config.habitat.agent
    count = Counter(episode.agent for episode in episodes)
    found = [row for row in navmeshes if wanted is None or row.agent == wanted]
    return min(found, key=lambda row: (-count[row.agent], row.agent), default=None)


def _row(scene_id: str, format_: str, file: File, passed: bool, blobs: Blobs) -> ExportFile:
    """The row of a file, whose contents are kept as a blob."""
    name = blobs.add(file.data, PurePosixPath(file.path).suffix.lstrip("."))
    return ExportFile(
        scene_id=scene_id, format=format_, path=file.path, file_blob=name, size_bytes=len(file.data), role=file.role, passed=passed
    )  # fmt: skip


_MAKERS: Mapping[str, Callable[[_Scene], Export]] = {"usd": _usd, "habitat": _habitat, "mjcf": _mjcf, "urdf": _urdf, "glb": _glb}
"""How each of `schemas.exports.FORMATS` is made."""

STAGE = Stage(
    name="exports",
    reads=("scenes", "rooms", "instances", "captions", "assets", "placements", "supports", "navmeshes", "episodes"),
    writes=("export_files", "export_checks"),
    config=ExportsConfig,
    run=run,
)
