"""Which models of a library come near enough to an instance, and in which order."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from schemas.errors import InputError
from tasks.candidates.provider import NothingToOffer
from tasks.library.library import OpenLibrary
from tasks.library.search import LibraryMatch, LibraryQuery, SearchWeights
from tasks.views.crops import filling, squared

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tasks.candidates.request import CandidateRequest

MIN_FIT = 0.45
"""Below this neither the category nor size, shape and color together fit: a mug is not stood in for by a bed. Of 75 scans of 39 real models
in rooms every one reaches it with its own model (from 0.65 on) and with another of its category (from 0.50 on); where the library has
neither, one in five takes what is most like it, such as a coffee table for a dining table."""

MIN_UNNAMED_FIT = 0.55
"""The same where nobody knows what the instance is, of size, shape and color alone: 71 of these 75 reach it with their own model, and six
take another where that is withheld."""

MOST = 10
"""Models that are ranked: as many as an instance has slots."""


@dataclasses.dataclass(frozen=True)
class Retrieval:
    """How a library is searched. encoder: Folder of the CLIP or SigLIP that its vectors are of; '' compares none."""

    library: OpenLibrary
    weights: SearchWeights
    encoder: str = ""

    @property
    def notes(self) -> tuple[str, ...]:
        """What is odd about the library, a line each.

        Raises:
            InputError: the encoder is another than that of the library, or cannot be used.
        """
        made = tuple(f"library: {note}" for note in self.library.notes)
        if not self.encoder:
            unused = ("library: has vectors, which are compared where candidates.encoder names the folder of their model",)
            return made + unused if self.library.weights else made
        from tasks.selection.methods.encoders import weights_digest

        mine = weights_digest(self.encoder)
        if self.library.search.files and mine != self.library.weights:
            held = f"by the model {self.library.weights[:12]}" if self.library.weights else "without one"
            problem = f"is the model {mine[:12]}, the library was indexed {held}"
            raise InputError("candidates", "encoder", problem, "name the folder that `metascenes library add --weights` was given")
        return made

    def ranking(self, request: CandidateRequest) -> list[LibraryMatch]:
        """The models that come near enough to an instance, best first."""
        query = LibraryQuery.of(request.category, request.descriptor, request.points[0], request.rng("search"))
        if self.encoder:
            text, image = self._vectors(request)
            query = dataclasses.replace(query, text=text, image=image)
        search = self.library.search
        least = MIN_FIT if search.names(request.category) else MIN_UNNAMED_FIT
        return [match for match in search.find(query, MOST, self.weights) if match.fit >= least]

    def _vectors(self, request: CandidateRequest) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Vectors of the caption, shape (d,), and of pictures of the best view, shape (m, d); None where it has none."""
        from tasks.library.embeddings import encoder_in

        encoder = encoder_in(self.encoder)
        sentence = request.caption.sentence if request.caption is not None else ""
        text = encoder.texts([sentence or f"A photo of a {request.category}."])[0]
        try:
            view = request.view
        except InputError as error:
            raise NothingToOffer(f"the picture of the instance cannot be read: {error}") from error
        if view is None:
            return text, None
        pictures = [squared(view.image, encoder.side)]
        if view.silhouette is not None:
            pictures.append(filling(view.image, view.silhouette, encoder.side))
        return text, encoder.images(np.stack(pictures))
