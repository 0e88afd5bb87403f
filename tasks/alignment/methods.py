"""The alignment methods."""

from __future__ import annotations

from schemas.families.alignment_methods import ALIGNMENT_METHODS as NAMES
from tasks.alignment.method import AlignmentMethod, AlignmentMethodConfig
from tasks.families import member, members

METHODS = members("tasks.alignment", NAMES, AlignmentMethod)
"""The first is the default."""


def method_of(config: AlignmentMethodConfig) -> AlignmentMethod:
    """The method that a config is one of."""
    return member(METHODS, config.kind)
