"""A candidate provider: a box of the instance's size."""

from __future__ import annotations

import dataclasses
from typing import ClassVar

from tasks.candidates.assets import MadeAsset, make_asset
from tasks.candidates.provider import CandidateProvider
from tasks.candidates.request import CandidateRequest
from tasks.settings import Config


@dataclasses.dataclass(frozen=True)
class Toy(Config):
    kind: ClassVar[str] = "toy_provider"
    version: str = "1"


def offer(request: CandidateRequest, provider: Toy) -> MadeAsset:
    import trimesh

    box = trimesh.creation.box(request.extents)
    about = {"name": "toy", "category": request.category, "source": "toys", "license": "CC0-1.0"}
    return make_asset([box], provider=provider.kind, pieces=[box], **about)


TOY_PROVIDER = CandidateProvider(name="toy_provider", config=Toy, offer=offer)
