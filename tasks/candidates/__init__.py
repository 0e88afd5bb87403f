"""Candidates: ten slots of assets that could stand in for an instance.

Slots are filled by the furniture generator, by the scan's own geometry and by a library. A learned provider is
a further member of the family `tasks.candidates.providers`. Twins of other slots' assets are made when these are filled, and alone need
the scan.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TypeGuard

from schemas.candidates import Asset, Candidate, TextureCharts
from schemas.captions import Caption
from schemas.capture import Frame, Instance, Mask
from schemas.errors import LakeError
from schemas.record import check
from schemas.text import one_line
from tasks.calls.exchange import EndpointAway
from tasks.calls.ledger import NoFurtherCall
from tasks.candidates.assets import MadeAsset
from tasks.candidates.generation.generated import GeneratorSettings
from tasks.candidates.looks import exemplars
from tasks.candidates.parametric import Parametric
from tasks.candidates.provider import NothingToOffer, ProviderConfig
from tasks.candidates.providers import provider_of
from tasks.candidates.request import CandidateRequest
from tasks.candidates.retrieval import Retrieval
from tasks.candidates.scan_crop import ScanCrop
from tasks.candidates.slots import DEFAULT_SLOTS, SlotConfig, Slots
from tasks.capture.scan import Scan
from tasks.library.library import OpenLibrary
from tasks.library.search import SearchWeights
from tasks.settings import Config
from tasks.stage import Blobs, Context, Outcome, Stage
from tasks.texturing.sightings import sightings
from tasks.texturing.views import ColorView, ViewsConfig
from tasks.views.sightlines import DepthMap, scene_depth_maps


@dataclasses.dataclass(frozen=True)
class CandidatesConfig(Config):
    """Who offers candidates."""

    slots: Slots = DEFAULT_SLOTS  # ten, as the paper gives annotators ten candidates
    search: SearchWeights = dataclasses.field(default_factory=SearchWeights)  # by rooms that real models were scanned in
    encoder: str = ""  # folder of the CLIP or SigLIP that a library was indexed with; without one no vectors are compared
    views: ViewsConfig = dataclasses.field(default_factory=ViewsConfig)  # of frames, for twins that are painted with them
    withheld: bool = False  # leaves out the half of the templates that furnishes wild rooms, so that none is its own stand-in there

    def __post_init__(self) -> None:
        super().__post_init__()
        for number, slot in enumerate(self.slots, start=1):
            of = twin_of(slot)
            if of is not None and (of > len(self.slots) or twin_of(self.slots[of - 1]) is not None):
                problem = "is a twin itself" if of <= len(self.slots) else "does not exist"
                raise ValueError(f"slots.{number - 1}: is the twin of slot {of}, which {problem}")


def twin_of(slot: SlotConfig) -> int | None:
    """The slot whose asset a slot's provider paints; None where it paints none."""
    return provider_of(slot.provider).twin_of(slot.provider)


def run(
    *, instances: list[Instance], frames: list[Frame], masks: list[Mask], captions: list[Caption], library: OpenLibrary | Path | None,
    scan: Scan | None, context: Context, config: CandidatesConfig,
) -> Outcome:  # fmt: skip
    """Candidates of every instance that is no structure, and their assets. Without the scan, twins that need its frames are empty slots."""
    retrieval = _retrieval(library, context, config)
    problems = list(retrieval.notes) if retrieval is not None else []
    if retrieval is None and any(provider_of(slot.provider).needs_library for slot in config.slots):
        problems.append("no library given: its slots are filled by the furniture generator and flagged as fallback")
    by_instance = {caption.instance_id: caption for caption in captions}
    objects = sorted((row for row in instances if not row.is_structure), key=lambda row: row.instance_id)
    looks = exemplars(objects, by_instance)
    groups: dict[str, list[Instance]] = {}
    for row in objects:  # what looks alike is of one part, which makes what they share once
        groups.setdefault(looks.get(row.instance_id, row.instance_id), []).append(row)
    dealt = [[row for group in list(groups.values())[k::PARTS] for row in group] for k in range(PARTS)]
    best = {row.instance_id: row.best_frames[0] for row in objects if row.best_frames}
    seen = {frame.frame_id: frame for frame in frames}
    best_views = {mask.instance_id: (seen.get(mask.frame_id), mask) for mask in masks if best.get(mask.instance_id) == mask.frame_id}
    views, unseen, unread = sightings(scan, frames, objects, context.blobs, config.views) if scan_wanted(config) else ({}, "", [])
    problems += unread + ([f"no textured twins: {unseen}"] if unseen else [])
    sightlines = scene_depth_maps(frames, instances, context.blobs) if any(isinstance(s.provider, ScanCrop) for s in config.slots) else []
    parts = [
        _Part(
            own, by_instance, objects, looks, best_views, {row.instance_id: views.get(row.instance_id, ()) for row in own}, unseen,
            retrieval, _context_of(own, context), config, sightlines,
        )
        for own in dealt
    ]  # fmt: skip
    filled = {name: slots for part in context.spread(_filled, [part for part in parts if part.own]) for name, slots in part.items()}
    candidates: list[Candidate] = []
    assets: dict[str, Asset] = {}
    charts: dict[str, TextureCharts] = {}
    blobs = Blobs()
    for instance in objects:
        for candidate, made in filled[instance.instance_id]:
            candidates.append(candidate)
            if made is not None:
                assets.setdefault(made.asset.asset_id, made.asset)
                if made.charts is not None:
                    charts.setdefault(made.asset.asset_id, made.charts)
                blobs.update(made.files)
            if candidate.outcome == "failed":
                problems.append(f"{instance.instance_id} {instance.category}: slot {candidate.slot} failed: {candidate.reason}")
    return Outcome(
        candidates=candidates, assets=[assets[key] for key in sorted(assets)], texture_charts=[charts[key] for key in sorted(charts)],
        blobs=blobs, degradations=problems,
    )  # fmt: skip


def scan_wanted(config: CandidatesConfig) -> bool:
    """Whether a slot asks for what the scan's frames show."""
    return any(provider_of(slot.provider).needs_frames(slot.provider) for slot in config.slots)


def _retrieval(library: OpenLibrary | Path | None, context: Context, config: CandidatesConfig) -> Retrieval | None:
    """How a library is searched; a folder is indexed, as far as this machine does not remember its files."""
    if isinstance(library, Path):
        # Here, since indexing makes assets, which are of this package.
        from tasks.library.folder import library_in
        from tasks.library.indexing import IndexConfig

        indexed = IndexConfig(weights=config.encoder)
        library = library_in(library, indexed, context.caches["tasks.library.indexing"], context.spread)
    return Retrieval(library, config.search, config.encoder) if library is not None else None


PARTS = 32
"""Parts that a scene's objects are dealt out to, for as many cores as there are: small enough that none is waited for long at the end."""

Slotted = list[tuple[Candidate, MadeAsset | None]]


@dataclasses.dataclass(frozen=True)
class _Part:
    """Objects of a scene, `own`, with all that their slots are filled from; may go to another process. looks: of those that look alike,
    which one stands for all. best: Frame and mask of the best view of each, as far as they are known. views: Frames that show each of its
    own, and unseen, why there are none. sightlines: Depth maps of the scan."""

    own: Sequence[Instance]
    captions: Mapping[str, Caption]
    objects: Sequence[Instance]
    looks: Mapping[str, str]
    best: Mapping[str, tuple[Frame | None, Mask]]
    views: Mapping[str, Sequence[ColorView]]
    unseen: str
    retrieval: Retrieval | None
    context: Context
    config: CandidatesConfig
    sightlines: Sequence[DepthMap]


def _context_of(objects: Sequence[Instance], context: Context) -> Context:
    """The context with the blobs of some objects alone, and nothing of this process."""
    of_rows = {name for row in objects for name in (row.points_blob, row.mesh_blob, row.view_blob) if name is not None}
    blobs = {name: context.blobs[name] for name in sorted(of_rows) if name in context.blobs}
    return Context(context.scene_id, context.stage, context.seed, blobs, ledger=context.ledger)


def _filled(part: _Part) -> dict[str, Slotted]:
    """The slots of a part's own objects, by instance."""
    requests = {}
    for row in part.own:
        frame, mask = part.best.get(row.instance_id, (None, None))
        requests[row.instance_id] = CandidateRequest(
            row, part.captions.get(row.instance_id), part.context, part.retrieval, part.objects, frame, mask,
            part.views[row.instance_id], part.unseen, part.sightlines, is_withholding=part.config.withheld,
        )  # fmt: skip
    filled: dict[str, Slotted] = {}
    fitted: dict[str, MadeAsset] = {}
    # who stands for a look goes first
    for name in sorted(requests, key=lambda name: (part.looks.get(name) != name, name)):
        lender = requests[part.looks.get(name, name)]
        plain = [(number, slot) for number, slot in enumerate(part.config.slots, start=1) if twin_of(slot) is None]
        filled[name] = [_fill(number, slot, requests[name], lender) for number, slot in plain]
        if lender is not requests[name]:
            filled[name] = _with_lent(filled[name], fitted.get(lender.instance.instance_id), lender)
        elif name in part.looks:
            fits = [made for row, made in filled[name] if made is not None and row.provider == Parametric.kind]
            if fits:
                fitted[name] = fits[0]
    return {name: _with_twins(slots, part.config.slots, requests[name]) for name, slots in filled.items()}


def _with_twins(filled: Slotted, slots: Slots, request: CandidateRequest) -> Slotted:
    """The slots of an instance with those that paint others of them, in their order."""
    request.filled.update({row.slot: made for row, made in filled if made is not None})
    twins = [(number, slot) for number, slot in enumerate(slots, start=1) if twin_of(slot) is not None]
    return sorted([*filled, *(_fill(number, slot, request, request) for number, slot in twins)], key=lambda each: each[0].slot)


def _with_lent(slots: Slotted, lent: MadeAsset | None, lender: CandidateRequest) -> Slotted:
    """The slots of an instance with the template that was fitted to another one which looks like it, in place of the last that is filled
    for want of something better; as they are where there is none."""
    places = [k for k, (row, _) in enumerate(slots) if row.is_fallback and row.outcome == "filled"]
    if lent is None or not places:
        return slots
    row, _ = slots[places[-1]]
    reason = f"fitted to {lender.instance.instance_id}, which looks like it; {row.reason}"
    provider = dataclasses.replace(
        row, provider=Parametric.kind, provider_version=Parametric.version, reason=reason, asset_id=lent.asset.asset_id
    )
    return [*slots[: places[-1]], (provider, lent), *slots[places[-1] + 1 :]]


def _fill(number: int, slot: SlotConfig, request: CandidateRequest, lender: CandidateRequest) -> tuple[Candidate, MadeAsset | None]:
    """What a slot holds after its provider was asked, and its fallback where that has nothing. lender: the request of who stands for
    the instance's look."""
    candidate, made = _attempt(number, slot.provider, request, lender)
    may_fail = is_generator(slot.provider) or twin_of(slot) is not None
    is_left = candidate.outcome == "empty" or (candidate.outcome == "failed" and may_fail)
    if not is_left or slot.fallback is None:
        return candidate, made
    candidate, made = _attempt(number, slot.fallback, request, lender, instead=candidate.reason)
    return dataclasses.replace(candidate, twin_of=twin_of(slot)), made


def _attempt(
    number: int, provider: ProviderConfig, request: CandidateRequest, lender: CandidateRequest, instead: str | None = None
) -> tuple[Candidate, MadeAsset | None]:
    """What one provider puts into a slot. `instead`: why the slot's own provider did not, when this is the fallback."""
    is_fallback = instead is not None
    clock = time.perf_counter()
    try:
        family = provider_of(provider)
        made = lender.drawn.get(provider) if family.draws_looks else None
        if made is None:
            made = family.offer(lender if family.draws_looks else request, provider)
            # A value that a table refuses leaves this slot out, not the whole scene.
            check([made.asset], Asset)
            check([made.charts] if made.charts is not None else [], TextureCharts)
        filled = _row(number, provider, request, outcome="filled", reason=instead, is_fallback=is_fallback, asset_id=made.asset.asset_id)
        row = dataclasses.replace(
            filled,
            call_id=made.call_id,
            library=made.library,
            library_file=made.library_file,
            library_score=made.library_score,
            seen_share=made.seen_share,
            seconds=time.perf_counter() - clock,
        )
        check([row], Candidate)
        if family.draws_looks:
            lender.drawn[provider] = made
    except NothingToOffer as nothing:
        return _row(number, provider, request, outcome="empty", reason=str(nothing), is_fallback=is_fallback), None
    except EndpointAway as away:
        if is_generator(provider) and provider.away == "retry":
            raise
        return _row(number, provider, request, outcome="empty", reason=str(away)[:300], is_fallback=is_fallback), None
    except (NoFurtherCall, ConnectionError, TimeoutError):  # of the ledger or the lake: nobody's fault, and the next run goes on
        raise
    except Exception as error:  # one slot of one instance never stops the others; the row tells what happened
        is_stated = isinstance(error, LakeError | ValueError)
        text = (one_line(error) if is_stated else f"cannot be computed: {one_line(error) or 'no reason given'}")[:300]
        return _row(number, provider, request, outcome="failed", reason=text, is_fallback=is_fallback), None
    return row, made


def is_generator(provider: ProviderConfig) -> TypeGuard[GeneratorSettings]:
    """Whether a provider asks a generator, which may fail today and not tomorrow."""
    return isinstance(provider, GeneratorSettings)


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
        seed=getattr(provider, "seed", None),
        call_id=None,
        library=None,
        library_file=None,
        library_score=None,
        twin_of=provider_of(provider).twin_of(provider),
        seen_share=None,
        seconds=None,
    )


STAGE = Stage(
    name="candidates",
    reads=("instances", "frames", "masks", "captions"),
    writes=("candidates", "assets", "texture_charts"),
    config=CandidatesConfig,
    run=run,
    outside=("library", "scan"),
    scan_wanted=scan_wanted,
)

__all__ = [
    "DEFAULT_SLOTS",
    "STAGE",
    "CandidatesConfig",
    "SlotConfig",
    "run",
]
