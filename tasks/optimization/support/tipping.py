"""Objects that cannot stand as they are put: they tip over the edge of what they stand on until they rest.

Statics only: an object rests when the center of its mass lies over the convex hull of its contacts. Else it is turned
about the hull's nearest edge until it touches something new, and looked at again.
"""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tasks.geometry.transforms import rotation_of
from tasks.kernels import Kernels, compile_kernels
from tasks.optimization import shapes as geometry
from tasks.optimization.shapes import Shapes, Stand, body_gap, pair_depth, piece_gap, span

Array = NDArray[np.float64]
Booleans = NDArray[np.bool_]

CONTACT_M = 0.0003
"""Points this near to what is below them carry [m]: a sheet of paper does not rock a table."""

TOUCH_M = 0.00003
"""A turned body touches what is below it when it is this deep in it [m]: a tenth of what still counts as a contact."""

BALANCE_M = 0.0005
"""The center of mass may lie this far beyond the hull of the contacts [m]: rounding."""

SPOT_M2 = 1e-6
"""Contacts whose hull is smaller than a square millimetre are a point or a line: nothing balances on that."""

MOST_POINTS = 2048
"""Contacts that are looked at: more say nothing new about their hull."""

ASIDE_M = (0.001, 0.002, 0.004)
"""How far an object that leans on something slides for room to tip [m]."""

MOST_ASIDE_M = 0.012
"""Farther it does not slide [m]: friction holds it."""

SUNK_M = 0.004
"""Objects overlap what carries them by less [m]; what they overlap deeper stands beside them."""

MOST_DROP_M = 0.05
"""An object that would fall farther while it tips has left what carried it [m]."""

LEAST_GAIN = 0.002
"""A turn smaller than this is none [rad]: a tenth of a degree."""

FIRST_TURN, LEAST_TURN = 0.004, 0.00002
"""The first turn that is tried, and how exactly the touching one is found [rad]."""


@dataclasses.dataclass(frozen=True)
class Tip:
    """How an object was tipped: rotation about its origin, shape (3, 3), and shift of the origin [m], shape (3,)."""

    rotation: Array
    shift: Array


def tip(shapes: Shapes, stand: Stand, body: int, center: Array, among: Booleans, most: float) -> Tip | None:
    """Tip a body until it rests on the bodies marked in `among`, shape (n,), or on the floor. Changes `shapes` and `stand`.

    center: its center of mass from its pivot, in the frame of its vertices [m], shape (3,). most: farthest tilt [rad];
    an object that would tip farther stays as it is, and None is returned.
    """
    rotation, start = np.eye(3), stand.place[body].copy()
    vertices, normals = kept_shape(shapes, body)
    points = np.empty((MOST_POINTS, 3))
    for _ in range(40):
        gap, _ = compiled()["least_gap"](shapes, stand, body, among, SUNK_M)
        gap = min(gap, float(stand.low[body, 2]))
        if gap > MOST_DROP_M:
            break
        move_by(stand, shapes, body, np.array([0.0, 0.0, -gap]))
        count = compiled()["contact_points"](shapes, stand, body, among, CONTACT_M, points)
        c, s = stand.turn[body]
        balance = np.array([c * center[0] - s * center[1], s * center[0] + c * center[1], center[2]])
        lean = lean_of(points[:count], rotation @ balance + stand.place[body])
        if lean is None:
            return Tip(rotation, stand.place[body] - start)
        pivot, axis = lean
        angle = free_turn(shapes, stand, body, among, pivot, axis, most)
        if angle < LEAST_GAIN:
            aside = _aside(shapes, stand, body, among, pivot, axis, most)
            if aside is not None and np.hypot(*(stand.place[body] + aside - start)[:2]) <= MOST_ASIDE_M:
                move_by(stand, shapes, body, aside)
                continue
            if angle < 2.0 * LEAST_TURN:
                return Tip(rotation, stand.place[body] - start)  # wedged: what it leans on holds it
        turned = rotation_of(angle * axis)
        rotation = turned @ rotation
        turn_about(shapes, stand, body, turned, pivot)
        if rotation[2, 2] < np.cos(most):
            break
    else:
        return Tip(rotation, stand.place[body] - start)  # it rocks on, by less and less
    # fell over, or off: back to where it was
    put_back(shapes, stand, body, vertices, normals, start)
    return None


def turn_along(shapes: Shapes, stand: Stand, body: int, made: Tip, origin: Array) -> None:
    """Turn and shift a body that is carried by a tipped one, whose origin was at `origin` [m], shape (3,)."""
    turn_about(shapes, stand, body, made.rotation, origin)
    stand.place[body] += made.shift
    compiled()["bound"](shapes, stand, body)


def lean_of(points: Array, center: Array) -> tuple[Array, Array] | None:
    """Where and about which axis an object tips that touches at points, shape (n, 3), with its mass over `center` [m].

    A point on the axis and its unit direction; None when it rests.
    """
    from scipy.spatial import ConvexHull, QhullError

    if not len(points):
        return None
    plan = points[:, :2]
    try:
        ring = points[ConvexHull(plan).vertices] if len(points) > 2 else points
    except (QhullError, ValueError):  # all on a line
        along = plan - plan.mean(axis=0)
        direction = np.linalg.svd(along, full_matrices=False)[2][0]
        order = np.argsort(along @ direction)
        ring = points[order[[0, -1]]]
    target = center[:2]
    best, where = np.inf, ring[0]
    inside = len(ring) > 2
    for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True):
        edge = b[:2] - a[:2]
        square = float(edge @ edge)
        inside = inside and edge[0] * (target[1] - a[1]) - edge[1] * (target[0] - a[0]) >= 0.0
        share = float(np.clip((target - a[:2]) @ edge / square, 0.0, 1.0)) if square > 0 else 0.0
        near = a + share * (b - a)
        distance = float(np.hypot(*(target - near[:2])))
        if distance < best:
            best, where = distance, near
    x, y = ring[:, 0] - ring[0, 0], ring[:, 1] - ring[0, 1]
    if (inside or best <= BALANCE_M) and 0.5 * abs(float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())) > SPOT_M2:
        return None
    if best > 1e-9:
        way = (target - where[:2]) / best
    else:  # right above a point or line: any way across it
        along = ring[-1, :2] - ring[0, :2]
        length = float(np.hypot(*along))
        way = np.array([-along[1], along[0]]) / length if length > 1e-9 else np.array([1.0, 0.0])
    return where, np.array([-way[1], way[0], 0.0])


def free_turn(
    shapes: Shapes, stand: Stand, body: int, among: Booleans, pivot: Array, axis: Array, most: float, least: float = 0.0
) -> float:
    """How far a body may be turned about an axis until it touches [rad], at most a little more than `most`.

    What is below is measured exactly; what is beside only counts from a depth on that the test of faces cannot make up.
    Angles up to `least` [rad] are not told apart.
    """
    held = 2.0 * CONTACT_M

    def fits(angle: float) -> bool:
        vertices, normals = kept_shape(shapes, body)
        start = stand.place[body].copy()
        turn_about(shapes, stand, body, rotation_of(angle * axis), pivot)
        is_sunk = stand.low[body, 2] < -TOUCH_M or compiled()["sinks"](shapes, stand, body, among, SUNK_M, TOUCH_M)
        deep = np.inf if is_sunk else compiled()["deepest"](shapes, stand, body, among, held)
        put_back(shapes, stand, body, vertices, normals, start)
        return bool(deep <= held)

    low, step = 0.0, FIRST_TURN
    while low < most * 1.05:
        if not fits(low + step):
            break
        low, step = low + step, 1.5 * step
    else:
        return low
    high = low + step
    while high - low > LEAST_TURN and high > least:
        middle = 0.5 * (low + high)
        if fits(middle):
            low = middle
        else:
            high = middle
    return low


def _aside(shapes: Shapes, stand: Stand, body: int, among: Booleans, pivot: Array, axis: Array, most: float) -> Array | None:
    """Of some small level shifts [m], shape (3,), the one after which a wedged body can be turned farthest; None when none helps."""
    best, farthest = None, LEAST_GAIN
    for reach in ASIDE_M:
        for way in range(8):
            move = reach * np.array([np.cos(0.25 * np.pi * way), np.sin(0.25 * np.pi * way), 0.0])
            move_by(stand, shapes, body, move)
            if compiled()["deepest"](shapes, stand, body, among, 2.0 * CONTACT_M) <= 2.0 * CONTACT_M:
                angle = free_turn(shapes, stand, body, among, pivot + move, axis, most, farthest)
                if angle > farthest:
                    best, farthest = move, angle
            move_by(stand, shapes, body, -move)
    return best


def move_by(stand: Stand, shapes: Shapes, body: int, move: Array) -> None:
    """Shift a body [m]."""
    stand.place[body] += move
    compiled()["bound"](shapes, stand, body)


def turn_about(shapes: Shapes, stand: Stand, body: int, rotation: Array, pivot: Array) -> None:
    """Turn a body about a point in the world [m]: its vertices and normals, and its place."""
    c, s = stand.turn[body]
    own = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    local = own.T @ rotation @ own
    first, last = shapes.first_piece[body], shapes.first_piece[body + 1]
    vertices = slice(shapes.first_vertex[first], shapes.first_vertex[last])
    planes = slice(shapes.first_plane[first], shapes.first_plane[last])
    shapes.vertices[vertices] = shapes.vertices[vertices] @ local.T
    shapes.normals[planes] = shapes.normals[planes] @ local.T
    stand.place[body] = rotation @ (stand.place[body] - pivot) + pivot
    compiled()["bound"](shapes, stand, body)


def kept_shape(shapes: Shapes, body: int) -> tuple[Array, Array]:
    """Vertices and normals of a body, to put back."""
    first, last = shapes.first_piece[body], shapes.first_piece[body + 1]
    vertices = shapes.vertices[shapes.first_vertex[first] : shapes.first_vertex[last]].copy()
    return vertices, shapes.normals[shapes.first_plane[first] : shapes.first_plane[last]].copy()


def put_back(shapes: Shapes, stand: Stand, body: int, vertices: Array, normals: Array, place: Array) -> None:
    """Undo turns of a body."""
    first, last = shapes.first_piece[body], shapes.first_piece[body + 1]
    shapes.vertices[shapes.first_vertex[first] : shapes.first_vertex[last]] = vertices
    shapes.normals[shapes.first_plane[first] : shapes.first_plane[last]] = normals
    stand.place[body] = place
    compiled()["bound"](shapes, stand, body)


@cache
def compiled() -> Kernels:
    """The functions below and those of `shapes` as machine code, by name."""
    return compile_kernels(put_point, pair_points, contact_points, sinks, deepest, known=geometry.compiled())


def put_point(stand: Stand, body: int, x: float, y: float, z: float, points: Array, count: int) -> int:
    """Add a point of a body's frame to the points, in the world; the number of points."""
    if count < points.shape[0]:
        c, s = stand.turn[body, 0], stand.turn[body, 1]
        points[count, 0] = c * x - s * y + stand.place[body, 0]
        points[count, 1] = s * x + c * y + stand.place[body, 1]
        points[count, 2] = z + stand.place[body, 2]
        count += 1
    return count


def pair_points(shapes: Shapes, stand: Stand, a: int, b: int, p: int, q: int, near: float, points: Array, count: int) -> int:
    """Add the points where piece p of body a is within `near` [m] above piece q of body b: vertices of either, and where edges
    cross in plan. The number of points."""
    for side in range(2):
        i, j, first, second = (a, b, p, q) if side == 0 else (b, a, q, p)
        ca, sa, cb, sb = stand.turn[i, 0], stand.turn[i, 1], stand.turn[j, 0], stand.turn[j, 1]
        c, s = ca * cb + sa * sb, ca * sb - sa * cb  # from j's frame to i's
        dx, dy, dz = stand.place[j, 0] - stand.place[i, 0], stand.place[j, 1] - stand.place[i, 1], stand.place[j, 2] - stand.place[i, 2]
        ex, ey = ca * dx + sa * dy, ca * dy - sa * dx
        for v in range(shapes.first_vertex[second], shapes.first_vertex[second + 1]):
            x = c * shapes.vertices[v, 0] - s * shapes.vertices[v, 1] + ex
            y = s * shapes.vertices[v, 0] + c * shapes.vertices[v, 1] + ey
            z = shapes.vertices[v, 2] + dz
            low, high = span(shapes, first, x, y)
            if low > high:
                continue
            gap = low - z if side == 0 else z - high
            if gap <= near:
                count = put_point(stand, i, x, y, z, points, count)
    # where edges cross
    ca, sa, cb, sb = stand.turn[a, 0], stand.turn[a, 1], stand.turn[b, 0], stand.turn[b, 1]
    c, s = ca * cb + sa * sb, ca * sb - sa * cb
    dx, dy, dz = stand.place[b, 0] - stand.place[a, 0], stand.place[b, 1] - stand.place[a, 1], stand.place[b, 2] - stand.place[a, 2]
    ex, ey = ca * dx + sa * dy, ca * dy - sa * dx
    for e in range(shapes.first_edge[q], shapes.first_edge[q + 1]):
        u, v = shapes.edges[e, 0], shapes.edges[e, 1]
        x0 = c * shapes.vertices[u, 0] - s * shapes.vertices[u, 1] + ex
        y0 = s * shapes.vertices[u, 0] + c * shapes.vertices[u, 1] + ey
        wx = c * shapes.vertices[v, 0] - s * shapes.vertices[v, 1] + ex - x0
        wy = s * shapes.vertices[v, 0] + c * shapes.vertices[v, 1] + ey - y0
        z0, dh = shapes.vertices[u, 2] + dz, shapes.vertices[v, 2] - shapes.vertices[u, 2]
        for g in range(shapes.first_edge[p], shapes.first_edge[p + 1]):
            i, j = shapes.edges[g, 0], shapes.edges[g, 1]
            ax, ay, az = shapes.vertices[i, 0], shapes.vertices[i, 1], shapes.vertices[i, 2]
            bx, by, bz = shapes.vertices[j, 0] - ax, shapes.vertices[j, 1] - ay, shapes.vertices[j, 2] - az
            cross = bx * wy - by * wx
            if abs(cross) < 1e-15:
                continue
            t = ((x0 - ax) * wy - (y0 - ay) * wx) / cross
            r = ((x0 - ax) * by - (y0 - ay) * bx) / cross
            if 0.0 <= t <= 1.0 and 0.0 <= r <= 1.0 and az + t * bz - z0 - r * dh <= near:
                count = put_point(stand, a, ax + t * bx, ay + t * by, az + t * bz, points, count)
    return count


def contact_points(shapes: Shapes, stand: Stand, body: int, among: Any, near: float, points: Array) -> int:
    """Points in the world where a body touches what is below it: the floor, and the bodies marked in `among`. Their number."""
    count = 0
    for p in range(shapes.first_piece[body], shapes.first_piece[body + 1]):
        if stand.piece_low[p, 2] <= near:
            for v in range(shapes.first_vertex[p], shapes.first_vertex[p + 1]):
                if shapes.vertices[v, 2] + stand.place[body, 2] <= near:
                    count = put_point(stand, body, shapes.vertices[v, 0], shapes.vertices[v, 1], shapes.vertices[v, 2], points, count)
    for other in range(len(among)):
        if not among[other] or other == body or stand.high[other, 2] < stand.low[body, 2] - near:
            continue
        apart = False
        for k in range(3):
            apart = apart or stand.low[body, k] > stand.high[other, k] + near or stand.low[other, k] > stand.high[body, k] + near
        if apart:
            continue
        for p in range(shapes.first_piece[body], shapes.first_piece[body + 1]):
            for q in range(shapes.first_piece[other], shapes.first_piece[other + 1]):
                apart = False
                for k in range(3):
                    apart = apart or stand.piece_low[p, k] > stand.piece_high[q, k] + near
                    apart = apart or stand.piece_low[q, k] > stand.piece_high[p, k] + near
                if apart:
                    continue
                lower, raise_ = piece_gap(shapes, stand, body, other, p, q)
                if lower <= near and lower >= raise_ and lower > -0.004:
                    count = pair_points(shapes, stand, body, other, p, q, near, points, count)
    return count


def sinks(shapes: Shapes, stand: Stand, body: int, among: Any, reach: float, least: float) -> bool:
    """Whether a body is more than `least` [m] in any of the bodies marked in `among`, shape (n,), as `least_gap` measures it."""
    for other in range(len(among)):
        if among[other] and other != body and body_gap(shapes, stand, body, other, reach, -least) < -least:
            return True
    return False


def deepest(shapes: Shapes, stand: Stand, body: int, among: Any, slop: float) -> float:
    """Deepest penetration of a body with the floor and the bodies marked in `among` [m]; 0 when none exceeds `slop`."""
    depth = max(-stand.low[body, 2], 0.0)
    if depth <= slop:
        depth = 0.0
    for other in range(len(among)):
        if among[other] and other != body:
            _, deep = pair_depth(shapes, stand, body, other, slop)
            depth = max(depth, deep)
    return depth


__all__ = ["Tip", "free_turn", "kept_shape", "lean_of", "move_by", "put_back", "tip", "turn_about", "turn_along"]
