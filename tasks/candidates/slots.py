"""The ten slots of an instance and who fills each."""

from __future__ import annotations

import dataclasses
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from tasks.settings import LISTED, ByKind, Config, Whole


@dataclasses.dataclass(frozen=True)
class Procedural(Config):
    """The furniture generator, fitted to the instance's box and colored as its caption says."""

    kind: ClassVar[str] = "procedural"
    variant: Whole = 1  # others draw other styles (slats or panel, legs or pedestal)
    version: str = "1"  # goes up when the same instance would get another model


@dataclasses.dataclass(frozen=True)
class ScanCrop(Config):
    """Geometry of the scan itself, cropped and closed."""

    kind: ClassVar[str] = "scan_crop"
    mode: Literal["closed", "pieces"] = "closed"  # the scanned surface closed to a solid, or a few convex pieces that stand for it
    version: str = "1"  # goes up when the same scan would give another solid


@dataclasses.dataclass(frozen=True)
class LibraryRetrieval(Config):
    """The k-th best asset of a library folder by category, extents, shape and color."""

    kind: ClassVar[str] = "library"
    k: Whole = 1  # place in the order of scores, 1 is best
    version: str = "1"  # goes up when the same library would answer otherwise


Provider = Annotated[Procedural | ScanCrop | LibraryRetrieval, ByKind()]
"""Whoever can fill a slot: a union of frozen configs, matched by type."""


def provider_name(provider: Provider) -> str:
    """Name of a provider as rows have it."""
    match provider:
        case Procedural():
            return "procedural"
        case ScanCrop(mode=mode):
            return f"scan_crop_{mode}"
        case LibraryRetrieval():
            return "library"


@dataclasses.dataclass(frozen=True)
class SlotConfig(Config):
    """A slot's provider, and who fills it, flagged, when that provider is not there (no library given) or has nothing."""

    provider: Provider
    fallback: Procedural | None = None  # without one, the slot stays empty


Slots = Annotated[tuple[SlotConfig, ...], LISTED, Field(min_length=1, max_length=10)]

DEFAULT_SLOTS: tuple[SlotConfig, ...] = (
    *(SlotConfig(Procedural(variant)) for variant in (1, 2, 3, 4)),
    SlotConfig(ScanCrop("closed")),
    SlotConfig(ScanCrop("pieces")),
    *(SlotConfig(LibraryRetrieval(k), fallback=Procedural(4 + k)) for k in (1, 2, 3, 4)),
)
"""Four styles of the generator, two solids of the scan, four assets of the library; where the library
has none, more styles, flagged as fallback."""
