"""What a lineage says in words of what carries an object."""

from __future__ import annotations

import dataclasses

import pytest

from schemas.lineage import Node
from schemas.optimization import Support
from tasks.lineage.words import described
from tests.samples import sample


@pytest.mark.parametrize(
    ("relation", "parent", "against", "blob", "words"),
    [
        ("none", None, "wall_02", "0" * 64 + ".glb", "bracket at wall_02, gap 0 mm, free to move"),
        ("none", None, None, None, "none, gap 0 mm, free to move"),
        ("on", "0003", "wall_02", None, "on 0003, gap 0 mm, free to move"),
        ("floor", None, "wall_02", None, "floor against wall_02, gap 0 mm, free to move"),
    ],
)
def test_what_carries_an_object_is_named(relation: str, parent: str | None, against: str | None, blob: str | None, words: str) -> None:
    row = sample(
        Support, relation=relation, parent_id=parent, against=against, bracket_blob=blob, gap_m=0.0, is_fixed=False, is_kept=True,
    )  # fmt: skip
    (line,) = described(Node("support", "x/0001", dataclasses.asdict(row)))
    assert line.replace("0.0 mm", "0 mm") == words
