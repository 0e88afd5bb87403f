"""Assets that fill each other's place: another candidate of the same object that fits it as well, before anything is moved.

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

AS_WELL = 0.05
"""By as much less of an object's points may another candidate cover: a step that loses more is no repair."""

OTHER_NOTE = "another asset, whose shape leaves its neighbors their place"


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
    smaller: to the best candidate that fills less and covers as much of the object's points. Where that would let fall what it
    carries (a shelf without its boards), the next candidate is tried; where none is left, the other one gives way, and where
    neither can, both stay.

    reach_m: Gap to what carries a thing from which on it falls [m].
    """
    ranked: dict[str, list[Selection]] = defaultdict(list)
    for row in sorted(selections, key=lambda s: (s.instance_id, s.rank)):
        if row.asset_id in assets:
            ranked[row.instance_id].append(row)
    chosen = {p.instance.instance_id: p for p in proposals}
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
            needed |= {name for name in dropping if _other(chosen[name], ranked[name], refused) is None}
        if not replacements:
            break
        chosen |= replacements
        interior, left_out = changed, missing
        reasons |= dict.fromkeys(replacements, OTHER_NOTE)
    notes = tuple(f"{name}: {text}" for name, text in sorted(reasons.items()))
    return Fitting(tuple(chosen.values()), interior, tuple(left_out), notes)


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
    return carrier.relation == "none" or carrier.gap + carrier.reach > reach_m


def _giving_way(
    interior: Interior, pairs: Sequence[Penetration], ranked: Mapping[str, Sequence[Selection]], chosen: Mapping[str, Proposal],
    depth: float, needed: Collection[str],
) -> list[str]:  # fmt: skip
    """The objects that give way to others, one of each pair that is deeper than `depth` [m], but those in `needed`."""
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


def _other(proposal: Proposal, rows: Sequence[Selection], refused: Collection[tuple[str, str]]) -> Proposal | None:
    """The best candidate that fills less foreign space than a proposal and covers as much of the object's points; None where there is none.

    refused: Instances with assets that would let fall what the instance carries.
    """
    now = next((row for row in rows if row.asset_id == proposal.asset_id), None)
    if now is None:
        return None
    for row in rows:
        fits = row.coverage >= now.coverage - AS_WELL and (row.foreign_share or 0.0) < (now.foreign_share or 0.0) - LESS
        if fits and (row.instance_id, row.asset_id) not in refused:
            return dataclasses.replace(proposal, asset_id=row.asset_id, pose=matrix(row.pose), scale=np.array(row.scale))
    return None
