"""Candidates: ten slots of assets that could stand in for an instance.

Slots are filled by the furniture generator, by the scan's own geometry and by a library folder. A learned provider is
a further member of `tasks.candidates.slots.Provider`, matched by its type in `_fill`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path

from schemas.candidates import Asset, Candidate
from schemas.captions import Caption
from schemas.capture import Instance
from tasks.candidates.assets import MadeAsset, make_asset
from tasks.candidates.library import LibraryEntry, LibraryIndex, index_library, library_asset, library_files
from tasks.candidates.procedural import procedural_asset
from tasks.candidates.request import CandidateRequest, NothingToOffer
from tasks.candidates.retrieval import retrieve
from tasks.candidates.scan_crop import closed_crop
from tasks.candidates.slots import DEFAULT_SLOTS, LibraryRetrieval, Procedural, Provider, ScanCrop, SlotConfig, Slots, provider_name
from tasks.settings import Config
from tasks.stage import Blobs, Context, Outcome, Stage

Ranking = list[tuple[float, LibraryEntry]]


@dataclasses.dataclass(frozen=True)
class CandidatesConfig(Config):
    """Who offers candidates."""

    slots: Slots = DEFAULT_SLOTS  # ten, as the paper gives annotators ten candidates


def run(*, instances: list[Instance], captions: list[Caption], library: Path | None, context: Context, config: CandidatesConfig) -> Outcome:
    """Candidates of every instance that is no structure, and their assets."""
    index = index_library(library) if library is not None else None
    problems = list(index.problems) if index is not None else []
    if index is None and any(isinstance(slot.provider, LibraryRetrieval) for slot in config.slots):
        problems.append("no library given: its slots are filled by the furniture generator and flagged as fallback")
    by_instance = {caption.instance_id: caption for caption in captions}
    candidates: list[Candidate] = []
    assets: dict[str, Asset] = {}
    blobs = Blobs()
    for instance in sorted(instances, key=lambda row: row.instance_id):
        if instance.is_structure:
            continue
        request = CandidateRequest(instance, by_instance.get(instance.instance_id), context)
        ranking = _ranking(request, index, config)
        for number, slot in enumerate(config.slots, start=1):
            candidate, made = _fill(number, slot, request, index, ranking)
            candidates.append(candidate)
            if made is not None:
                assets.setdefault(made.asset.asset_id, made.asset)
                blobs.update(made.files)
            if candidate.outcome == "failed":
                problems.append(f"{instance.instance_id} {instance.category}: slot {number} failed: {candidate.reason}")
    return Outcome(candidates=candidates, assets=[assets[key] for key in sorted(assets)], blobs=blobs, degradations=problems)


def _ranking(request: CandidateRequest, index: LibraryIndex | None, config: CandidatesConfig) -> Callable[[], Ranking]:
    """The library's best assets for an instance, computed when a slot first asks."""
    wanted = max((slot.provider.k for slot in config.slots if isinstance(slot.provider, LibraryRetrieval)), default=0)
    kept: list[Ranking] = []

    def ranked() -> Ranking:
        if not kept:
            kept.append(retrieve(request.category, request.descriptor, index.entries if index else (), wanted))
        return kept[0]

    return ranked


def _fill(
    number: int, slot: SlotConfig, request: CandidateRequest, index: LibraryIndex | None, ranking: Callable[[], Ranking]
) -> tuple[Candidate, MadeAsset | None]:
    """What a slot holds after its provider was asked, and its fallback where the provider is not there or has nothing."""
    nothing = "no library given" if isinstance(slot.provider, LibraryRetrieval) and index is None else None
    if nothing is None:
        candidate, made = _attempt(number, slot.provider, request, ranking)
        if candidate.outcome != "empty" or slot.fallback is None:
            return candidate, made
        nothing = candidate.reason
    if slot.fallback is None:
        return _row(number, slot.provider, request, outcome="empty", reason=nothing), None
    return _attempt(number, slot.fallback, request, ranking, instead=nothing)


def _attempt(
    number: int, provider: Provider, request: CandidateRequest, ranking: Callable[[], Ranking], instead: str | None = None
) -> tuple[Candidate, MadeAsset | None]:
    """What one provider puts into a slot. `instead`: why the slot's own provider did not, when this is the fallback."""
    is_fallback = instead is not None
    try:
        made = _ask(provider, request, ranking)
    except NothingToOffer as nothing:
        return _row(number, provider, request, outcome="empty", reason=str(nothing), is_fallback=is_fallback), None
    except Exception as error:  # one slot of one instance never stops the others; the row tells what happened
        text = " ".join(f"{type(error).__name__}: {error}".split())[:300]
        return _row(number, provider, request, outcome="failed", reason=text, is_fallback=is_fallback), None
    row = _row(number, provider, request, outcome="filled", reason=instead, is_fallback=is_fallback, asset_id=made.asset.asset_id)
    return row, made


def _ask(provider: Provider, request: CandidateRequest, ranking: Callable[[], Ranking]) -> MadeAsset:
    """The asset that a provider offers.

    Raises:
        NothingToOffer: it has none for this instance.
    """
    match provider:
        case Procedural():
            return procedural_asset(request, provider)
        case ScanCrop():
            return _crop_asset(request, provider)
        case LibraryRetrieval(k=k):
            best = ranking()
            if len(best) < k:
                raise NothingToOffer(f"only {len(best)} of the library's assets come near enough")
            return library_asset(best[k - 1][1])


def _crop_asset(request: CandidateRequest, provider: ScanCrop) -> MadeAsset:
    """The asset made of the instance's own faces."""
    if request.instance.mesh_blob is None:
        raise NothingToOffer("the scan has no faces of the instance")
    surface, pieces = request.pieces  # the closed crop collides as its pieces do: they are known, and cheap
    closed = closed_crop(request.crop, request.field) if provider.mode == "closed" else None
    made = make_asset(
        [surface if closed is None else closed],
        provider=provider_name(provider),
        name=f"{request.context.scene_id} {request.instance.instance_id} {provider.mode}",
        category=request.category,
        source=f"scan {request.context.scene_id}",
        license="LicenseRef-scan",
        pieces=pieces,
    )
    if closed is None or not made.asset.is_watertight:
        return made
    return dataclasses.replace(made, asset=dataclasses.replace(made.asset, volume_m3=float(closed.volume)))


def _row(
    number: int,
    provider: Provider,
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
        provider=provider_name(provider),
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
    "LibraryRetrieval",
    "Procedural",
    "ScanCrop",
    "SlotConfig",
    "index_library",
    "library_files",
    "run",
]
