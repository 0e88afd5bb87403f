"""What is placed in a room before anything is moved: surfaces, convex pieces, and what carries what."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from schemas.candidates import Asset
from schemas.capture import Shell
from schemas.errors import InputError
from tasks.geometry.meshes import asset_surface, load_glb
from tasks.geometry.pieces import PieceConfig, Uncut, asset_pieces, cut_ahead
from tasks.geometry.transforms import inverse, is_rigid
from tasks.optimization.colliders.bases import with_bases
from tasks.optimization.colliders.brackets import with_brackets
from tasks.optimization.proposals import Proposal
from tasks.optimization.solids import ConvexParts, shell_solids
from tasks.optimization.support.boards import board, board_bearers
from tasks.optimization.support.leaning import Lean
from tasks.optimization.support.supports import Carrier, PlacedAsset, SupportConfig, find_carriers, is_covering
from tasks.shell import floor_ring
from tasks.stage import Caches, Spread

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Interior:
    """n objects in a room, carriers before what they carry.

    poses: asset to world frame as proposed, shape (n, 4, 4) [m]. parent: index of the carrier or -1, shape (n,). covering: rugs and cloths,
    to be stood upon; fixed: fastened to the room; shape (n,) each. ring:
    corners of the floor [m], shape (m, 2); none when no room is known. shell: the walls as convex solids, and brackets at them. brackets:
    these alone, world frame, by names of `tasks.optimization.colliders.brackets`.
    """

    objects: tuple[PlacedAsset, ...]
    proposals: tuple[Proposal, ...]
    solids: tuple[ConvexParts, ...]
    poses: Array
    carriers: tuple[Carrier, ...]
    parent: NDArray[np.int64]
    covering: NDArray[np.bool_]
    fixed: NDArray[np.bool_]
    room: Shell | None
    ring: Array | None
    shell: tuple[ConvexParts, ...]
    brackets: tuple[ConvexParts, ...] = ()

    @property
    def names(self) -> list[str]:
        """Instance ids."""
        return [obj.instance_id for obj in self.objects]

    def volume(self, obj: int) -> float:
        """Of an object's box as proposed [m3]: what orders objects by size."""
        return float(np.prod(self.objects[obj].high - self.objects[obj].low))

    def groups(self) -> list[list[int]]:
        """Every object with all it carries, carriers first, as indices."""
        groups: list[list[int]] = [[i] for i in range(len(self.objects))]
        for i in reversed(range(len(self.objects))):
            if self.parent[i] >= 0:
                groups[self.parent[i]] += groups[i]
        return [sorted(group) for group in groups]


def furnish(
    proposals: Sequence[Proposal], assets: Mapping[str, Asset], blobs: Mapping[str, bytes], room: Shell | None,
    supports: SupportConfig, pieces: PieceConfig, caches: Caches, infers_boards: bool = False,
    leans: Mapping[str, Lean | None] | None = None,
) -> tuple[Interior, list[str]]:  # fmt: skip
    """The proposed assets in their room, and what had to be left out of it, a line each.

    infers_boards: what nothing carries within a piece of furniture gets a board there, in the collider of that; colliders of what stands
    reach down to what carries it; what nothing carries at a wall gets a bracket. leans: how objects of which the scan has points lean, by
    instance, None for upright ones.
    """
    notes: list[str] = []
    placed: list[tuple[PlacedAsset, Proposal, ConvexParts]] = []
    for proposal in proposals:
        name = proposal.instance.instance_id
        try:
            obj, _, solid = _placed(proposal, assets[proposal.asset_id], blobs, pieces, caches)
            if leans is not None and name in leans:
                obj = dataclasses.replace(obj, is_scanned=True, lean=leans[name])
            placed.append((obj, proposal, solid))
        except (InputError, KeyError, ValueError) as error:
            why = f"blob {error.args[0]} is missing" if isinstance(error, KeyError) else " ".join(str(error).split())
            notes.append(f"{name}: nothing stands for it: asset {proposal.asset_id[:12]} cannot be placed: {why}")
    ring: Array | None = None
    shell: tuple[ConvexParts, ...] = ()
    if room is None:
        notes.append("no room is known: nothing keeps the assets inside it")
    else:
        try:
            ring, shell = floor_ring(room), shell_solids(room)
        except InputError as error:
            notes.append(f"nothing keeps the assets inside the room: {error}")
            room = None
    carriers = find_carriers([obj for obj, _, _ in placed], room, supports)
    brackets: list[ConvexParts] = []
    if infers_boards:
        placed, carriers = _with_boards(placed, carriers)
        objects, solids = [obj for obj, _, _ in placed], [solid for _, _, solid in placed]
        poses = [proposal.pose for _, proposal, _ in placed]
        objects, solids, carriers = with_bases(objects, solids, poses, carriers, room, supports)
        solids, carriers, brackets = with_brackets(objects, solids, poses, carriers, room)
        placed = list(zip(objects, [proposal for _, proposal, _ in placed], solids, strict=True))
    order = _carriers_first([obj.instance_id for obj, _, _ in placed], carriers)
    kept = [placed[i] for i in order]
    index = {obj.instance_id: i for i, (obj, _, _) in enumerate(kept)}
    parents = [carriers[name].parent_id for name in index]
    interior = Interior(
        objects=tuple(obj for obj, _, _ in kept),
        proposals=tuple(proposal for _, proposal, _ in kept),
        solids=tuple(solid for _, _, solid in kept),
        poses=np.array([proposal.pose for _, proposal, _ in kept], dtype=np.float64).reshape(-1, 4, 4),
        carriers=tuple(carriers[name] for name in index),
        parent=np.array([-1 if p is None else index[p] for p in parents], dtype=np.int64),
        covering=np.array([is_covering(obj, supports) for obj, _, _ in kept], dtype=np.bool_),
        fixed=np.array([carriers[obj.instance_id].is_fixed for obj, _, _ in kept], dtype=np.bool_),
        room=room,
        ring=ring,
        shell=(*shell, *brackets),
        brackets=tuple(brackets),
    )
    return interior, notes


def cut_proposed(
    proposals: Sequence[Proposal], assets: Mapping[str, Asset], blobs: Mapping[str, bytes], pieces: PieceConfig, caches: Caches,
    spread: Spread,
) -> None:  # fmt: skip
    """Cut proposed assets into convex pieces, several at a time, before `furnish` needs these one after another."""
    wanted = {p.asset_id: assets[p.asset_id] for p in proposals if p.asset_id in assets}
    cut_ahead([_uncut(asset, blobs) for asset in wanted.values()], pieces, caches["tasks.geometry.pieces"], spread)


def _uncut(asset: Asset, blobs: Mapping[str, bytes]) -> Uncut:
    mesh, own = asset.mesh_blob, asset.pieces_blob
    return Uncut(asset.asset_id, lambda: (blobs[mesh], blobs[own] if own else None), own is not None, f"{asset.name}.glb")


def _placed(
    proposal: Proposal, asset: Asset, blobs: Mapping[str, bytes], config: PieceConfig, caches: Caches
) -> tuple[PlacedAsset, Proposal, ConvexParts]:
    """A proposal's surface in the world frame, and its convex pieces in its own, scaled.

    Raises:
        InputError: the pose is no rigid one, or the mesh cannot be read or has no size.
    """
    instance = proposal.instance
    if not is_rigid(proposal.pose) or not np.isfinite(proposal.scale).all() or (proposal.scale <= 0).any():
        raise InputError("selections", f"{instance.instance_id} pose, scale", "are no finite rigid pose and positive scale", "select again")
    file, pieces_blob = f"{asset.name}.glb", asset.pieces_blob
    surface = asset_surface(asset.mesh_blob, blobs, file, caches["tasks.geometry.meshes"]).transformed(proposal.pose, proposal.scale)
    known = (lambda: load_glb(blobs[pieces_blob], f"{asset.name} pieces.glb")) if pieces_blob else None
    made = asset_pieces(asset.asset_id, lambda: load_glb(blobs[asset.mesh_blob], file), known, config, caches["tasks.geometry.pieces"])
    hulls = tuple(hull.transformed(np.eye(4), proposal.scale) for hull in made.hulls)
    obj = PlacedAsset.of(instance.instance_id, instance.category, surface, asset.is_watertight)
    return obj, proposal, ConvexParts(instance.instance_id, hulls, made.properties.scaled(proposal.scale), made.shares)


def _with_boards(
    placed: Sequence[tuple[PlacedAsset, Proposal, ConvexParts]], carriers: Mapping[str, Carrier]
) -> tuple[list[tuple[PlacedAsset, Proposal, ConvexParts]], dict[str, Carrier]]:
    """Placed assets and what carries them, with boards that furniture must have."""
    made, known = list(placed), dict(carriers)
    index = {obj.instance_id: i for i, (obj, _, _) in enumerate(placed)}
    for name, bearer in board_bearers([obj for obj, _, _ in placed], carriers).items():
        obj, proposal, solid = made[index[bearer]]
        shelf = board(placed[index[name]][0], obj)
        if shelf is None:
            continue
        hulls = (*solid.hulls, shelf.transformed(inverse(proposal.pose)))
        made[index[bearer]] = obj, proposal, dataclasses.replace(solid, hulls=hulls, properties=None, shares=None)
        known[name] = Carrier("inside", bearer, 0.0, known[bearer].lift, known[name].against, is_inferred=True)
    return made, known


def _carriers_first(names: Sequence[str], carriers: Mapping[str, Carrier]) -> list[int]:
    """Indices of the objects, carriers before what they carry, by name among equals."""

    def depth(name: str) -> int:
        steps, above = 0, carriers[name].parent_id
        while above is not None:
            steps, above = steps + 1, carriers[above].parent_id
        return steps

    return sorted(range(len(names)), key=lambda i: (depth(names[i]), names[i]))
