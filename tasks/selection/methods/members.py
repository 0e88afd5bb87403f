"""The selection methods."""

from __future__ import annotations

from schemas.families.selection_methods import SELECTION_METHODS
from tasks.families import member, members
from tasks.selection.methods.method import MethodConfig, SelectionMethod

METHODS = members("tasks.selection.methods", SELECTION_METHODS, SelectionMethod)


def method_of(config: MethodConfig) -> SelectionMethod:
    """The method that a config tells."""
    return member(METHODS, config.kind)
