"""Simulated annealing: the loss, acceptance and visits of a chain against the Boltzmann distribution, and what a chain leaves."""

from __future__ import annotations

import dataclasses
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.geometry.transforms import translation, yaw_pose
from tasks.optimization.contacts import penetrations
from tasks.optimization.default import Default
from tasks.optimization.search.arrangement import FIXED, HANGING, STANDING, Arrangement, compiled
from tasks.optimization.search.chains import Chain, anneal, run_chain
from tasks.optimization.shapes import stand_of
from tasks.optimization.solids import ConvexParts
from tests.tasks.optimization.interiors import arrangement, block, hull, world_vertices

Array = np.ndarray
seeds = st.integers(0, 10**6)
PLAN = Default().schedule()._replace(most_rise=np.inf, most_aside=np.inf)
CUBE = hull(block((0.3, 0.3, 0.3)))
WALL = hull(block((2.0, 4.0, 4.0)))


def at(x: float, y: float, z: float = 1.0, yaw: float = 0.0) -> Array:
    return yaw_pose(yaw, [x, y, z])


def crowd(seed: int, count: int = 6, reach: float = 0.5) -> tuple[list[Any], list[Array], list[int], list[int]]:
    """Boxes that overlap, some of them on others, between four walls: hulls, poses, kinds, parents."""
    rng = np.random.default_rng(seed)
    hulls, poses, kinds, parents = [], [], [], []
    for i in range(count):
        hulls.append(hull(block(rng.uniform(0.1, 0.3, 3))))
        parents.append(int(rng.integers(0, i)) if i > 2 and rng.random() < 0.3 else -1)
        height = 1.0 if parents[i] < 0 else poses[parents[i]][2, 3] + np.ptp(hulls[parents[i]].vertices[:, 2])
        poses.append(at(*rng.uniform(-0.6 * reach, 0.6 * reach, 2), height, rng.uniform(-3, 3)))
        kinds.append(STANDING)
    for sign, axis in ((-1, 0), (1, 0), (-1, 1), (1, 1)):
        hulls.append(hull(block((2.0, 6.0, 4.0))))
        middle = sign * (reach + 1.0)
        poses.append(at(middle, 0.0, 0.0) if axis == 0 else at(0.0, middle, 0.0, np.pi / 2))
        kinds.append(FIXED)
        parents.append(-1)
    return hulls, poses, kinds, parents


def room_of(seed: int, count: int = 6, reach: float = 0.5) -> Arrangement:
    hulls, poses, kinds, parents = crowd(seed, count, reach)
    return arrangement(hulls, np.array(poses), kinds, parents=parents)


def places(room: Arrangement, chain: Chain) -> tuple[Array, Any]:
    """Offsets of all bodies, shape (n, 4), after the moves of a chain, and where they stand."""
    offset, stand = np.zeros((len(room.parent), 4)), stand_of(room.shapes, room.pivots)
    for body, move in zip(chain.bodies, chain.moves, strict=True):
        offset[body] += move
    for body in range(len(room.parent)):
        compiled()["compose"](room, stand, offset, body)
    return offset, stand


def exact_loss(room: Arrangement, stand: Any, slop: float) -> float:
    """Sum of exact depths beyond `slop` over counted pairs [m]."""
    solids = [
        ConvexParts(f"{i:04d}", (dataclasses.replace(CUBE, vertices=world_vertices(room.shapes, stand, i)),))
        for i in range(len(room.parent))
    ]
    found = penetrations(solids, np.tile(translation([0.0, 0.0, 20.0]), (len(solids), 1, 1)))
    return sum(max(p.depth_m - slop, 0.0) for p in found if p.b != "floor" and room.counted[p.index_a, p.index_b])


def run(room: Arrangement, seed: int, moves: int = 4000, **changes: Any) -> Chain:
    return run_chain((room, PLAN._replace(**changes), moves, moves, np.random.default_rng(seed)))


# the loss


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_the_loss_is_the_exact_one_and_does_not_depend_on_order_or_place(seed: int) -> None:
    rng = np.random.default_rng(seed)
    hulls, poses, kinds, _ = crowd(seed)
    room = arrangement(hulls, np.array(poses), kinds)
    expected = run(room, 0, 1, returns=False).start
    assert expected == pytest.approx(exact_loss(room, stand_of(room.shapes, room.pivots), PLAN.slop), abs=1e-9)
    order = rng.permutation(len(hulls))
    shift = translation(rng.uniform(-5, 5, 3))
    other = arrangement([hulls[i] for i in order], np.array([shift @ poses[i] for i in order]), [kinds[i] for i in order])
    assert run(other, 0, 1, returns=False).start == pytest.approx(expected, abs=1e-9)


@given(seeds)
@settings(max_examples=15, deadline=None)
def test_the_loss_of_every_kept_move_is_that_of_the_state_it_leads_to(seed: int) -> None:
    """What is counted up move by move does not drift, and what is carried moves along."""
    room = room_of(seed)
    chain = run(room, seed, 600, returns=False)
    for last in np.unique(np.linspace(1, len(chain.bodies), 6).astype(int)) if len(chain.bodies) else ():
        part = dataclasses.replace(chain, bodies=chain.bodies[:last], moves=chain.moves[:last])
        assert chain.loss[last - 1] == pytest.approx(exact_loss(room, places(room, part)[1], PLAN.slop), abs=1e-8)


# one object squeezed between two walls: E(x, z) is known in closed form

HALF = 0.05
"""Each wall reaches this far into the cube at its place [m]."""


def squeezed() -> Arrangement:
    walls = [at(sign * (0.15 - HALF + 1.0), 0.0, -1.0) for sign in (-1, 1)]
    along = [(1.0, 0.0), (0.0, 0.0), (0.0, 0.0)]
    return arrangement([CUBE, WALL, WALL], np.array([at(0.0, 0.0), *walls]), [HANGING, FIXED, FIXED], along)


def energy(x: Array, z: Array, price: float) -> Array:
    return np.maximum(HALF - x, 0.0) + np.maximum(HALF + x, 0.0) + price * np.hypot(x, z)


TEMPERATURE, PRICE, STEP, MOVES = 0.015, 0.4, 0.03, 300_000


def squeezed_chain() -> tuple[Array, Array, Array]:
    """Every state that a chain at one temperature visits, (x, z), shape (m, 2), the moves it stayed there for, and its loss."""
    held = {"temperature": TEMPERATURE, "cooling": 1.0, "coldest": 1e-9, "adapts": False, "returns": False}
    chain = run(squeezed(), 5, MOVES, slop=0.0, step=STEP, price=PRICE, **held)
    assert chain.tried == MOVES
    states = np.concatenate([[[0.0, 0.0]], np.cumsum(chain.moves[:, [0, 2]], axis=0)])
    assert not chain.moves[:, [1, 3]].any()
    numbers = np.concatenate([[0], chain.numbers, [MOVES + 1]])
    return states, np.diff(numbers), np.concatenate([[chain.start], chain.loss])


@pytest.fixture(scope="module")
def visits() -> tuple[Array, Array, Array]:
    return squeezed_chain()


def test_losses_of_the_squeezed_object_have_the_closed_form(visits: tuple[Array, Array, Array]) -> None:
    states, _, loss = visits
    assert loss == pytest.approx(energy(states[:, 0], states[:, 1], 0.0), abs=1e-9)
    assert np.abs(states[:, 0]).max() > HALF  # both walls were let go of at times


def test_visits_follow_the_boltzmann_distribution(visits: tuple[Array, Array, Array]) -> None:
    states, stays, _ = visits
    edges = np.linspace(-0.16, 0.16, 17)
    fine = (np.arange(1200) + 0.5) * 0.001 - 0.6
    x, z = np.meshgrid(fine, fine, indexing="ij")
    weight = np.exp(-energy(x, z, PRICE) / TEMPERATURE)
    for axis, grid in ((0, x), (1, z)):
        expected = np.histogram(grid, bins=edges, weights=weight)[0] / weight.sum()
        which = np.digitize(states[:, axis], edges) - 1
        inside = (which >= 0) & (which < len(expected))
        counts = np.bincount(which[inside], weights=stays[inside], minlength=len(expected))
        seen = counts / stays.sum()
        assert 0.5 * np.abs(seen - expected).sum() < 0.01  # total variation
        # by batches, which are long against the time that the chain remembers
        steps = np.concatenate([[0], np.cumsum(stays)])[:-1]
        batches = np.zeros((30, len(expected)))
        np.add.at(batches, ((steps[inside] * 30) // stays.sum(), which[inside]), stays[inside])
        error = (batches / (stays.sum() / 30)).std(axis=0, ddof=1) / np.sqrt(30)
        assert (np.abs(seen - expected) < 4.5 * error + 1e-4).all()


def test_moves_are_accepted_as_metropolis_has_it(visits: tuple[Array, Array, Array]) -> None:
    """Kept moves, by how much dearer they were, against proposals times min(1, exp(-change / temperature))."""
    states, stays, _ = visits
    rng = np.random.default_rng(0)
    bins = np.array([-np.inf, 0.0, 0.3, 0.7, 1.2, 2.0, 3.0, np.inf])
    taken = np.diff(energy(states[:, 0], states[:, 1], PRICE)) / TEMPERATURE
    seen = np.histogram(taken, bins)[0].astype(float)
    # what a move of this distribution would have met at every state
    chosen = rng.choice(len(states), 4000, p=stays / stays.sum())
    far = np.where(rng.random((4000, 500)) < 0.1, 4.0, 1.0)
    x = states[chosen, :1] + far * STEP * rng.normal(size=(4000, 500))
    z = states[chosen, 1:] + STEP * rng.normal(size=(4000, 500))
    change = (energy(x, z, PRICE) - energy(states[chosen, :1], states[chosen, 1:], PRICE)) / TEMPERATURE
    ratio = np.minimum(1.0, np.exp(-change))
    expected = np.histogram(change, bins, weights=ratio)[0] / change.size * MOVES
    assert expected.sum() == pytest.approx(len(taken), rel=0.01)
    assert (np.abs(seen - expected) < 4.0 * np.sqrt(expected) + 0.01 * expected).all()
    # the ratio of a wrong rule is far from that
    always = np.histogram(change, bins)[0] / change.size * MOVES
    assert np.abs(seen / always - 1.0)[2:].min() > 0.1


def test_turns_cost_their_lever() -> None:
    """An object whose loss no turn changes turns as the Boltzmann distribution of its lever's price has it."""
    lever, temperature, price, moves = 0.2, 0.01, 1.0, 120_000
    big = hull(block((6.0, 6.0, 6.0)))
    room = arrangement([CUBE, big], np.array([at(0.0, 0.0, 2.85), at(0.0, 0.0, 0.0)]), [STANDING, FIXED], lever=lever)
    chain = run(
        room, 1, moves, slop=0.0, step=0.03, turn=0.1, price=price, temperature=temperature, cooling=1.0, coldest=1e-9, turn_share=1.0,
        most_turn=np.pi, adapts=False, returns=False,
    )  # fmt: skip
    yaw = np.concatenate([[0.0], np.cumsum(chain.moves[:, 3])])
    stays = np.diff(np.concatenate([[0], chain.numbers, [moves + 1]]))
    assert not chain.moves[:, :3].any()
    # the way out of the big one is up, however the cube is turned
    assert chain.loss == pytest.approx(np.full(len(chain.loss), 3.15), abs=1e-9)
    grid = np.linspace(-np.pi, np.pi, 4001)
    dearer = price * lever * 2.0 * np.abs(np.sin(grid / 2))
    weight = np.exp(-dearer / temperature)
    expected = np.histogram(np.abs(grid), bins=np.linspace(0, 0.4, 9), weights=weight)[0] / weight.sum()
    seen = np.histogram(np.abs(yaw), bins=np.linspace(0, 0.4, 9), weights=stays)[0] / stays.sum()
    assert 0.5 * np.abs(seen - expected).sum() < 0.03


# what a chain leaves


@pytest.mark.parametrize("seed", range(6))
def test_a_stuck_chain_leaves_its_best_state(seed: int) -> None:
    room = room_of(seed, count=8, reach=0.22)
    chain = run(room, seed, 1500)
    assert chain.tried == 1500  # too narrow: it never ends by itself
    _, stand = places(room, chain)
    assert chain.final == pytest.approx(exact_loss(room, stand, PLAN.slop), abs=1e-8)
    assert chain.final == chain.smallest[-1] == pytest.approx(min(chain.start, chain.loss.min()), abs=1e-9)
    whole = run(room, seed, 1500, returns=False)
    assert whole.final == chain.final == whole.smallest[-1]
    assert whole.loss.min() >= chain.final - 1e-12
    assert (np.diff(whole.smallest) <= 0.0).all()
    assert whole.smallest == pytest.approx(np.minimum.accumulate(np.minimum(whole.loss, chain.start)), abs=1e-9)
    assert np.array_equal(whole.moves[: len(chain.moves)], chain.moves)


@pytest.mark.parametrize("seed", range(8))
def test_a_chain_ends_when_nothing_overlaps_and_only_brings_objects_back_after(seed: int) -> None:
    room = room_of(seed, count=6, reach=0.6)
    raw, chain = run(room, seed, 30_000, returns=False), run(room, seed, 30_000)
    assert raw.start > 0.0
    assert raw.final == chain.final == 0.0
    assert raw.tried == raw.numbers[-1] == chain.tried < 30_000
    assert (raw.loss[:-1] > 0.0).all()
    assert raw.loss[-1] == 0.0
    assert np.array_equal(chain.moves[: len(raw.moves)], raw.moves)
    (before, stand), (after, brought) = places(room, raw), places(room, chain)
    assert exact_loss(room, stand, PLAN.slop) < 1e-9
    assert exact_loss(room, brought, PLAN.slop) < 1e-9
    own = np.linalg.norm(after[:, :3], axis=1), np.linalg.norm(before[:, :3], axis=1)
    assert (own[0] <= own[1] + 1e-12).all()
    assert (np.abs(after[:, 3]) <= np.abs(before[:, 3]) + 1e-12).all()
    assert not after[room.kind == FIXED].any()
    # each goes straight back, turned by the same share
    for body in np.flatnonzero(own[1] > 1e-9):
        share = own[0][body] / own[1][body]
        assert after[body] == pytest.approx(share * before[body], abs=1e-9)
    assert chain.displacement <= raw.displacement + 1e-12 or (room.parent >= 0).any()


def test_objects_that_were_shaken_far_are_brought_back_far() -> None:
    """Hot chains throw objects about; what need not have moved returns whole."""
    room = room_of(3, count=6, reach=0.8)
    hot = {"temperature": 0.05, "price": 0.0}
    raw, chain = run(room, 2, 30_000, returns=False, **hot), run(room, 2, 30_000, **hot)
    assert raw.final == chain.final == 0.0
    assert chain.displacement < 0.7 * raw.displacement


def test_objects_apart_are_left_alone() -> None:
    room = arrangement([CUBE] * 3, np.array([at(x, 0.0) for x in (0.0, 0.3, 0.7)]), [STANDING] * 3)
    chain = run(room, 0)
    assert (chain.start, chain.final, chain.tried, len(chain.bodies)) == (0.0, 0.0, 0, 0)


def test_a_carried_object_stays_where_its_carrier_carries_it() -> None:
    """Two overlapping objects on a table may stand in few cells only, and turn by little; the table is fixed."""
    table = hull(block((1.0, 1.0, 0.7)))
    room = arrangement(
        [table, CUBE, CUBE], np.array([at(0, 0, 0), at(-0.1, 0, 0.7), at(0.1, 0, 0.7)]), [FIXED, STANDING, STANDING], parents=[-1, 0, 0]
    )
    cells = np.zeros((2, 21, 21), dtype=np.bool_)
    cells[:, 5:16, 9:12] = True  # 10 cm along x, 2 cm along y
    room = room._replace(map_of=np.array([-1, 0, 1]), maps=cells)
    chain = run(room, 0, 20_000, most_turn=0.02)
    assert chain.final == 0.0
    for last in range(1, len(chain.bodies) + 1):
        offset, _ = places(room, dataclasses.replace(chain, bodies=chain.bodies[:last], moves=chain.moves[:last]))
        assert np.abs(offset[:, 0]).max() <= 0.11 + 1e-9
        assert np.abs(offset[:, 1]).max() <= 0.03 + 1e-9
        assert np.abs(offset[:, 3]).max() <= 0.02


# chains


def same(a: Chain, b: Chain) -> bool:
    pairs = zip(dataclasses.astuple(a), dataclasses.astuple(b), strict=True)
    return all(np.asarray(x).tobytes() == np.asarray(y).tobytes() for x, y in pairs)


def test_the_same_generator_gives_the_same_bytes() -> None:
    room = room_of(1, count=8, reach=0.4)
    assert same(run(room, 3), run(room, 3))
    assert not same(run(room, 3), run(room, 4))


@pytest.mark.whole
def test_chains_in_other_processes_give_the_same_best() -> None:
    room = room_of(2, count=8, reach=0.35)

    def generators() -> list[np.random.Generator]:
        return [np.random.default_rng([7, k]) for k in range(4)]

    alone, tried = anneal(room, PLAN, 1500, 1500, generators(), lambda f, jobs: [f(job) for job in jobs])
    singles = [run_chain((room, PLAN, 1500, 1500, rng)) for rng in generators()]
    assert tried == sum(chain.tried for chain in singles)
    best = min(singles, key=lambda chain: (chain.final, chain.displacement))
    assert same(alone, best)
    with ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn")) as pool:
        spread, also = anneal(room, PLAN, 1500, 1500, generators(), lambda f, jobs: list(pool.map(f, jobs)))
    assert also == tried
    assert same(alone, spread)
