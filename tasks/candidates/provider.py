"""What a candidate provider is."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

from tasks.settings import Config

if TYPE_CHECKING:
    from tasks.candidates.assets import MadeAsset
    from tasks.candidates.request import CandidateRequest


class NothingToOffer(Exception):
    """A provider has nothing for an instance: no failure, an empty slot. The text says why."""


class ProviderConfig(Protocol):
    """Settings of a provider."""

    @property
    def kind(self) -> str:
        """Name of the provider."""
        ...

    @property
    def version(self) -> str:
        """Goes up when the same instance would get another asset."""
        ...


@dataclasses.dataclass(frozen=True)
class CandidateProvider:
    """A member of the family `schemas.families.candidate_providers`: who can fill a slot.

    config: What it can be told, a `ProviderConfig`. offer: The asset for an instance, as a config says; NothingToOffer where it has
    none. label: Its name in rows, where that hangs on its config. needs_library: It has nothing without a library. draws_looks: What it
    makes for the best seen of those that look alike is the candidate of all. paints: Slot whose asset it paints, by its config; such
    slots are filled after all others. frames: Whether it does so with the scan's frames.
    """

    name: str
    config: type[Config]
    offer: Callable[[CandidateRequest, Any], MadeAsset]
    label: Callable[[Any], str] | None = None
    needs_library: bool = False
    draws_looks: bool = False
    paints: Callable[[Any], int] | None = None
    frames: Callable[[Any], bool] | None = None

    def row_name(self, config: ProviderConfig) -> str:
        """The provider as rows name it."""
        return self.label(config) if self.label is not None else self.name

    def needs_frames(self, config: ProviderConfig) -> bool:
        """Whether it has nothing without the scan's frames."""
        return self.frames is not None and self.frames(config)

    def twin_of(self, config: ProviderConfig) -> int | None:
        """The slot whose asset it paints; None where it paints none."""
        return None if self.paints is None else self.paints(config)
