"""A path finder: the planar one under another name."""

from __future__ import annotations

import dataclasses
from typing import Any, ClassVar

from tasks.navigation.planar import PLANAR, PlanarConfig
from tasks.navigation.protocol import PathFinder, PathFinderKind


@dataclasses.dataclass(frozen=True)
class ToyFinderConfig(PlanarConfig):
    kind: ClassVar[str] = "toy_finder"


def build(*of_what: Any) -> PathFinder:
    finder = PLANAR.build(*of_what)
    finder.name = ToyFinderConfig.kind
    return finder


TOY_FINDER = PathFinderKind(name="toy_finder", config=ToyFinderConfig, build=build, is_exact=True)
