"""What belongs to which large object: chains of carriers, from small objects down to what stands on the floor."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

from tasks.micro_scenes.carrying import CarriedBy


@dataclasses.dataclass(frozen=True)
class Belonging:
    """A small object's place in a micro-scene. large: Instance of the large object. depth: Objects from there down to it, at least 1."""

    name: str
    large: str
    carried: CarriedBy
    depth: int


def belongings(carried: Mapping[str, CarriedBy], is_large: Callable[[str], bool], is_small: Callable[[str], bool]) -> list[Belonging]:
    """The small objects of every large one, by instance.

    A chain of carriers ends at what nothing carries, and at what is not small: a nightstand on a platform begins a chain of its own.
    Where the end of a chain is large, all on the way to it belongs to it, however many carriers lie between.

    carried: What carries each object, by instance, without circles. is_large, is_small: Of an object, by instance.
    """
    rows = []
    for name in sorted(carried):
        if not is_small(name):
            continue
        root, depth = name, 0
        while root in carried and is_small(root):
            root, depth = carried[root].parent, depth + 1
        if is_large(root):
            rows.append(Belonging(name, root, carried[name], depth))
    return rows
