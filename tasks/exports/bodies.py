"""What all exports are made of: shapes scaled to size, and the bodies that have them."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from schemas.captions import Caption
from schemas.capture import Instance, RoomSurface, Scene, Shell
from schemas.errors import InputError
from schemas.lineage.licenses import of_asset, stated
from schemas.optimization import Placement, Support
from tasks.exports.config import ExportsConfig
from tasks.geometry.mass import MassProperties, mass_properties
from tasks.geometry.meshes import load_glb
from tasks.geometry.pieces import Hull, Method, asset_pieces, read_pieces
from tasks.geometry.transforms import is_rigid, matrix
from tasks.shell import room_shell
from tasks.surfaces import textured
from tasks.words import latin

if TYPE_CHECKING:
    import trimesh

T = TypeVar("T")


@dataclasses.dataclass(frozen=True)
class Shape:
    """An asset at one scale, with the colliders that stand for it, in its own frame [m]: +Z up, origin at the bottom center.

    `glb` is unscaled, `parts` and `hulls` are scaled. `properties` are those of the hulls' union. `known` has what was made of the shape
    by `once`.
    """

    name: str
    asset: Asset
    scale: tuple[float, ...]
    glb: bytes
    parts: list[trimesh.Trimesh]
    hulls: tuple[Hull, ...]
    method: Method
    properties: MassProperties
    known: dict[str, Any] = dataclasses.field(default_factory=dict, init=False, compare=False, repr=False)  # of no shape but this one

    def once(self, what: str, make: Callable[[], T]) -> T:
        """What several formats make of a shape alike, made for the first of them. The others must leave it as it is."""
        if what not in self.known:
            self.known[what] = make()
        made: T = self.known[what]
        return made

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Lowest and highest corner of what is seen [m], shape (2, 3)."""
        boxes = np.array([part.bounds for part in self.parts])
        return np.array([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


@dataclasses.dataclass(frozen=True)
class Body:
    """An object of the replica. `pose`: shape's frame to world, rigid 4x4 [m]. `is_fixed`: fastened to the room.

    `body_type` (`rigid`, `cloth` or `soft`) and `materials`, most likely first, are its caption's.
    """

    instance_id: str
    name: str
    category: str
    nyu40_id: int
    nyu40_label: str
    shape: Shape
    pose: NDArray[np.float64]
    mass_kg: float
    friction: float
    restitution: float
    is_fixed: bool
    provenance: Mapping[str, str]

    @property
    def inertia(self) -> NDArray[np.float64]:
        """Inertia about the center of mass, along the axes of the shape's frame [kg m2], shape (3, 3)."""
        return self.shape.properties.inertia * (self.mass_kg / self.shape.properties.volume)

    body_type: str = "rigid"
    materials: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Replica:
    """A scene ready to be written: its room and its bodies, sorted by instance.

    room: The row of `shells`: what encloses the scene's rooms together.
    shell: The parts of that by name, world frame [m]: `tasks.shell.room_shell`, with the images that the scan gave them.
    brackets: Convex boards at walls by name, world frame [m]. They carry what nothing seen does. They collide and are never seen.
    """

    scene_id: str
    stem: str
    room: Shell
    bodies: tuple[Body, ...]
    license: str
    shell: tuple[tuple[str, trimesh.Trimesh], ...]
    brackets: tuple[tuple[str, trimesh.Trimesh], ...] = ()


def stem(scene_id: str) -> str:
    """File name of a scene: `<dataset>_<scan>`, a different one for every scene.

    Where the dataset's name has an underscore or a name has a dot, a short hash keeps it so.
    """
    dataset, scan = scene_id.split("/", 1)
    plain = f"{dataset}_{scan}".replace(".", "-")
    return plain if not re.search(r"[._]", dataset) and "." not in scan else f"{plain}_{digest(scene_id)}"


def digest(text: str, length: int = 6) -> str:
    """Short hash of a text."""
    return hashlib.sha256(text.encode()).hexdigest()[:length]


def identifier(text: str) -> str:
    """A text as a name that USD and file systems accept: letters, digits, underscores; begins with a letter."""
    name = re.sub(r"[^A-Za-z0-9]+", "_", latin(text)).strip("_") or "thing"
    return name if name[0].isalpha() else f"n_{name}"


def gather(
    scenes: Sequence[Scene], shells: Sequence[Shell], instances: Sequence[Instance], captions: Sequence[Caption], assets: Sequence[Asset],
    placements: Sequence[Placement], supports: Sequence[Support], blobs: Mapping[str, bytes], config: ExportsConfig,
    cache: MutableMapping[str, bytes] | None = None, surfaces: Sequence[RoomSurface] = (),
) -> tuple[Replica, list[str]]:  # fmt: skip
    """The replica of one scene, and what had to be left out of it. `cache` remembers convex pieces between runs.

    What of the room has no row in `surfaces` has one color.

    Assets have the license that holds for them: what was cut from the scene's own scan has that of the scan.

    Raises:
        InputError: the scene has no room, or its room no floor.
    """
    if len(shells) != 1:
        raise InputError("shells", "scene_id", f"{len(shells)} rows for one scene", "run capture on the scene again")
    room = shells[0]
    scans = {scene.scene_id: scene.license for scene in scenes}
    by_asset = {asset.asset_id: licensed(asset, scans) for asset in assets}
    by_instance = {instance.instance_id: instance for instance in instances}
    by_caption = {caption.instance_id: caption for caption in captions}
    carried = {support.instance_id: support for support in supports}
    shapes: dict[tuple[str, tuple[float, ...], str | None], Shape] = {}
    bodies, missed = [], []
    for placement in sorted(placements, key=lambda row: row.instance_id):
        key = (placement.asset_id, placement.scale, placement.collider_blob)
        try:
            if key not in shapes:
                shapes[key] = _shape(placement, by_asset, blobs, config, cache)
            if not is_rigid(matrix(placement.optimized_pose)):
                raise InputError("placements", f"{placement.instance_id} optimized_pose", "is no rigid pose")
        except InputError as error:
            missed.append(f"{placement.instance_id}: left out: {error}")
            continue
        caption = by_caption.get(placement.instance_id)
        if caption is None:
            missed.append(f"{placement.instance_id}: no caption; mass from a density of {config.default_density_kg_m3:g} kg/m3")
        support = carried.get(placement.instance_id)
        bodies.append(_body(placement, shapes[key], by_instance.get(placement.instance_id), caption, support, config))
    shell, brackets = tuple(textured(room_shell(room, config.shell), surfaces, blobs)), tuple(_brackets(supports, blobs))
    return Replica(room.scene_id, stem(room.scene_id), room, tuple(bodies), stated(scans.get(room.scene_id)), shell, brackets), missed


def _brackets(supports: Sequence[Support], blobs: Mapping[str, bytes]) -> list[tuple[str, trimesh.Trimesh]]:
    """Boards at walls that the scan does not show, by name, world frame [m]."""
    import trimesh

    parts = []
    for row in sorted(supports, key=lambda row: row.instance_id):
        if row.bracket_blob is not None:
            for number, hull in enumerate(read_pieces(blobs[row.bracket_blob], row.bracket_blob)):
                name = f"bracket_{row.instance_id}" + (f"_{number}" if number else "")
                parts.append((name, trimesh.Trimesh(hull.vertices, hull.faces, process=False)))
    return parts


def licensed(asset: Asset, scans: Mapping[str, str | None]) -> Asset:
    """An asset with the license that holds for it. `scans`: license by scene."""
    return dataclasses.replace(asset, license=of_asset(asset.license, asset.source, scans))


def _shape(
    placement: Placement,
    assets: Mapping[str, Asset],
    blobs: Mapping[str, bytes],
    config: ExportsConfig,
    cache: MutableMapping[str, bytes] | None,
) -> Shape:
    """The shape of a placement's asset at its scale."""
    asset = assets.get(placement.asset_id)
    if asset is None:
        raise InputError("assets", f"asset_id {placement.asset_id}", "is not among the scene's assets", "run candidates again")
    glb = blobs[asset.mesh_blob]
    parts = load_glb(glb, f"{asset.name}.glb")
    content = ",".join([asset.asset_id, *(f"{value:.9g}" for value in placement.scale)]).replace(",", " ", 1)
    method: Method
    if placement.collider_blob is None:
        pieces_blob, name = asset.pieces_blob, asset.name
        known = (lambda: load_glb(blobs[pieces_blob], f"{name} pieces.glb")) if pieces_blob else None
        made = asset_pieces(asset.asset_id, lambda: parts, known, config.pieces, cache)
        hulls = tuple(hull.transformed(np.eye(4), placement.scale) for hull in made.hulls)
        method, properties = made.method, made.properties.scaled(placement.scale)
    else:
        hulls = read_pieces(blobs[placement.collider_blob], placement.collider_blob)
        method, properties, content = "cut", mass_properties(hulls), f"{content} {placement.collider_blob}"
    for part in parts:  # last: pieces are made of what is unscaled
        part.apply_transform(np.diag([*placement.scale, 1.0]))
    return Shape(f"{identifier(asset.category)}_{digest(content, 8)}", asset, placement.scale, glb, parts, hulls, method, properties)


def _body(
    placement: Placement, shape: Shape, instance: Instance | None, caption: Caption | None, support: Support | None,
    config: ExportsConfig,
) -> Body:  # fmt: skip
    """The body of one placement."""
    category = instance.category if instance is not None else shape.asset.category
    provenance = {
        "scene_id": placement.scene_id, "instance_id": placement.instance_id, "asset_id": placement.asset_id,
        "provider": shape.asset.provider, "source": shape.asset.source, "license": shape.asset.license,
        "author": shape.asset.author or "unknown", "origin": placement.origin, "colliders": shape.method,
        "body_type": caption.body_type if caption is not None else "rigid",
    }  # fmt: skip
    if support is not None and support.is_inferred:  # its collider may reach below what is seen, down to what carries it
        provenance["support"] = "inferred"
    return Body(
        instance_id=placement.instance_id,
        name=f"{identifier(category)}_{placement.instance_id}",
        category=category,
        nyu40_id=instance.nyu40_id if instance is not None else 0,
        nyu40_label=instance.nyu40_label if instance is not None else "unlabeled",
        shape=shape,
        pose=matrix(placement.optimized_pose),
        mass_kg=caption.mass_kg if caption is not None else max(config.default_density_kg_m3 * shape.properties.volume, 0.001),
        friction=caption.friction if caption is not None else config.default_friction,
        restitution=caption.restitution if caption is not None else config.default_restitution,
        is_fixed=support is not None and support.is_fixed,
        provenance=provenance,
        body_type=provenance["body_type"],
        materials=caption.materials if caption is not None else (),
    )
