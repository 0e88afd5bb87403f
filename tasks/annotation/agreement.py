"""Whose answer counts where several annotators answered for one instance, perhaps more than once."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Sequence
from fractions import Fraction

from schemas.annotation import Annotation


def winning(annotations: Sequence[Annotation]) -> dict[str, Annotation]:
    """The answer that counts for every instance of one scene, by instance id. Those of returned batches are not among `annotations`.

    1. Of each annotator, the answer from the newest batch counts, the others are history. A batch is as new as the
       annotator's latest answer in it.
    2. Most votes: the choice that most annotators made. "None fits" is a choice like any other.
    3. Equal votes: the higher Borda count over the rankings.
    4. Still equal: the newest answer, then the annotator's name.

    The answer returned is one annotator's in full, pose and all: of those who made the winning choice, the newest.
    """
    by_instance: dict[str, list[Annotation]] = defaultdict(list)
    for annotation in current(annotations):
        by_instance[annotation.instance_id].append(annotation)
    return {instance_id: _winner(rows) for instance_id, rows in sorted(by_instance.items())}


def current(annotations: Sequence[Annotation]) -> list[Annotation]:
    """Each annotator's answer per instance from their newest batch, sorted by instance and annotator."""
    newest: dict[tuple[str, str], float] = defaultdict(lambda: float("-inf"))
    for row in annotations:
        key = (row.batch_id, row.annotator)
        newest[key] = max(newest[key], row.answered_at.timestamp())
    kept: dict[tuple[str, str], Annotation] = {}
    for row in sorted(annotations, key=lambda r: (newest[r.batch_id, r.annotator], r.answered_at, r.batch_id)):
        kept[row.instance_id, row.annotator] = row
    return [kept[key] for key in sorted(kept)]


def borda(annotations: Sequence[Annotation]) -> dict[str, Fraction]:
    """Borda count of every asset that the answers for one instance name.

    With n assets named in all, first place is worth n - 1, second n - 2, and so on. The assets that an annotator left
    out share equally what is left, so that a short ranking counts neither for nor against them. A choice tops its
    ranking. An answer "none fits" without a ranking says nothing about the order.
    """
    orders = [_order(row) for row in annotations]
    assets = sorted({asset for order in orders for asset in order})
    counts = dict.fromkeys(assets, Fraction(0))
    for order in orders:
        if not order:
            continue
        rest = len(assets) - len(order)
        for asset in assets:
            place = Fraction(order.index(asset)) if asset in order else len(order) + Fraction(rest - 1, 2)
            counts[asset] += len(assets) - 1 - place
    return counts


def _order(row: Annotation) -> list[str]:
    """An annotator's ranking with the choice on top."""
    first = [row.choice] if row.choice is not None else []
    return first + [asset for asset in row.ranking if asset != row.choice]


def _winner(rows: Sequence[Annotation]) -> Annotation:
    votes = Counter(row.choice for row in rows)
    counts = borda(rows)
    return min(rows, key=lambda r: (-votes[r.choice], -counts.get(r.choice or "", Fraction(0)), -r.answered_at.timestamp(), r.annotator))
