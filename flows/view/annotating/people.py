"""Roles of the people who take part in a batch."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from schemas.errors import InputError
from warehouse.tables.gate import person

ANNOTATOR, REVIEWER = "annotator", "reviewer"


def roles_of(annotators: Iterable[str], reviewers: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Everybody's roles by name. Who answers and reviews is one person, by the name that was asked; letter case tells nobody apart.

    Raises:
        InputError: a reviewer's name cannot be used.
    """
    names = {person(name): name for name in sorted(annotators)}
    roles = {name: [ANNOTATOR] for name in names.values()}
    for name in reviewers:
        if not name.strip() or name != name.strip() or not name.isprintable() or len(name) > 100:
            raise InputError("--reviewer", repr(name[:60]), "is no name", "give up to 100 letters without spaces around them")
        known = names.setdefault(person(name), name)
        if REVIEWER not in roles.setdefault(known, []):
            roles[known].append(REVIEWER)
    return {name: tuple(held) for name, held in roles.items()}
