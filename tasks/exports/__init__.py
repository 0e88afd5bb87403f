"""Files for simulators: a USD scene with physics, and the scene's part of a Habitat dataset with episodes.

Nothing is exported unseen: every export is read back and checked, and `export_checks` has the verdict of every rule.
"""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath

from schemas.candidates import Asset
from schemas.captions import Caption
from schemas.capture import Instance, Room, Scene
from schemas.exports import ExportCheck, ExportFile
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Placement, Support
from tasks.exports.bodies import Replica, gather
from tasks.exports.config import ExportsConfig, HabitatConfig, UsdConfig
from tasks.pieces import PieceConfig
from tasks.stage import Blobs, Context, Outcome, Stage

__all__ = ["STAGE", "ExportsConfig", "HabitatConfig", "PieceConfig", "UsdConfig", "run", "write_folder"]

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
    for format_ in config.formats:
        made, verdict, lost = (
            _usd(replica, blobs, config) if format_ == "usd" else _habitat(replica, navmeshes, episodes, blobs, context, config)
        )
        files += made
        checks += verdict
        missed += lost
        complete = len(replica.bodies) == len(placements)
        message = None if complete else f"{len(replica.bodies)} of {len(placements)} objects"
        checks.append(ExportCheck(scene_id=replica.scene_id, format=format_, rule="complete", passed=complete, message=message))
    return Outcome(export_files=files, export_checks=checks, blobs=blobs, degradations=missed)


def _usd(replica: Replica, blobs: Blobs, config: ExportsConfig) -> tuple[list[ExportFile], list[ExportCheck], list[str]]:
    """The USD scene: written to a temporary folder, checked there, read back."""
    from tasks.exports.findings import verdicts
    from tasks.exports.usd import write_usd
    from tasks.exports.usd_rules import RULES, check_usd

    files = []
    with tempfile.TemporaryDirectory(prefix="usd-") as place:
        root = Path(place).resolve()
        findings = check_usd(write_usd(root, replica, config))
        for path in sorted(path for path in root.rglob("*") if path.is_file()):
            name = path.relative_to(root).as_posix()
            files.append(_row(replica.scene_id, "usd", name, path.read_bytes(), _usd_role(name), blobs))
    return files, verdicts(replica.scene_id, "usd", RULES, findings), []


def _usd_role(name: str) -> str:
    """Role of a file of a USD scene, by its path."""
    parts = PurePosixPath(name).parts
    return next((role for part, role in _USD_ROLES.items() if part in parts), "asset")


def _habitat(
    replica: Replica, navmeshes: Sequence[Navmesh], episodes: Sequence[Episode], blobs: Blobs, context: Context, config: ExportsConfig
) -> tuple[list[ExportFile], list[ExportCheck], list[str]]:
    """The scene's part of the Habitat dataset, checked as a dataset of this one scene."""
    from tasks.exports.findings import verdicts
    from tasks.exports.habitat import habitat_files
    from tasks.exports.habitat_rules import RULES, check_habitat
    from tasks.exports.layout import layout, shared_files

    navmesh = _navmesh(navmeshes, episodes, config)
    missed = [] if navmesh is not None else ["no navmesh: the Habitat scene has neither navmesh nor episodes"]
    others = sorted(row.agent for row in navmeshes if navmesh is not None and row.agent != navmesh.agent)
    missed += [f"navmesh and episodes of agent {agent!r} are left out: a Habitat scene has one navmesh" for agent in others]
    made, lost = habitat_files(replica, None if navmesh is None else (navmesh, context.blobs[navmesh.navmesh_blob]), episodes, config)
    files = [_row(replica.scene_id, "habitat", file.path, file.data, file.role, blobs) for file in made]
    with tempfile.TemporaryDirectory(prefix="dataset-") as place:
        root = Path(place).resolve() / "habitat"
        write_folder(root.parent, {path: blobs[name] for path, name in layout(files).items()} | shared_files(files, blobs, config.habitat))
        findings = check_habitat(root)
    return files, verdicts(replica.scene_id, "habitat", RULES, findings), missed + lost


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


def _row(scene_id: str, format_: str, path: str, data: bytes, role: str, blobs: Blobs) -> ExportFile:
    """The row of a file, whose contents are kept as a blob."""
    name = blobs.add(data, PurePosixPath(path).suffix.lstrip("."))
    return ExportFile(scene_id=scene_id, format=format_, path=path, file_blob=name, size_bytes=len(data), role=role)


STAGE = Stage(
    name="exports",
    reads=("scenes", "rooms", "instances", "captions", "assets", "placements", "supports", "navmeshes", "episodes"),
    writes=("export_files", "export_checks"),
    config=ExportsConfig,
    run=run,
)
