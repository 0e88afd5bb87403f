"""What an alignment method is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from tasks.settings import Config

if TYPE_CHECKING:
    from tasks.alignment.configuration import AlignmentConfig
    from tasks.alignment.samples import Fit, Sample
    from tasks.alignment.targets import ScannedInstance


class AlignmentMethodConfig(Protocol):
    """Settings of a method."""

    @property
    def kind(self) -> str:
        """Name of the method."""
        ...


def nothing(target: ScannedInstance, config: Any) -> str | None:
    """What is lacked by a method that wants nothing but points."""
    return None


@dataclasses.dataclass(frozen=True)
class AlignmentMethod:
    """A member of the family `schemas.families.alignment_methods`: how the pose of an asset on an instance is found.

    config: What it can be told. pose: The pose of a sampled asset on an instance; points within the threshold [m] count as covered. lacks:
    What of an instance the method wants and does not find, and what it does without; None where all is there. reads_surface: Whether it
    takes an asset's triangles beside the samples of them. reads_sight: Whether it goes by how the instance's crop was taken, where that
    is known.
    """

    name: str
    config: type[Config]
    pose: Callable[[ScannedInstance, Sample, float, AlignmentConfig, Any], Fit]
    lacks: Callable[[ScannedInstance, Any], str | None] = nothing
    reads_surface: bool = False
    reads_sight: bool = False
