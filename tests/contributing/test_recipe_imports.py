"""What the recipes of CONTRIBUTING.md import is there: nothing else may call it, so nothing else would miss it."""

from __future__ import annotations

import ast
from importlib import import_module
from importlib.util import find_spec

import pytest

from tests.contributing.test_recipes import BLOCK, FILE, PAGE
from tests.test_architecture import ROOMS

WRITTEN = {named[1]: text for above, kind, text in BLOCK.findall(PAGE) if kind == "python" and (named := FILE.search(above))}
"""Modules that recipes write, by their paths."""

MADE = {path.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for path in WRITTEN}
OURS = (*ROOMS, "tests")


@pytest.mark.parametrize("path", WRITTEN)
def test_what_a_recipe_imports_is_there(path: str) -> None:
    missing = []
    for node in ast.walk(ast.parse(WRITTEN[path])):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.partition(".")[0] in OURS and node.module not in MADE:
            module = import_module(node.module)
            absent = [name.name for name in node.names if not hasattr(module, name.name)]
            missing += [
                f"{node.module}.{name}" for name in absent if f"{node.module}.{name}" not in MADE and not is_module(node.module, name)
            ]
    assert missing == [], "put it back, or change the recipe"


def is_module(package: str, name: str) -> bool:
    try:
        return find_spec(f"{package}.{name}") is not None
    except ModuleNotFoundError:
        return False
