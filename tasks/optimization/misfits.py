"""Assets that fill each other's place: another candidate of the same object, or a smaller one, before anything is moved.

A scan's objects are beside each other. Where their assets are deep in each other one of them has the wrong shape: the solid of a corner
sofa fills its bend. To push the other out of it changes the scene more than to take the next best asset.
"""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence

import numpy as np

from schemas.selection import Selection
from tasks.geometry.transforms import matrix
from tasks.optimization.contacts import Colliders, Penetration
from tasks.optimization.interior import Interior
from tasks.optimization.proposals import Proposal
from tasks.optimization.support.supports import Carrier

MOST_ROUNDS = 5
"""How often assets are taken for others."""

LESS = 0.05
"""By as much less foreign space must another candidate fill to be taken instead."""

SMALLER = 0.8
"""Factor on the plan of an asset of which every candidate fills another's place."""

LITTLE = 0.88
"""Least factor on the plan of an asset that is stuck in another in the end, at a time."""

LEAST_LESS = 0.98
"""Greatest such factor: there are only so many tries."""

MARGIN = 1.1
"""By so many times its depth each side of such an asset retreats: a side that is askew meets the other farther out."""

OTHER_NOTE = "another asset, whose shape leaves its neighbors their place"

SMALLER_NOTE = "made smaller to leave its neighbors their place"

LEAST_SCALE = 0.5
"""Smaller than this share of what was selected, an asset is another object."""


@dataclasses.dataclass(frozen=True)
class Fitting:
    """Proposals, the interior that they make, what was left out of it, and what was taken for something else, a line each."""

    proposals: tuple[Proposal, ...]
    interior: Interior
    left_out: tuple[str, ...]
    notes: tuple[str, ...]


def fit_together(
    proposals: Sequence[Proposal], selections: Sequence[Selection], assets: Collection[str], depth: float, reach_m: float,
    furnish: Callable[[Sequence[Proposal]], tuple[Interior, list[str]]],
) -> Fitting:  # fmt: skip
    """The proposals, those of them that are deeper in each other than `depth` [m] replaced. What people chose stays as it is.

    Of two the one that fills more of what was seen not to be its own gives way, of equal ones the one that carries nothing, then the
    smaller: to the best candidate that fills less, and where there is none, it is made smaller. Where that would let fall what it
    carries (a shelf without its boards), the next candidate is tried; where none is left, the other one gives way.

    reach_m: Gap to what carries a thing from which on it falls [m].
    """
    ranked: dict[str, list[Selection]] = defaultdict(list)
    for row in sorted(selections, key=lambda s: (s.instance_id, s.rank)):
        if row.asset_id in assets:
            ranked[row.instance_id].append(row)
    chosen = {p.instance.instance_id: p for p in proposals}
    first = dict(chosen)
    reasons: dict[str, str] = {}
    interior, left_out = furnish(tuple(chosen.values()))
    needed, refused = set[str](), set[tuple[str, str]]()
    for _ in range(MOST_ROUNDS):
        pairs = Colliders(interior.solids).penetrations(interior.poses)
        while replacements := {
            name: other
            for name in _giving_way(interior, pairs, ranked, chosen, depth, needed)
            if (other := _other(chosen[name], ranked[name], refused)) is not None
        }:
            changed, missing = furnish(tuple((chosen | replacements).values()))
            dropping = _dropping(interior, changed, replacements, reach_m)
            if not dropping:
                break
            refused |= {(name, replacements[name].asset_id) for name in dropping}
            # Before it is made smaller, the other one of its pair gives way.
            needed |= {name for name in dropping if not _has_other(chosen[name], ranked[name], refused)}
        if not replacements:
            break
        chosen |= replacements
        interior, left_out = changed, missing
        for name, other in replacements.items():
            is_other = other.asset_id != first[name].asset_id
            reasons[name] = OTHER_NOTE if is_other else ""
            if (other.scale < (1 - 1e-9) * _selected(other, ranked[name])).any():
                reasons[name] = "; ".join(filter(None, [reasons[name], SMALLER_NOTE]))
    notes = tuple(f"{name}: {text}" for name, text in sorted(reasons.items()))
    return Fitting(tuple(chosen.values()), interior, tuple(left_out), notes)


def yielding(
    fitting: Fitting, interior: Interior, stuck: Sequence[Penetration], selections: Sequence[Selection], assets: Collection[str],
    reach_m: float, furnish: Callable[[Sequence[Proposal]], tuple[Interior, list[str]]],
) -> Fitting | None:  # fmt: skip
    """The same with those that are still stuck in others, of each pair one, taken for a candidate that fills less of what is not its own,
    or else a little smaller in plan; None where nothing can be. reach_m: As for `fit_together`."""
    ranked: dict[str, list[Selection]] = defaultdict(list)
    for row in sorted(selections, key=lambda s: (s.instance_id, s.rank)):
        if row.asset_id in assets:
            ranked[row.instance_id].append(row)
    chosen = {p.instance.instance_id: p for p in fitting.proposals}
    notes = dict(note.split(": ", 1) for note in fitting.notes)
    needed, kept, refused = set[str](), set[str](), set[tuple[str, str]]()
    while True:
        names = _giving_way(interior, stuck, ranked, chosen, 0.0, needed, counts_walls=True)
        alternatives = {
            name: other
            for name in names
            if (other := _other(chosen[name], ranked[name], refused)) and other.asset_id != chosen[name].asset_id
        }
        less = {
            name: dataclasses.replace(chosen[name], scale=chosen[name].scale * [factor, factor, 1.0])
            for name in names
            for factor in [_little(interior, name, stuck)]
            if name not in alternatives and name not in kept
        }
        shrunk = {name: p for name, p in less.items() if (p.scale >= LEAST_SCALE * _selected(p, ranked[name])).all()}
        if not shrunk and not alternatives:
            return None
        made, left_out = furnish(tuple((chosen | shrunk | alternatives).values()))
        dropping = _dropping(fitting.interior, made, alternatives | shrunk, reach_m)
        if not dropping:
            break
        refused |= {(name, alternatives[name].asset_id) for name in dropping if name in alternatives}
        kept |= {name for name in dropping if name in shrunk}
        needed |= {name for name in dropping if not _has_other(chosen[name], ranked[name], refused)}
    chosen |= shrunk | alternatives
    notes |= dict.fromkeys(alternatives, OTHER_NOTE)
    notes |= {name: "; ".join(sorted({*notes.get(name, SMALLER_NOTE).split("; "), SMALLER_NOTE})) for name in shrunk}
    return Fitting(tuple(chosen.values()), made, tuple(left_out), tuple(f"{name}: {text}" for name, text in sorted(notes.items())))


def _dropping(before: Interior, after: Interior, replacements: Collection[str], reach_m: float) -> set[str]:
    """The objects, of those replaced, for which a thing hangs in the air or drops: itself if it was replaced, else what carried it."""
    carriers = dict(zip(after.names, after.carriers, strict=True))
    loose = {
        name: carrier.parent_id
        for name, carrier in zip(before.names, before.carriers, strict=True)
        if not _is_loose(carrier, reach_m) and name in carriers and _is_loose(carriers[name], reach_m)
    }
    blamed = {name if name in replacements else parent for name, parent in loose.items()}
    return {name for name in replacements if name in blamed}


def _is_loose(carrier: Carrier, reach_m: float) -> bool:
    """True if nothing near carries an object."""
    return carrier.relation == "none" or carrier.gap > reach_m


def _little(interior: Interior, name: str, stuck: Sequence[Penetration]) -> float:
    """Factor on the plan of an object by which its sides retreat as far as it is stuck: at least `LITTLE`, at most `LEAST_LESS`."""
    obj = interior.objects[interior.names.index(name)]
    depth = max((pair.depth_m for pair in stuck if name in (pair.a, pair.b)), default=0.0)
    wanted = 1.0 - 2.0 * MARGIN * depth / max(float((obj.high - obj.low)[:2].min()), 1e-6)
    return min(max(LITTLE, wanted), LEAST_LESS)


def _selected(proposal: Proposal, rows: Sequence[Selection]) -> np.ndarray:
    """The scale at which an asset was selected, shape (3,)."""
    return np.array(next(row.scale for row in rows if row.asset_id == proposal.asset_id))


def _giving_way(
    interior: Interior, pairs: Sequence[Penetration], ranked: Mapping[str, Sequence[Selection]], chosen: Mapping[str, Proposal],
    depth: float, needed: Collection[str], counts_walls: bool = False,
) -> list[str]:  # fmt: skip
    """The objects that give way to others, one of each pair that is deeper than `depth` [m], but those in `needed`; where it
    counts, to walls as well, where no other one could."""
    index = {name: i for i, name in enumerate(interior.names)}
    fixed = {name for name, is_fixed in zip(interior.names, interior.fixed, strict=True) if is_fixed}
    carried = {(name, c.parent_id) for name, c in zip(interior.names, interior.carriers, strict=True) if c.relation == "on"}
    carriers = {carrier.parent_id for carrier in interior.carriers}

    def volume(name: str) -> float:
        return interior.volume(index[name])

    rugs = {
        name for name, is_rug in zip(interior.names, interior.covering, strict=True) if is_rug
    }  # they end at walls, and give way to none
    names: set[str] = set()
    for pair in pairs:
        if (
            pair.b not in index
            and pair.depth_m > depth
            and counts_walls
            and pair.a not in {*fixed, *rugs}
            and chosen[pair.a].origin == "selection"
        ):
            names.add(pair.a)
        if pair.depth_m <= depth or pair.b not in index or (pair.a in fixed and pair.b in fixed):
            continue
        if (pair.a, pair.b) in carried or (pair.b, pair.a) in carried:  # it is lifted out of its carrier
            continue
        sides = [name for name in (pair.a, pair.b) if chosen[name].origin == "selection" and name not in {*rugs, *needed}]
        if sides and not names & {pair.a, pair.b}:
            names.add(
                max(
                    sides,
                    key=lambda name: (
                        round(_foreign(chosen[name], ranked[name]), 3),
                        name not in carriers,
                        -volume(name),
                        name,
                    ),
                )
            )
    return sorted(names)


def _foreign(proposal: Proposal, rows: Sequence[Selection]) -> float:
    """Share of foreign space that a proposal's asset fills, as it was selected."""
    return next((row.foreign_share or 0.0 for row in rows if row.asset_id == proposal.asset_id), 0.0)


def _has_other(proposal: Proposal, rows: Sequence[Selection], refused: Collection[tuple[str, str]]) -> bool:
    """True if another candidate that fills less foreign space is left."""
    other = _other(proposal, rows, refused)
    return other is not None and other.asset_id != proposal.asset_id


def _other(proposal: Proposal, rows: Sequence[Selection], refused: Collection[tuple[str, str]]) -> Proposal | None:
    """The best candidate that fills less foreign space than a proposal, else a smaller one; None where neither is left.

    refused: Instances with assets that would let fall what the instance carries.
    """
    foreign = _foreign(proposal, rows)
    for row in rows:
        if (row.foreign_share or 0.0) < foreign - LESS and (row.instance_id, row.asset_id) not in refused:
            return dataclasses.replace(proposal, asset_id=row.asset_id, pose=matrix(row.pose), scale=np.array(row.scale))
    smaller = proposal.scale * [SMALLER, SMALLER, 1.0]
    return dataclasses.replace(proposal, scale=smaller) if (smaller >= LEAST_SCALE * _selected(proposal, rows)).all() else None
