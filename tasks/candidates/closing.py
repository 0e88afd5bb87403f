"""A closed solid from the open, one-sided surface that a scan has of an object.

A distance is put on a grid and its level taken, so the result is closed whatever the crop looks like:

* The scanned surface is thickened to a shell of about one cell, so that thin objects (legs, boards, seats seen from one
  side only) stay.
* Elsewhere rays decide: a point is inside when most of the directions from it meet the back of a face before they meet
  a front. Unseen sides (a back against the wall, a top above the camera) let some rays escape, which is why half of
  them suffice. No scan shows an underside: three fifths of the level and upward rays suffice too. An open compartment
  shows fronts, and a tenth of those empties it; under a table the level rays escape. This is a coarse sampling of the
  generalized winding number (Jacobson et al., "Robust inside-outside segmentation using generalized winding numbers",
  SIGGRAPH 2013).
* The lowest layer reaches straight down to the bottom of the box, so that the solid stands on a flat contact.
* Where smoothing would take scanned surface away (strips, rods, cloth and tatters of a cell or less), the shell stays as it is.
* Space that frames saw empty is carved: it is not inside, whatever rays tell, and bodies do not reach down through it.
* What the scan could not see of furniture is drawn out of what it saw (`tasks.candidates.completion`).
* What the shell added around the outside is taken away again: the solid is fitted to the bounds of the crop.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tasks.candidates.completion import NOTHING_UNSEEN, Unseen, completed
from tasks.candidates.nodes import NodeGrid, distances, enclosed
from tasks.geometry.isosurfaces import dense_surface
from tasks.geometry.meshes import Surface

Array = NDArray[np.float64]

GRID_CELLS = 36_000
"""Cells of the grid: 1.8 cm for a chair, 5 cm for a corner sofa; the scan's own voxels are 1.5 to 2 cm. A fifth of a second."""

MIN_STEP_M = 0.004
"""Cells smaller than 4 mm would resolve the noise of the sensor."""

SHELL_STEPS = 0.75
"""Half the thickness of the shell in cells: half a cell is the least that a grid can hold, the rest is for smoothing."""

FAR_STEPS = 1.6
"""Distances are cut off at so many cells: the level and its smoothing see no farther."""

SMOOTHING_CELLS = 0.7
"""Width of the Gaussian over the distances, in cells: takes away the steps of the grid and the scan's noise, not a leg."""

MIN_KEPT_SURFACE = 0.5
"""Least share of the nodes at the surface that a smoothed field has inside: sheets and bodies keep nine tenths, rods
thinner than a cell none."""

CROP_SMOOTHING_ROUNDS = 4
"""Rounds of averaging over neighbors before rays are cast: a face turned around by noise would vote for the wrong side."""

MAX_SMOOTHED_EDGE_STEPS = 6.0
"""Longest edge, in cells, along which vertices are averaged; the edges of a scan have a cell or two."""

MIN_THICKNESS_M = 0.005
"""No side of the solid is thinner."""

MIN_SIMPLIFIED_VOLUME = 0.5
"""Least share of its volume that a solid keeps when it is simplified: a thin one may fold and enclose less than nothing."""

MIN_BODY_SHARE = 0.03
"""Separate bodies whose diagonal is below this share of the whole are specks; seats, boards and rungs that a scan shows in parts are
0.05 to 0.15 of it, a chair's leg under an unseen seat is 0.4."""

SCAN_NOISE_M = 0.03
"""Scanned surface this near to the solid is the noise of a room scan."""

MIN_BODY_STEPS = 5.0
"""Bodies that are smaller in cells are noise, however small the object is."""

LOST_REACH_STEPS = 2
"""Steps around lost surface in which the shell is put back: as far as the smoothing reaches."""

MIN_LOST_NODES = 12
"""Fewer connected nodes of lost surface are single vertices that noise carried away."""

MIN_STRIP_SHARE = 0.15
"""Parts whose diagonal is below this share of the whole are beads of a strip that fell apart."""

COLOR_POINTS = 8_000
"""Points of the scan that colors are taken from: one per 2 cm on a wardrobe."""


@dataclasses.dataclass(frozen=True)
class SolidField:
    """Signed distance [m] at the nodes of a grid, negative inside, shape (nx, ny, nz) float32.

    Node (i, j, k) is at `origin` + `step` * (i, j, k) [m]. The outermost nodes are positive. low, high: corners of the box that the
    solid is fitted to [m], shape (3,).
    """

    values: NDArray[np.float32]
    origin: Array
    step: float
    low: Array
    high: Array


EmptySpace = Callable[[Array], NDArray[np.bool_]]
"""Tells which points, shape (n, 3) [m], lie in space that the scan saw empty, shape (n,)."""


def solid_field(crop: Surface, unseen: Unseen = NOTHING_UNSEEN, is_empty: EmptySpace | None = None) -> SolidField:
    """The field of a crop whose frame has +Z up and the bottom of the object's box at z = 0, completed by what is unseen of it.

    Space that the scan saw empty is carved first: neither rays nor bodies that reach down fill it, but legs and poles do, which scans lose.
    """
    from scipy.ndimage import binary_dilation, gaussian_filter, uniform_filter

    low, high = crop.bounds
    low[:2] -= [unseen.sides[0], unseen.sides[2]]
    high[:2] += [unseen.sides[1], unseen.sides[3]]
    low[2] = min(low[2], 0.0)
    extent = np.maximum(high - low, 0.01)
    step = float(max((np.prod(extent) / GRID_CELLS) ** (1 / 3), MIN_STEP_M))
    shape = np.ceil(extent / step).astype(int) + 5
    origin = low - 2 * step
    origin[2] = low[2] - 2.5 * step  # the floor lies halfway between two nodes
    grid = NodeGrid(origin, step, (int(shape[0]), int(shape[1]), int(shape[2])))
    vertices = _smoothed(crop, MAX_SMOOTHED_EDGE_STEPS * step)
    # Only near the surface does the amount matter; elsewhere the sign does.
    distance = distances(vertices, crop.faces, grid, FAR_STEPS * step)
    inside = enclosed(vertices, crop.faces, grid, distance > 0.5 * step).astype(np.float32)
    # Only nodes that something would fill are asked for: those that rays took for inside, and those below a body.
    asked = inside > 0
    if unseen.sides[4] > 0.0 and unseen.base == "body":
        asked |= (distance > 0.5 * step) & (grid.axes[2] < crop.bounds[0][2])
    empty = _empty_nodes(grid, asked, is_empty)
    inside[empty] = 0.0
    # A lone node that differs from most of its neighbors was decided by noise.
    solid = (uniform_filter(inside, 3) > 0.5) & ~empty
    field = gaussian_filter(np.where(solid, -distance, distance) - SHELL_STEPS * step, SMOOTHING_CELLS, mode="nearest")
    # Averages draw the edges of a narrow strip together and lift thin sheets off the grid: where scanned surface is lost,
    # the shell is that of the faces as they were scanned, and everywhere if most of it is.
    raw = distances(crop.vertices, crop.faces, grid, FAR_STEPS * step)
    noise = binary_dilation(field < 0, iterations=max(round(SCAN_NOISE_M / step), 1))
    is_lost = _large_parts((raw <= 0.5 * step) & ~noise)
    near = distance <= 0.5 * step
    is_broken = (field[near] < 0).sum() <= MIN_KEPT_SURFACE * near.sum() or _is_broken(field < 0)
    if float(np.ptp(crop.bounds, axis=0).max()) > step:
        where = np.ones_like(is_lost) if is_broken else binary_dilation(is_lost, iterations=LOST_REACH_STEPS)
        field = np.where(where, np.minimum(field, (raw - SHELL_STEPS * step).astype(np.float32)), field)
    field = completed(field, grid.axes, low, high, unseen, empty)
    middle, half = (low + high) / 2, np.maximum((high - low) / 2, 0.5 * MIN_THICKNESS_M)
    return SolidField(_grounded(field, grid.axes[2], low[2], step), origin, step, middle - half, middle + half)


def _large_parts(nodes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Nodes of a grid in connected parts of at least `MIN_LOST_NODES`; of the same shape."""
    from scipy.ndimage import label

    parts, _ = label(nodes, np.ones((3, 3, 3)))
    is_large = np.bincount(parts.ravel()) >= MIN_LOST_NODES
    is_large[0] = False
    return np.asarray(is_large[parts])


def _empty_nodes(grid: NodeGrid, asked: NDArray[np.bool_], is_empty: EmptySpace | None) -> NDArray[np.bool_]:
    """Nodes of a grid that were seen empty, of those that are asked for; both of the grid's shape."""
    empty = np.zeros(grid.shape, dtype=np.bool_)
    if is_empty is not None:
        nodes = np.argwhere(asked)
        empty[tuple(nodes.T)] = is_empty(grid.origin + grid.step * nodes)
    return empty


def _is_broken(inside: NDArray[np.bool_]) -> bool:
    """True if all connected parts of the nodes inside, shape (nx, ny, nz), are specks: a slanted strip falls apart into beads."""
    from scipy.ndimage import find_objects, label

    lengths = [np.linalg.norm([side.stop - side.start for side in part]) for part in find_objects(label(inside)[0])]
    whole = np.ptp(np.argwhere(inside), axis=0) + 1 if lengths else np.zeros(3)
    return bool(max(lengths, default=0.0) < MIN_STRIP_SHARE * np.linalg.norm(whole))


def _smoothed(crop: Surface, max_edge_m: float) -> Array:
    """Vertices of a crop averaged with their neighbors, shape (n, 3) [m]."""
    from scipy.sparse import coo_matrix, diags_array

    i, j = np.concatenate([crop.faces[:, [0, 1]], crop.faces[:, [1, 2]], crop.faces[:, [2, 0]]]).T
    # Vertices of large faces are corners of a model, not noise: their average would shrink a box to a point.
    is_short = np.linalg.norm(crop.vertices[i] - crop.vertices[j], axis=1) <= max_edge_m
    i, j = i[is_short], j[is_short]
    n = len(crop.vertices)
    links = coo_matrix((np.ones(2 * len(i)), (np.concatenate([i, j]), np.concatenate([j, i]))), shape=(n, n)).tocsr()
    links.data[:] = 1.0
    degree = np.asarray(links.sum(axis=1)).ravel()
    average = diags_array(1 / (1 + degree)) @ links
    vertices = crop.vertices
    for _ in range(CROP_SMOOTHING_ROUNDS):
        vertices = average @ vertices + vertices / (1 + degree)[:, None]
    return np.asarray(vertices)


def _grounded(field: NDArray[np.float32], heights: Array, bottom: float, step: float) -> NDArray[np.float32]:
    """The field cut flat at `bottom` [m], with what nearly reaches it drawn down to it; its border made positive."""
    reach = int(np.searchsorted(heights, bottom + 1.5 * step))
    grounded = field.copy()
    lowest = field[:, :, reach : reach + 2].min(axis=2)
    for level in range(reach):
        grounded[:, :, level] = np.minimum(grounded[:, :, level], lowest)
    grounded = np.maximum(grounded, (bottom - heights).astype(np.float32))
    for axis in range(3):
        for end in (0, -1):
            side = np.moveaxis(grounded, axis, 0)
            side[end] = np.maximum(side[end], 0.25 * step)
    return grounded


def closed_mesh(field: SolidField, tolerance: float | None = None) -> tuple[Array, NDArray[np.int64]]:
    """The zero level of a field as a closed manifold: vertices (n, 3) [m] and faces (m, 3), outward.

    tolerance: Deviation that the simplification may add [m]; a quarter of a cell when None. Bodies that are specks
    beside the largest are left out.

    Raises:
        ValueError: nothing is inside, or the level is no manifold.
    """
    import manifold3d

    if not (field.values < 0).any():
        raise ValueError("the crop encloses nothing")
    nodes, faces = dense_surface(field.values)
    solid = _manifold(field.origin + field.step * nodes, faces)
    whole = _diagonal(solid)
    least = max(MIN_BODY_SHARE * whole, MIN_BODY_STEPS * field.step)
    bodies = [body for body in solid.decompose() if body.volume() > 0]
    kept = [body for body in bodies if _diagonal(body) >= least] or bodies
    if not kept:
        raise ValueError("the crop encloses nothing")
    solid = manifold3d.Manifold.compose(kept)
    simplified = solid.simplify(0.25 * field.step if tolerance is None else tolerance)
    is_sound = simplified.volume() >= MIN_SIMPLIFIED_VOLUME * solid.volume()
    return manifold_arrays(simplified if is_sound else solid)


def fitted(vertices: Array, low: Array, high: Array) -> Array:
    """Vertices (n, 3) stretched along each axis so that their bounds are `low` and `high` [m], shape (3,)."""
    least, span = vertices.min(axis=0), np.ptp(vertices, axis=0)
    return low + (vertices - least) * (high - low) / np.maximum(span, 1e-9)


def _manifold(vertices: Array, faces: NDArray[np.int64]):  # type: ignore[no-untyped-def]
    """A manifold3d solid of triangles that face outward."""
    import manifold3d

    solid = manifold3d.Manifold(manifold3d.Mesh64(vert_properties=np.ascontiguousarray(vertices), tri_verts=faces.astype(np.uint64)))
    if solid.status() != manifold3d.Error.NoError:
        raise ValueError(f"the level is no manifold ({solid.status().name})")
    return solid


def _diagonal(solid) -> float:  # type: ignore[no-untyped-def]
    """Diagonal of the box of a manifold3d solid [m]."""
    box = np.asarray(solid.bounding_box())
    return float(np.linalg.norm(box[3:] - box[:3]))


def manifold_arrays(solid) -> tuple[Array, NDArray[np.int64]]:  # type: ignore[no-untyped-def]
    """Vertices (n, 3) [m] and faces (m, 3) of a manifold3d solid."""
    mesh = solid.to_mesh64()
    return np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3], np.asarray(mesh.tri_verts, dtype=np.int64)


def nearest_colors(vertices: Array, points: Array, colors: NDArray[np.uint8], neighbors: int = 6) -> NDArray[np.uint8]:
    """Color of vertices, shape (n, 3), from scan points: mean over the nearest few, which evens out the sensor's noise."""
    from scipy.spatial import cKDTree

    stride = len(points) // COLOR_POINTS + 1
    points, colors = points[::stride], colors[::stride]
    count = min(neighbors, len(points))
    _, near = cKDTree(points).query(vertices, k=count)
    near = near.reshape(len(vertices), count)
    return np.asarray(np.round(colors[near].astype(np.float64).mean(axis=1)), dtype=np.uint8)
