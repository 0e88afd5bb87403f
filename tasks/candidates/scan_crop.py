"""Candidates made of the scan itself: an instance's faces, cropped, turned into the box's frame and closed."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from schemas.capture import Instance
from tasks.candidates.assets import MadeAsset, make_asset
from tasks.candidates.closing import SolidField, closed_mesh, fitted, manifold_arrays, nearest_colors
from tasks.candidates.pieces import convex_pieces
from tasks.candidates.provider import CandidateProvider, NothingToOffer
from tasks.geometry.boxes import grown_box
from tasks.geometry.meshes import Surface, surface_of_glb
from tasks.geometry.transforms import inverse, translation
from tasks.geometry.triangles import surface_area
from tasks.mounting import mounting
from tasks.settings import Config

if TYPE_CHECKING:
    import trimesh

    from tasks.candidates.request import CandidateRequest
    from tasks.stage import Context

Array = NDArray[np.float64]

MIN_CROP_FACES = 12
"""Fewer faces than a box has enclose nothing."""

MAX_CROP_FACES = 60_000
"""A scan at 2 cm has 10,000 faces on a wardrobe; denser ones (laser, modeled scenes) are thinned, the grid sees no difference."""

SPILL = 0.15
"""Share of the box's size by which a crop may stick out of it; what lies farther is a stray piece of a neighbor."""

BOX_FACES, CORNER_M = 12, 1e-3
"""A drawn box has two triangles on each side, and no vertex but its corners [m]."""

EDGE_SHARE, MIN_EDGE_M = 0.06, 0.02
"""Longest edge of the colored surface over convex pieces, as a share of its diagonal, and its floor: finer than the
patches of color on furniture, a few thousand vertices at most."""


@dataclasses.dataclass(frozen=True)
class ScanCrop(Config):
    """Geometry of the scan itself, cropped and closed."""

    kind: ClassVar[str] = "scan_crop"
    mode: Literal["closed", "pieces"] = "closed"  # the scanned surface closed to a solid, or a few convex pieces that stand for it
    version: str = "5"  # goes up when the same scan would give another solid


def crop_of(instance: Instance, context: Context) -> Surface:
    """The instance's faces in the frame of its box with what the scan could not see, bottom at z = 0.

    Raises:
        ValueError: the scan has no mesh of the instance, or too few faces.
        InputError: its blob is no GLB.
    """
    if instance.mesh_blob is None:
        raise ValueError("the scan has no faces of the instance")
    if instance.mesh_blob not in context.blobs:
        raise ValueError("the faces of the instance are not among the blobs")
    world = surface_of_glb(context.blobs[instance.mesh_blob], instance.mesh_blob)
    pose, size = grown_box(instance.box_pose, instance.box_size, instance.hidden_m)
    to_box = translation((0, 0, size[2] / 2)) @ inverse(pose)
    local = world.transformed(to_box)
    reach = np.maximum(SPILL * size, 0.03)
    low, high = np.array([-size[0] / 2, -size[1] / 2, 0.0]) - reach, np.array([size[0] / 2, size[1] / 2, size[2]]) + reach
    inside = np.all((local.vertices >= low) & (local.vertices <= high), axis=1)
    faces = local.faces[inside[local.faces].all(axis=1)]
    if len(faces) < MIN_CROP_FACES:
        raise ValueError(f"{len(faces)} faces in the scan are too few to close")
    used = np.zeros(len(inside), dtype=bool)
    used[faces] = True
    cut = Surface(local.vertices[used], (np.cumsum(used) - 1)[faces], local.colors[used])
    return cut if len(cut.faces) <= MAX_CROP_FACES else _thinned(cut)


def _thinned(crop: Surface) -> Surface:
    """A dense crop with the vertices of each small cube of space drawn together; faces that vanish so are left out.

    The cubes have an edge that leaves about `MAX_CROP_FACES` faces of a surface that fills the crop's area evenly.
    """
    area = surface_area(crop.vertices, crop.faces)
    cube = np.floor((crop.vertices - crop.bounds[0]) / np.sqrt(2 * area / MAX_CROP_FACES)).astype(np.int64)
    shape = cube.max(axis=0) + 1
    _, group = np.unique(np.ravel_multi_index(tuple(cube.T), tuple(shape)), return_inverse=True)
    count = np.bincount(group)
    vertices = np.column_stack([np.bincount(group, crop.vertices[:, i]) / count for i in range(3)])
    colors = np.column_stack([np.bincount(group, crop.colors[:, i]) / count for i in range(3)])
    faces = group[crop.faces]
    whole = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    return Surface(vertices, faces[whole].astype(np.int64), np.round(colors).astype(np.uint8))


def closed_crop(crop: Surface, field: SolidField) -> trimesh.Trimesh:
    """The crop closed, colored by the scan; frame and bounds of the field.

    Raises:
        ValueError: it encloses nothing.
    """
    vertices, faces = closed_mesh(field)
    vertices = fitted(vertices, field.low, field.high)
    return Surface(vertices, faces, nearest_colors(vertices, crop.vertices, crop.colors)).to_trimesh()


def pieces_of_crop(crop: Surface, field: SolidField) -> tuple[trimesh.Trimesh, list[trimesh.Trimesh]]:
    """Convex pieces that stand for the crop, and the surface of their union, colored by the scan; bounds of the field.

    Raises:
        ValueError: it encloses nothing.
    """
    import manifold3d
    import trimesh

    groups = convex_pieces(field)
    everything = np.concatenate(groups)
    moved = fitted(everything, field.low, field.high)
    groups = np.split(moved, np.cumsum([len(group) for group in groups])[:-1])
    hulls = [manifold3d.Manifold.hull_points(np.ascontiguousarray(group)) for group in groups]
    hulls = [hull for hull in hulls if hull.volume() > 0]
    if not hulls:
        raise ValueError("the crop encloses nothing")
    union = manifold3d.Manifold.batch_boolean(hulls, manifold3d.OpType.Add)
    edge = max(EDGE_SHARE * float(np.linalg.norm(np.ptp(moved, axis=0))), MIN_EDGE_M)
    vertices, faces = manifold_arrays(union.refine_to_length(edge))
    surface = Surface(vertices, faces, nearest_colors(vertices, crop.vertices, crop.colors, neighbors=12)).to_trimesh()
    pieces = [trimesh.Trimesh(*manifold_arrays(hull), process=False) for hull in hulls]
    return surface, pieces


def is_stand_in(crop: Surface, category: str) -> bool:
    """True if a crop is a plain box of furniture that does not fill its box: a table would be a solid block.

    Args:
        crop: faces in the frame of the instance's box [m].
        category: of the instance.
    """
    kind = mounting(category)
    if kind.base is None or kind.is_boxy or len(crop.faces) != BOX_FACES:
        return False
    low, high = crop.bounds
    to_side = np.minimum(np.abs(crop.vertices - low), np.abs(crop.vertices - high))
    return bool((to_side <= CORNER_M).all()) and bool((high - low > CORNER_M).all())


def _label(provider: ScanCrop) -> str:
    return f"{ScanCrop.kind}_{provider.mode}"


def crop_asset(request: CandidateRequest, provider: ScanCrop) -> MadeAsset:
    """The asset made of the instance's own faces."""
    if request.instance.mesh_blob is None:
        raise NothingToOffer("the scan has no faces of the instance")
    if is_stand_in(request.crop, request.category):
        raise NothingToOffer(f"the scan has the box of the {request.category} alone, which is no shape of it")
    surface, pieces = request.pieces  # the closed crop collides as its pieces do: they are known, and cheap
    closed = closed_crop(request.crop, request.field) if provider.mode == "closed" else None
    made = make_asset(
        [surface if closed is None else closed],
        provider=_label(provider),
        name=f"{request.context.scene_id} {request.instance.instance_id} {provider.mode}",
        category=request.category,
        source=f"scan {request.context.scene_id}",
        license="LicenseRef-scan",
        pieces=pieces,
    )
    if closed is None or not made.asset.is_watertight:
        return made
    return dataclasses.replace(made, asset=dataclasses.replace(made.asset, volume_m3=float(closed.volume)))


SCAN_CROP = CandidateProvider(name="scan_crop", config=ScanCrop, offer=crop_asset, label=_label)
