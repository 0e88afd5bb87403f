"""The ten slots of an instance and who fills each."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from tasks.candidates.library import LibraryRetrieval
from tasks.candidates.parametric import Parametric
from tasks.candidates.procedural import Procedural
from tasks.candidates.provider import ProviderConfig
from tasks.candidates.providers import PROVIDERS
from tasks.candidates.scan_crop import ScanCrop
from tasks.settings import LISTED, ByWord, Config, union_of

if TYPE_CHECKING:
    Provider = ProviderConfig
else:
    Provider = union_of(provider.config for provider in PROVIDERS)


@dataclasses.dataclass(frozen=True)
class SlotConfig(Config):
    """A slot's provider, and who fills it, flagged, when that provider is not there (no library given) or has nothing."""

    provider: Provider
    fallback: Annotated[Procedural, ByWord()] | None = None  # without one, the slot stays empty


Slots = Annotated[tuple[SlotConfig, ...], LISTED, Field(min_length=1, max_length=10)]

DEFAULT_SLOTS: tuple[SlotConfig, ...] = (
    *(SlotConfig(Procedural(variant)) for variant in (1, 2, 3)),
    SlotConfig(Parametric(), fallback=Procedural(4)),
    SlotConfig(ScanCrop("closed")),
    SlotConfig(ScanCrop("pieces")),
    *(SlotConfig(LibraryRetrieval(k), fallback=Procedural(4 + k)) for k in (1, 2, 3, 4)),
)
"""Three styles of the generator, a template fitted to the points, two solids of the scan, four assets of the library; where no template
fits and where the library has none, more styles, flagged as fallback."""
