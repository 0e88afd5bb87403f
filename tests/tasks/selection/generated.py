"""A room of the furniture generator, scanned, with the candidates that the stage before selection gives it: rows and blobs."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance
from schemas.selection import Selection
from tasks import candidates, captions
from tasks.furniture.rooms import furnish
from tasks.geometry.meshes import dump_points, sample_surface, surface_of
from tasks.geometry.transforms import flat, transform_points, translation
from tasks.selection import SelectionConfig, run
from tasks.selection.methods.geometric import Geometric
from tasks.stage import Blobs, Context, Outcome

GEOMETRIC = SelectionConfig(provider=Geometric())
SCENE = "test/generated"
POINTS = 1500
NOISE_M = 0.006


@dataclasses.dataclass(frozen=True)
class GeneratedRoom:
    """Rows up to selection, and their blobs."""

    instances: tuple[Instance, ...]
    captions: tuple[Caption, ...]
    candidates: tuple[Candidate, ...]
    assets: tuple[Asset, ...]
    blobs: Blobs

    def context(self, seed: int = 0) -> Context:
        return Context(SCENE, "selection", seed, self.blobs)

    def select(self, config: SelectionConfig | None = None, **more: Any) -> Outcome:
        return run(
            instances=self.instances, candidates=self.candidates, assets=self.assets, context=self.context(),
            config=config or GEOMETRIC, **more,
        )  # fmt: skip

    def selections(self, config: SelectionConfig | None = None, **more: Any) -> list[Selection]:
        return self.select(config, **more).rows["selections"]


@cache
def generated_room(kind: str = "living room", count: int = 6, seed: int = 5) -> GeneratedRoom:
    """Some objects of a room of a kind, each seen from above and one side, with ten candidates."""
    rng = np.random.default_rng(seed)
    blobs = Blobs()
    instances = []
    for number, item in enumerate(furnish(kind, rng, count).objects[:count]):
        points, colors, normals = sample_surface(surface_of(item.parts), POINTS, rng)
        points = transform_points(points, item.pose) + rng.normal(0, NOISE_M, points.shape)
        turned = normals @ item.pose[:3, :3].T
        seen = (turned @ np.array([0.8, 0.4, 0.5]) > -0.2) & (turned[:, 2] > -0.5)
        instances.append(
            Instance(
                scene_id=SCENE, instance_id=f"{number:04d}", source_id=item.name, raw_label=item.category,
                category=item.category, nyu40_id=0,
                nyu40_label="unlabeled", is_structure=False, found_by=None, category_probability=None, room_index=None,
                box_pose=flat(item.pose @ translation([0.0, 0.0, 0.5 * item.extents[2]])), box_size=tuple(map(float, item.extents)),
                box_volume_m3=float(np.prod(item.extents)), hidden_m=None, point_count=int(seen.sum()),
                points_blob=blobs.add(dump_points(points[seen], colors[seen]), "ply"), mesh_blob=None, view_blob=None, best_frames=(),
            )
        )  # fmt: skip
    words = captions.run(
        instances=instances, frames=[], masks=[], context=Context(SCENE, "captions", 0, blobs), config=captions.CaptionsConfig()
    )
    offered = candidates.run(
        instances=instances, frames=[], masks=[], captions=words.rows["captions"], library=None, scan=None,
        context=Context(SCENE, "candidates", 0, blobs),
        config=candidates.CandidatesConfig(),
    )  # fmt: skip
    blobs.update(offered.blobs)
    rows = offered.rows
    return GeneratedRoom(tuple(instances), tuple(words.rows["captions"]), tuple(rows["candidates"]), tuple(rows["assets"]), blobs)
