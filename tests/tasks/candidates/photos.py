"""An object of known shape and colors that was scanned, and the frames that were taken of it, as a scan has them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from schemas.candidates import Asset, Candidate, TextureCharts
from schemas.capture import Frame, Instance
from schemas.record import check
from tasks.calls.ledger import Recollection
from tasks.candidates import CandidatesConfig, SlotConfig, run
from tasks.capture.scan import Scan
from tasks.furniture import generate
from tasks.geometry.meshes import Surface, surface_of
from tasks.geometry.rendering import Camera, RayScene
from tasks.geometry.transforms import flat, look_at, yaw_pose
from tasks.stage import Context, Outcome, in_turn
from tasks.views.pictures import png_of
from tests.capture_scans import BoxRoom, plate, write_posed_rgbd
from tests.tasks.candidates.crops import Spread, scanned
from tests.tasks.texturing.painting import paint

Array = np.ndarray

SCENE = "test/room"
SIZES = {1: ("chair", (0.5, 0.48, 0.9)), 2: ("nightstand", (0.4, 0.5, 0.55))}
YAW = 0.4


@dataclasses.dataclass(frozen=True)
class Photos:
    """Objects that were photographed. surface: of all, painted by place, with the floor, world frame [m]."""

    surface: Surface
    instances: tuple[Instance, ...]
    blobs: dict[str, bytes]
    frames: tuple[Frame, ...]
    cameras: tuple[Camera, ...]
    scan: Scan

    def offered(
        self, *slots: SlotConfig, scan: Scan | None = None, ledger: Recollection | None = None, spread: Spread = in_turn, **more: Any
    ) -> Outcome:
        """Candidates of all objects."""
        context = Context(SCENE, "candidates", 3, self.blobs, spread=spread, ledger=ledger or Recollection())
        outcome = run(
            instances=list(self.instances), frames=list(self.frames), masks=[], captions=[], library=None, scan=scan, context=context,
            config=CandidatesConfig(slots=slots, **more),
        )  # fmt: skip
        for table, record in (("candidates", Candidate), ("assets", Asset), ("texture_charts", TextureCharts)):
            check(outcome.rows[table], record)
        return outcome


def around(middle: Sequence[float], count: int, radius: float, rise: float, turn: float = 0.0) -> list[Camera]:
    """Cameras around a place that look at it [m]."""
    turns = turn + 2 * np.pi * np.arange(count) / count
    eyes = np.stack([radius * np.cos(turns), radius * np.sin(turns), np.full(count, rise)], axis=1) + np.asarray(middle)
    return [Camera.with_fov(look_at(eye, np.asarray(middle, dtype=float)), 200, 150, 0.9) for eye in eyes]


def photographed(folder: Path, numbers: Sequence[int] = (1,)) -> Photos:
    """A folder of posed frames of some objects that stand on a floor, and their rows."""
    floor, triangles = plate([0, 0, -0.001], [5, 0, 0], [0, 4, 0], 0.5)
    vertices, faces, instances, blobs, cameras = [floor], [triangles], [], {}, []
    for number in numbers:
        category, extents = SIZES[number]
        parts = generate(category, extents, np.random.default_rng(number)).parts
        instance, files = scanned(number, category, parts, YAW)
        place = [1.0 + number, 2.0, 0.0]  # as `scanned` puts it
        body = surface_of(parts).transformed(yaw_pose(YAW, place))
        points, corners = trimesh.remesh.subdivide_to_size(body.vertices, body.faces, 0.03)
        faces.append(corners + sum(len(each) for each in vertices))
        vertices.append(points)
        instances.append(instance)
        blobs |= files
        middle = [*place[:2], 0.4]
        cameras += [*around(middle, 5, 1.5, 0.7), *around(middle, 5, 1.3, 1.2, 0.6)]
    points = np.concatenate(vertices)
    surface = Surface(points, np.concatenate(faces), paint(points).round().astype(np.uint8))
    room = BoxRoom(surface, np.zeros(len(points), dtype=np.int64), (), tuple(cameras))
    write_posed_rgbd(folder, room)
    scene = RayScene([surface.to_trimesh()])
    for number, camera in enumerate(cameras, start=1):  # as things are, without the light that the writer has
        (folder / "color" / f"{number}.png").write_bytes(png_of(scene.render(camera, shade=False).color))
    frames = tuple(
        Frame(
            scene_id=SCENE, frame_id=f"{number:06d}", color_file=f"color/{number}.png", depth_file=f"depth/{number}.png",
            width=camera.width, height=camera.height,
            intrinsics=(camera.fx, camera.fy, camera.cx, camera.cy), depth_scale=1000.0, pose=flat(camera.pose),
            pose_source="file",
        )
        for number, camera in enumerate(cameras, start=1)
    )  # fmt: skip
    return Photos(surface, tuple(instances), blobs, frames, tuple(cameras), Scan("posed_rgbd", folder, "rgbd", "room"))
