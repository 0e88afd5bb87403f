"""The k-th best model of a library, one of the lake or a folder."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, ClassVar

from tasks.candidates.assets import MadeAsset
from tasks.candidates.provider import CandidateProvider, NothingToOffer
from tasks.settings import Config, Whole

if TYPE_CHECKING:
    from tasks.candidates.request import CandidateRequest


@dataclasses.dataclass(frozen=True)
class LibraryRetrieval(Config):
    """The k-th best model of a library by category, size, shape, color and how well the scan lies on it."""

    kind: ClassVar[str] = "library"
    k: Whole = 1  # place in the order of scores, 1 is best
    version: str = "3"  # goes up when the same library would answer otherwise


def _offer(request: CandidateRequest, provider: LibraryRetrieval) -> MadeAsset:
    """The k-th best asset for an instance."""
    if request.retrieval is None:
        raise NothingToOffer("no library given")
    best = request.ranking
    if len(best) < provider.k:
        raise NothingToOffer(f"only {len(best)} of the library's assets come near enough")
    library, match = request.retrieval.library, best[provider.k - 1]
    return dataclasses.replace(library.asset_of(match.file), library=library.name, library_file=match.file, library_score=match.score)


LIBRARY = CandidateProvider(name="library", config=LibraryRetrieval, offer=_offer, needs_library=True)
