"""Files for simulators and robots: a USD scene with physics, the scene's part of a Habitat dataset with episodes, MJCF, URDF, GLB, a world
for Gazebo and a map for nav2.

Nothing is exported unseen: every export is read back and checked, and `export_checks` has the verdict of every rule.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence
from pathlib import PurePosixPath

from schemas.candidates import Asset
from schemas.captions import Caption
from schemas.capture import Instance, RoomSurface, Scene, Shell
from schemas.exports import ExportCheck, ExportFile
from schemas.navigation import Episode, Navmesh
from schemas.optimization import Placement, Support
from tasks.exports.bodies import gather
from tasks.exports.config import ExportsConfig, HabitatConfig, MjcfConfig, Nav2Config, SdfConfig, UsdConfig
from tasks.exports.files import Export, File, write_folder
from tasks.exports.findings import verdicts
from tasks.exports.format import ExportedScene
from tasks.exports.formats import FORMATS
from tasks.families import member
from tasks.geometry.pieces import PieceConfig
from tasks.stage import Blobs, Context, Outcome, Stage

__all__ = [
    "STAGE", "ExportsConfig", "HabitatConfig", "MjcfConfig", "Nav2Config", "PieceConfig", "SdfConfig", "UsdConfig", "run", "write_folder",
]  # fmt: skip


_MOST_PREPARED = 400_000
"""Faces of a scene up to which texts of its meshes are made once, some 25 MB, and sent to who writes the formats."""


def run(
    *, scenes: Sequence[Scene], shells: Sequence[Shell], instances: Sequence[Instance], captions: Sequence[Caption],
    assets: Sequence[Asset], placements: Sequence[Placement], supports: Sequence[Support], navmeshes: Sequence[Navmesh],
    episodes: Sequence[Episode], context: Context, config: ExportsConfig, surfaces: Sequence[RoomSurface] = (),
) -> Outcome:  # fmt: skip
    """Export one scene in every format of `config.formats`, and check what came out.

    Raises:
        InputError: the scene has no room.
    """
    known = context.caches["tasks.geometry.pieces"]
    replica, missed = gather(scenes, shells, instances, captions, assets, placements, supports, context.blobs, config, known, surfaces)
    blobs = Blobs()
    files: list[ExportFile] = []
    checks: list[ExportCheck] = []
    named = {navmesh.navmesh_blob: context.blobs[navmesh.navmesh_blob] for navmesh in navmeshes}
    scene = ExportedScene(replica, navmeshes, episodes, named, config)
    work = _prepared(scene)
    for format_, made in zip(config.formats, context.spread(_made, work), strict=True):
        passed = not any(finding.is_error for finding in made.findings)
        files += [_row(replica.scene_id, format_, file, passed, blobs) for file in made.files]
        checks += verdicts(replica.scene_id, format_, made.rules, made.findings)
        missed += made.missed
        complete = len(replica.bodies) == len(placements)
        message = None if complete else f"{len(replica.bodies)} of {len(placements)} objects"
        checks.append(ExportCheck(scene_id=replica.scene_id, format=format_, rule="complete", passed=complete, message=message))
    return Outcome(export_files=files, export_checks=checks, blobs=blobs, degradations=missed)


def _prepared(scene: ExportedScene) -> list[tuple[str, ExportedScene]]:
    """The scene for each format: with what several of them make of shapes alike, for these, where it is not too large to be sent."""
    formats = scene.config.formats
    preparing = {name: made.prepare for name in formats if (made := member(FORMATS, name)).prepare is not None}
    bodies = scene.replica.bodies
    bare = {id(body.shape): dataclasses.replace(body.shape) for body in bodies}  # of which nothing was made yet
    again = tuple(dataclasses.replace(body, shape=bare[id(body.shape)]) for body in bodies)
    plain = dataclasses.replace(scene, replica=dataclasses.replace(scene.replica, bodies=again))
    if len(preparing) > 1 and sum(len(part.faces) for body in bodies for part in body.shape.parts) <= _MOST_PREPARED:
        for body, prepare in itertools.product(bodies, preparing.values()):
            prepare(body.shape)
    return [(name, scene if name in preparing else plain) for name in formats]


def _made(work: tuple[str, ExportedScene]) -> Export:
    format_, scene = work
    return member(FORMATS, format_).make(scene)


def _row(scene_id: str, format_: str, file: File, passed: bool, blobs: Blobs) -> ExportFile:
    """The row of a file, whose contents are kept as a blob."""
    name = blobs.add(file.data, PurePosixPath(file.path).suffix.lstrip("."))
    return ExportFile(
        scene_id=scene_id, format=format_, path=file.path, file_blob=name, size_bytes=len(file.data), role=file.role, passed=passed
    )  # fmt: skip


STAGE = Stage(
    name="exports",
    reads=("scenes", "shells", "surfaces", "instances", "captions", "assets", "placements", "supports", "navmeshes", "episodes"),
    writes=("export_files", "export_checks"),
    config=ExportsConfig,
    run=run,
)
