"""Candidates of the furniture generator: a model of the category in the instance's size and color."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, ClassVar

from tasks.candidates.assets import MadeAsset, make_asset
from tasks.candidates.provider import CandidateProvider, NothingToOffer
from tasks.captions.physics import known_name
from tasks.settings import Config, Whole

if TYPE_CHECKING:
    from tasks.candidates.request import CandidateRequest
    from tasks.furniture.halves import Half

SQUARE = 1.15
"""A box whose horizontal sides differ by less than this ratio has no long side that could tell front from side."""


@dataclasses.dataclass(frozen=True)
class Procedural(Config):
    """The furniture generator, fitted to the instance's box and colored as its caption says."""

    kind: ClassVar[str] = "procedural"
    variant: Whole = 1  # others draw other styles (slats or panel, legs or pedestal)
    version: str = "3"  # goes up when the same instance would get another model


def procedural_asset(request: CandidateRequest, provider: Procedural) -> MadeAsset:
    """The generator's model for an instance.

    Raises:
        NothingToOffer: the category has no template but one that is withheld.
    """
    from tasks.furniture import canonical_category, generate
    from tasks.furniture.halves import TemplateWithheld
    from tasks.furniture.storage import FRONTED

    category = generator_category(request.category)
    extents = fronted_extents(category, request.extents)
    rng = request.context.rng(provider.kind, request.instance.instance_id, provider.variant)
    half: Half = "offered" if request.is_withholding else "all"
    is_plain = canonical_category(category) in FRONTED and request.has_plain_front
    try:
        model = generate(category, extents, rng, color=request.color, half=half, has_plain_front=is_plain)
    except TemplateWithheld as problem:
        raise NothingToOffer(str(problem)) from problem
    return make_asset(
        model.parts,
        provider=provider.kind,
        name=model.name,
        category=model.category,
        source="furniture generator",
        license="CC0-1.0",
        pieces=model.hulls,
    )


def generator_category(category: str) -> str:
    """The generator's word for a category: itself, else the table's name for it, else itself for the generic shapes."""
    from tasks.furniture import is_known

    if is_known(category):
        return category
    name = known_name(category)
    return name if name is not None and is_known(name) else category


def fronted_extents(category: str, extents: tuple[float, float, float]) -> tuple[float, float, float]:
    """Extents (x, y, z) [m] of a box with x and y swapped where that lays the long side as the category has it.

    The box of an instance does not know its front; models have theirs at +X. A sofa is wider (y) than deep (x): a box
    that is longer along x is a sofa that looks along y. Selection finds the yaw that goes with it.
    """
    from tasks.furniture import typical_extents

    x, y, z = extents
    typical_x, typical_y, _ = typical_extents(category)
    long = max(x, y) > SQUARE * min(x, y) and max(typical_x, typical_y) > SQUARE * min(typical_x, typical_y)
    return (y, x, z) if long and (x > y) != (typical_x > typical_y) else extents


PROCEDURAL = CandidateProvider(name="procedural", config=Procedural, offer=procedural_asset, draws_looks=True)
