"""Objects of a mesh that somebody drew: islands of triangles that hang together, and islands of one texture that touch.

Where triangles are as large as walls, nothing bends between a vertex and the next, but what was drawn as one thing is in one piece, or in
pieces that share a texture and touch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tasks.capture.instances.resolution import Evened
from tasks.capture.instances.structure import RoomPlane
from tasks.geometry.meshes import Surface
from tasks.geometry.triangles import distinct_rows, face_areas

Indices = NDArray[np.int64]

DRAWN_SHARE = 0.5
"""Of the surface that is not the room, in islands with floor or walls, from which on a mesh is a scan: below, somebody drew it."""

HOUSE_SHARE, HOUSE_ALONE = 0.1, 0.9
"""An island that has so much of all the room's planes is floor, or walls; where less of it than the latter is, it has furniture, too."""

ALONE_SHARE = 0.8
"""Of all surface in one island, where there is no room, from which on a mesh is a scan of things: who draws one makes it of parts."""

ROOM_SHARE = 0.5
"""Of an island in planes of the room, from which on it is a part of the room; with less of it, none of it is."""

TOUCHING_M = 0.03
"""Islands of one texture that are so near touch [m]: refined edges are 5 cm apart."""


def islands_of(even: Evened, world: Surface, planes: list[RoomPlane], materials: Indices | None) -> tuple[list[RoomPlane], Indices] | None:
    """The planes of the room as whole islands, and the region of each vertex of the refined mesh, -1 for the room's, shape (n,).

    materials: Texture of each face of the scan, shape (m,); one for all without. None where the mesh is no drawing: it is one island.
    """
    count = len(even.surface.vertices)
    texture = np.zeros(len(world.faces), dtype=np.int64) if materials is None else np.asarray(materials, dtype=np.int64)
    island_of_face = _components(even.place[world.faces], texture)
    island = np.full(count, -1, dtype=np.int64)
    island[even.surface.faces.ravel()] = np.repeat(island_of_face[even.parent], 3)
    areas = np.bincount(
        even.surface.faces.ravel(), weights=np.repeat(face_areas(even.surface.vertices, even.surface.faces) / 3, 3), minlength=count
    )
    kind = np.full(count, -1, dtype=np.int64)
    for number, plane in enumerate(planes):
        kind[plane.members] = number
    drawn = island >= 0
    total = np.bincount(island[drawn], weights=areas[drawn])
    room = np.bincount(island[drawn & (kind >= 0)], weights=areas[drawn & (kind >= 0)], minlength=len(total))
    is_room = room > ROOM_SHARE * total
    free = np.bincount(island[drawn & (kind < 0)], weights=areas[drawn & (kind < 0)], minlength=len(total))
    if room.sum() > 0:
        is_mixed = (room >= HOUSE_SHARE * float(room.sum())) & (room < HOUSE_ALONE * total)
        is_scan = float(free[is_mixed].sum()) >= DRAWN_SHARE * float(free.sum())
    else:
        is_scan = float(total.max()) >= ALONE_SHARE * float(total.sum())
    if is_scan:
        return None
    whole = [RoomPlane(plane.category, plane.members[is_room[island[plane.members]]]) for plane in planes]
    taken = np.zeros(count, dtype=bool)
    for plane in whole:
        taken[plane.members] = True
    # what of a wall's island lies in no plane, the rim of a window, is the wall's
    rest = np.flatnonzero(drawn & ~taken & is_room[island])
    for k in np.unique(island[rest]).tolist():
        most = int(np.argmax([(island[plane.members] == k).sum() for plane in whole]))
        whole[most] = RoomPlane(whole[most].category, np.union1d(whole[most].members, rest[island[rest] == k]))
    textures = np.zeros(len(total), dtype=np.int64)
    textures[island_of_face] = texture
    textures[is_room] = -1  # what stands on one floor does not touch by it
    region = np.where(drawn & ~is_room[island], _touching(even.surface.vertices, island, textures)[island], -1)
    _, dense = np.unique(region[region >= 0], return_inverse=True)
    region[region >= 0] = dense
    return [plane for plane in whole if len(plane.members)], region


def _components(faces: Indices, texture: Indices) -> Indices:
    """Island of each face, shape (m,): those that share corners and a texture are one."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    corner = faces + texture[:, None] * (int(faces.max(initial=0)) + 1)
    _, corner = np.unique(corner, return_inverse=True)
    corner = corner.reshape(-1, 3)
    i, j = np.concatenate([corner[:, :2], corner[:, 1:]]).T
    _, label = connected_components(coo_array((np.ones(len(i), dtype=np.int8), (i, j)), shape=(corner.max() + 1,) * 2), directed=False)
    return np.asarray(label[corner[:, 0]], dtype=np.int64)


def _touching(points: NDArray[np.float64], island: Indices, textures: Indices) -> Indices:
    """Islands by number as one where they share a texture and touch, shape (islands,). textures: Of each, -1 for what joins none."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    rows, columns = [np.arange(len(textures))], [np.arange(len(textures))]
    of_vertex = np.where(island >= 0, textures[island], -1)
    for texture in np.unique(textures[textures >= 0]).tolist():
        members = np.flatnonzero(of_vertex == texture)
        cells = np.column_stack([island[members], np.floor(points[members] / (TOUCHING_M / 2))]).astype(np.int64)
        members = members[distinct_rows(cells)[0]]  # one of many in a place is enough
        pairs = cKDTree(points[members]).query_pairs(TOUCHING_M, output_type="ndarray")
        a, b = island[members[pairs[:, 0]]], island[members[pairs[:, 1]]]
        rows.append(a[a != b])
        columns.append(b[a != b])
    row, column = np.concatenate(rows), np.concatenate(columns)
    graph = coo_array((np.ones(len(row), dtype=np.int8), (row, column)), shape=(len(textures),) * 2)
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.int64)
