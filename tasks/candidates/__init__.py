"""Candidates: ten slots of assets that could stand in for an instance.

Slots are filled by the furniture generator, by the scan's own geometry and by a library folder. A learned provider is
a further member of the family `tasks.candidates.providers`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance
from tasks.candidates.assets import MadeAsset
from tasks.candidates.library import LibraryIndex, index_library, library_files
from tasks.candidates.provider import NothingToOffer, ProviderConfig
from tasks.candidates.providers import provider_of
from tasks.candidates.request import CandidateRequest
from tasks.candidates.slots import DEFAULT_SLOTS, SlotConfig, Slots
from tasks.settings import Config
from tasks.stage import Blobs, Context, Outcome, Stage


@dataclasses.dataclass(frozen=True)
class CandidatesConfig(Config):
    """Who offers candidates."""

    slots: Slots = DEFAULT_SLOTS  # ten, as the paper gives annotators ten candidates


def run(*, instances: list[Instance], captions: list[Caption], library: Path | None, context: Context, config: CandidatesConfig) -> Outcome:
    """Candidates of every instance that is no structure, and their assets."""
    index = index_library(library) if library is not None else None
    problems = list(index.problems) if index is not None else []
    if index is None and any(provider_of(slot.provider).needs_library for slot in config.slots):
        problems.append("no library given: its slots are filled by the furniture generator and flagged as fallback")
    by_instance = {caption.instance_id: caption for caption in captions}
    objects = sorted((row for row in instances if not row.is_structure), key=lambda row: row.instance_id)
    parts = [_Part(objects[k::PARTS], by_instance, objects, index, _context_of(objects[k::PARTS], context), config) for k in range(PARTS)]
    filled = {name: slots for part in context.spread(_filled, [part for part in parts if part.own]) for name, slots in part.items()}
    candidates: list[Candidate] = []
    assets: dict[str, Asset] = {}
    blobs = Blobs()
    for instance in objects:
        for candidate, made in filled[instance.instance_id]:
            candidates.append(candidate)
            if made is not None:
                assets.setdefault(made.asset.asset_id, made.asset)
                blobs.update(made.files)
            if candidate.outcome == "failed":
                problems.append(f"{instance.instance_id} {instance.category}: slot {candidate.slot} failed: {candidate.reason}")
    return Outcome(candidates=candidates, assets=[assets[key] for key in sorted(assets)], blobs=blobs, degradations=problems)


PARTS = 8
"""Parts that a scene's objects are dealt out to, for as many cores as there are: few enough that what all share may go with each."""

Slotted = list[tuple[Candidate, MadeAsset | None]]


@dataclasses.dataclass(frozen=True)
class _Part:
    """Objects of a scene, `own`, with all that their slots are filled from; may go to another process."""

    own: Sequence[Instance]
    captions: Mapping[str, Caption]
    objects: Sequence[Instance]
    library: LibraryIndex | None
    context: Context
    config: CandidatesConfig


def _context_of(objects: Sequence[Instance], context: Context) -> Context:
    """The context with the blobs of some objects alone, and nothing of this process."""
    names = {name for row in objects for name in (row.points_blob, row.mesh_blob) if name is not None and name in context.blobs}
    return Context(context.scene_id, context.stage, context.seed, {name: context.blobs[name] for name in sorted(names)})


def _filled(part: _Part) -> dict[str, Slotted]:
    """The slots of a part's own objects, by instance."""
    filled: dict[str, Slotted] = {}
    for instance in part.own:
        request = CandidateRequest(instance, part.captions.get(instance.instance_id), part.context, part.library, part.objects)
        filled[instance.instance_id] = [_fill(number, slot, request) for number, slot in enumerate(part.config.slots, start=1)]
    return filled


def _fill(number: int, slot: SlotConfig, request: CandidateRequest) -> tuple[Candidate, MadeAsset | None]:
    """What a slot holds after its provider was asked, and its fallback where that has nothing."""
    candidate, made = _attempt(number, slot.provider, request)
    if candidate.outcome != "empty" or slot.fallback is None:
        return candidate, made
    return _attempt(number, slot.fallback, request, instead=candidate.reason)


def _attempt(
    number: int, provider: ProviderConfig, request: CandidateRequest, instead: str | None = None
) -> tuple[Candidate, MadeAsset | None]:
    """What one provider puts into a slot. `instead`: why the slot's own provider did not, when this is the fallback."""
    is_fallback = instead is not None
    try:
        made = provider_of(provider).offer(request, provider)
    except NothingToOffer as nothing:
        return _row(number, provider, request, outcome="empty", reason=str(nothing), is_fallback=is_fallback), None
    except Exception as error:  # one slot of one instance never stops the others; the row tells what happened
        text = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        return _row(number, provider, request, outcome="failed", reason=text, is_fallback=is_fallback), None
    row = _row(number, provider, request, outcome="filled", reason=instead, is_fallback=is_fallback, asset_id=made.asset.asset_id)
    return row, made


def _row(
    number: int,
    provider: ProviderConfig,
    request: CandidateRequest,
    *,
    outcome: str,
    reason: str | None,
    is_fallback: bool = False,
    asset_id: str | None = None,
) -> Candidate:
    return Candidate(
        scene_id=request.context.scene_id,
        instance_id=request.instance.instance_id,
        slot=number,
        provider=provider_of(provider).row_name(provider),
        provider_version=provider.version,
        is_fallback=is_fallback,
        outcome=outcome,
        reason=reason,
        asset_id=asset_id,
    )


STAGE = Stage(
    name="candidates",
    reads=("instances", "captions"),
    writes=("candidates", "assets"),
    config=CandidatesConfig,
    run=run,
    outside=("library",),
)

__all__ = [
    "DEFAULT_SLOTS",
    "STAGE",
    "CandidatesConfig",
    "SlotConfig",
    "index_library",
    "library_files",
    "run",
]
