"""Syntax trees of the project's modules, parsed once for all tests of a process that look at code."""

from __future__ import annotations

import ast
from functools import cache


@cache
def tree_of(source: str) -> ast.Module:
    """The syntax tree of a module's text; nobody may change it."""
    return ast.parse(source)


@cache
def nodes_of(source: str) -> tuple[ast.AST, ...]:
    """All nodes of a module's text, breadth first."""
    return tuple(ast.walk(tree_of(source)))
