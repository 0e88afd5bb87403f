"""Elements of MJCF that expand into many: copies, grids and images, counted before MuJoCo makes them."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from schemas.budget import BUDGET
from tasks.exports.findings import Finding

Pairs = list[tuple[Path, ElementTree.Element]]


def made(file: str, elements: Pairs) -> Iterator[Finding]:
    """Findings where elements expand beyond the budget."""
    inside = {id(child) for _, element in elements for child in element}
    queue = [(element, 1) for _, element in elements if id(element) not in inside]
    copies = points = pixels = 0
    while queue:
        element, times = queue.pop()
        copies += times - 1
        if element.tag == "replicate":
            times *= _product(element.get("count"))
        elif element.tag in ("composite", "flexcomp"):
            copies += times * _product(element.get("count"))
        elif element.tag == "hfield":
            points += _product(element.get("nrow")) * _product(element.get("ncol"))
        elif element.tag == "texture":
            pixels += _product(element.get("width")) * _product(element.get("height")) * (1 if element.get("type") == "2d" else 6)
        queue += [(child, times) for child in element]
    for what, count, most in (("copies", copies, BUDGET.nodes), ("points", points, BUDGET.faces), ("pixels", pixels, BUDGET.all_pixels)):
        if count > most:
            yield Finding("budget", file, f"MuJoCo would make {_shown(count)} {what} of it, more than {most}")


def _product(text: str | None) -> int:
    """Product of the numbers of an attribute; 0 where it has none. Those that are none MuJoCo refuses itself."""
    try:
        return math.prod(max(int(float(word)), 0) for word in text.split()) if text else 0
    except (ValueError, OverflowError):
        return 0


def _shown(count: int) -> str:
    return str(count) if count < 10**12 else "endlessly many"
