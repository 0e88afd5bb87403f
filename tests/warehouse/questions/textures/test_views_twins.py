"""The views of textured twins and of layouts of textures, each against a computation of its own."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.annotation import Annotation, QualityReview
from schemas.candidates import Candidate, TextureCharts
from schemas.selection import Selection
from tests.samples import START, fingerprint, sample
from tests.warehouse.questions.view_answers import EXACT, INSTANCES, SCENES, Database, by_key, of, quick, same


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


def asset(*words: object) -> str:
    return fingerprint("asset", "/".join(map(str, words)))


PAINTERS = ("textured:xatlas", "textured:smart_uv")


@st.composite
def lineups(draw: st.DrawFn) -> list[Any]:
    """Instances with a plain candidate, two twins of it, and a further one; ranked, and chosen by somebody."""
    rows: list[Any] = [sample(QualityReview, batch_id="b", verdict="accepted", wrong=0)]
    for scene in SCENES[:2]:
        for instance in draw(st.lists(st.sampled_from(INSTANCES), unique=True)):
            place = {"scene_id": scene, "instance_id": instance}
            plain = draw(st.sampled_from(["procedural", "scan_crop_closed"]))
            there = {}
            for slot, provider in enumerate((plain, *PAINTERS, "library"), start=1):
                outcome = draw(st.sampled_from(["filled", "filled", "empty"]))
                is_twin = provider in PAINTERS
                is_fallback = is_twin and outcome == "filled" and draw(st.booleans())
                if outcome == "filled":
                    there[slot] = asset(scene, instance, slot)
                rows.append(
                    sample(
                        Candidate, **place, slot=slot, provider="procedural" if is_fallback else provider, outcome=outcome,
                        is_fallback=is_fallback, asset_id=there.get(slot), twin_of=1 if is_twin else None,
                        seen_share=draw(EXACT) / 10 if is_twin and outcome == "filled" and not is_fallback else None,
                    )
                )  # fmt: skip
            ranked = draw(st.permutations(sorted(there)))[: draw(st.integers(0, 4))]
            rows += [sample(Selection, **place, rank=k, slot=slot, asset_id=there[slot]) for k, slot in enumerate(ranked, start=1)]
            if there and draw(st.booleans()):
                choice = draw(st.sampled_from([None, *there.values()]))
                rows.append(sample(Annotation, **place, batch_id="b", annotator="ann", answered_at=START, choice=choice))
    return rows


@pytest.mark.whole
@quick
@given(rows=lineups())
def test_twins_against_their_siblings(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    held = {(c.scene_id, c.instance_id, c.slot): c for c in of(rows, Candidate)}
    rank = {(s.scene_id, s.instance_id, s.slot): s.rank for s in of(rows, Selection)}
    chosen = {(a.scene_id, a.instance_id): a.choice for a in of(rows, Annotation)}
    groups: dict[tuple[str | None, str], list[Candidate]] = defaultdict(list)
    for key, row in held.items():
        plain = held.get((*key[:2], row.twin_of or 0))
        if plain is not None and plain.outcome == "filled":
            groups[None if row.is_fallback else row.provider, plain.provider].append(row)
    answer = by_key(database.ask("twin_wins"), "painter", "plain_provider")
    assert answer.keys() == groups.keys()
    for (painter, plain_provider), group in groups.items():
        painted = [c for c in group if c.outcome == "filled" and not c.is_fallback]
        pairs = [(rank.get((c.scene_id, c.instance_id, c.slot)), rank.get((c.scene_id, c.instance_id, 1)), c) for c in painted]
        compared = [(twin, plain) for twin, plain, _ in pairs if twin is not None and plain is not None]
        above = sum(twin < plain for twin, plain in compared)
        siblings = [held[c.scene_id, c.instance_id, 1] for c in painted]
        same(
            answer[painter, plain_provider], twins=len(group), painted=len(painted), compared=len(compared), above=above,
            above_share=above / len(compared) if compared else None, chosen=sum(twin == 1 for twin, _, _ in pairs),
            plain_chosen=sum(plain == 1 for _, plain, _ in pairs),
            mean_seen_share=float(np.mean([c.seen_share for c in painted])) if painted else None,
            people_chose=sum(chosen.get((c.scene_id, c.instance_id)) == c.asset_id for c in painted),
            people_chose_plain=sum(chosen.get((c.scene_id, c.instance_id)) == c.asset_id for c in siblings),
        )  # fmt: skip


@st.composite
def layouts(draw: st.DrawFn) -> list[TextureCharts]:
    """Layouts by three methods of some assets, several times by some; and some that came with models."""
    made = []
    for number, plain in enumerate(draw(st.lists(st.sampled_from("abcde"), max_size=12))):
        method = draw(st.sampled_from(["xatlas", "smart_uv", "painter", "source"]))
        made.append(
            sample(
                TextureCharts, asset_id=asset(number), of_asset_id=None if method == "source" else asset(plain), method=method,
                made_by=None if method == "source" else f"{method} {draw(st.integers(1, 2))}", charts=draw(st.integers(1, 9)),
                faces=draw(st.integers(1, 64)), coverage=draw(st.integers(0, 64)) / 64,
                angle_distortion_radians=draw(st.integers(0, 64)) / 64, overlap_share=draw(st.integers(0, 64)) / 64,
                stretch_l2=1 + draw(EXACT), seconds=None if method == "source" else draw(EXACT),
            )
        )  # fmt: skip
    return made


@pytest.mark.whole
@quick
@given(rows=layouts())
def test_layouts_by_method_and_side_by_side(database: Database, rows: list[TextureCharts]) -> None:
    database.fill(*rows)
    groups: dict[tuple[str, str | None], list[TextureCharts]] = defaultdict(list)
    laid: dict[str, dict[str, list[TextureCharts]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        groups[row.method, row.made_by].append(row)
        if row.of_asset_id is not None:
            laid[row.method][row.of_asset_id].append(row)
    answer = by_key(database.ask("texture_layouts"), "method", "made_by")
    assert answer.keys() == groups.keys()
    for key, group in groups.items():
        seconds = [row.seconds for row in group if row.seconds is not None]
        same(
            answer[key], assets=len(group), median_charts=float(np.median([row.charts for row in group])),
            median_faces=float(np.median([row.faces for row in group])),
            mean_overlap_share=float(np.mean([row.overlap_share for row in group])),
            median_angle_distortion_degrees=math.degrees(np.median([row.angle_distortion_radians for row in group])),
            median_coverage=float(np.median([row.coverage for row in group])),
            median_seconds=float(np.median(seconds)) if seconds else None,
        )  # fmt: skip
    pairs = by_key(database.ask("chart_comparison"), "method", "other_method")
    expected = {(a, b) for a in laid for b in laid if a != b and laid[a].keys() & laid[b].keys()}
    assert pairs.keys() == expected
    for a, b in expected:
        both = sorted(laid[a].keys() & laid[b].keys())
        fewest = [tuple(min(row.charts for row in laid[of][name]) for of in (a, b)) for name in both]
        widest = [tuple(max(row.coverage for row in laid[of][name]) for of in (a, b)) for name in both]
        truest = [tuple(min(row.stretch_l2 for row in laid[of][name]) for of in (a, b)) for name in both]
        same(
            pairs[a, b], assets=len(both), fewer=sum(x < y for x, y in fewest), same=sum(x == y for x, y in fewest),
            more=sum(x > y for x, y in fewest), median_chart_ratio=float(np.median([x / y for x, y in fewest])),
            tighter=sum(x > y for x, y in widest), truer=sum(x < y for x, y in truest),
        )  # fmt: skip
