"""Syntax trees of the project's modules, parsed once for all tests of a process that look at code."""

from __future__ import annotations

import ast
import gc
from functools import cache


@cache
def tree_of(source: str) -> ast.Module:
    """The syntax tree of a module's text; nobody may change it."""
    # Without the garbage collector, which looks at all trees again while the next one grows, parsing takes a third of the time.
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        return ast.parse(source)
    finally:
        if was_enabled:
            gc.enable()


@cache
def nodes_of(source: str) -> tuple[ast.AST, ...]:
    """All nodes of a module's text, breadth first."""
    return tuple(ast.walk(tree_of(source)))
