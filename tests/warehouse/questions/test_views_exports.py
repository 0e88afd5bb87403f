"""The views of navigation and exports, each against a computation of its own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.capture import Frame, Scene, Shell
from schemas.exports import ExportCheck, ExportFile
from schemas.navigation import Episode, Navmesh, UnreachableTarget
from tests.samples import sample
from tests.warehouse.questions.view_answers import (
    EXACT,
    INSTANCES,
    SCENES,
    Database,
    by_key,
    of,
    quick,
    same,
    scenes,
)


@pytest.fixture(scope="module")
def database() -> Iterator[Database]:
    with Database() as made:
        yield made


@st.composite
def trips(draw: st.DrawFn) -> list[Any]:
    """Navmeshes, episodes and unreachable targets of some scenes."""
    rows = draw(scenes())
    for scene in sorted({row.scene_id for row in of(rows, Scene)}):
        for agent in draw(st.lists(st.sampled_from(["stretch", "spot"]), unique=True)):
            rows.append(sample(Navmesh, scene_id=scene, agent=agent, area_m2=draw(EXACT), largest_island_m2=draw(EXACT)))
        for number in range(draw(st.integers(0, 5))):
            rows.append(
                sample(
                    Episode, scene_id=scene, episode_id=f"{number:04d}", agent=draw(st.sampled_from(["stretch", "spot"])),
                    instance_id=draw(st.sampled_from(INSTANCES)), split=draw(st.sampled_from(["train", "test"])), geodesic_m=draw(EXACT),
                    actions=("forward",) * draw(st.integers(0, 4)) + ("stop",),
                )
            )  # fmt: skip
        for target in draw(st.lists(st.sampled_from(INSTANCES), unique=True)):
            rows.append(sample(UnreachableTarget, scene_id=scene, instance_id=target))
        for number in range(draw(st.integers(0, 3))):
            pose = None if draw(st.booleans()) else tuple(np.eye(4).ravel().tolist())
            rows.append(sample(Frame, scene_id=scene, frame_id=f"{number:06d}", pose=pose))
    return rows


@pytest.mark.whole
@quick
@given(rows=trips())
def test_navigability_splits_and_capture(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    area = {row.scene_id: row.floor_area_m2 for row in of(rows, Shell)}
    answer = by_key(database.ask("navigability"), "scene_id", "agent")
    assert answer.keys() == {(row.scene_id, row.agent) for row in of(rows, Navmesh)}
    for mesh in of(rows, Navmesh):
        taken = [e for e in of(rows, Episode) if (e.scene_id, e.agent) == (mesh.scene_id, mesh.agent)]
        floor = area.get(mesh.scene_id)
        same(
            answer[mesh.scene_id, mesh.agent], episodes=len(taken), targets=len({e.instance_id for e in taken}),
            navigable_share=mesh.area_m2 / floor if floor else None,
            largest_island_share=mesh.largest_island_m2 / mesh.area_m2 if mesh.area_m2 else None,
            unreachable_targets=sum(u.scene_id == mesh.scene_id for u in of(rows, UnreachableTarget)),
        )  # fmt: skip
    reasons = [(r["scene_id"], r["instance_id"], r["reason"]) for r in database.ask("unreachable_objects")]
    assert reasons == sorted((u.scene_id, u.instance_id, u.reason) for u in of(rows, UnreachableTarget))
    for row in database.ask("episode_splits"):
        inside = [e for e in of(rows, Episode) if e.split == row["split"]]
        same(
            row, episodes=len(inside), scenes=len({e.scene_id for e in inside}), rooms=len({e.scene_id.rsplit("_", 1)[0] for e in inside}),
            median_geodesic_m=float(np.median([e.geodesic_m for e in inside])),
            mean_actions=float(np.mean([len(e.actions) for e in inside])),
        )  # fmt: skip
    for row in database.ask("capture_quality"):
        posed = sum(f.pose is not None for f in of(rows, Frame) if f.scene_id == row["scene_id"])
        assert row["posed_frames"] == posed
    scans = [r for r in database.ask("license_counts") if r["material"] == "scan"]
    assert {r["license"]: r["items"] for r in scans} == Counter(s.license or "unknown" for s in of(rows, Scene))


@st.composite
def exports(draw: st.DrawFn) -> list[Any]:
    """Export files and checks of some scenes."""
    rows: list[Any] = []
    for scene in SCENES[:2]:
        for kind in ("usd", "habitat"):
            for path in draw(st.lists(st.sampled_from("abc"), unique=True)):
                rows.append(sample(ExportFile, scene_id=scene, format=kind, path=path, size_bytes=draw(st.integers(0, 1000))))
            for rule in draw(st.lists(st.sampled_from("pqr"), unique=True)):
                rows.append(sample(ExportCheck, scene_id=scene, format=kind, rule=rule, passed=draw(st.booleans())))
    return rows


@quick
@given(rows=exports())
def test_export_verdicts(database: Database, rows: list[Any]) -> None:
    database.fill(*rows)
    answer = by_key(database.ask("export_verdicts"), "scene_id", "format")
    assert answer.keys() == {(row.scene_id, row.format) for row in rows}
    for key, row in answer.items():
        files = [r for r in of(rows, ExportFile) if (r.scene_id, r.format) == key]
        checks = [r for r in of(rows, ExportCheck) if (r.scene_id, r.format) == key]
        broken = sum(not check.passed for check in checks)
        passed = bool(files) and bool(checks) and broken == 0
        same(row, files=len(files), size_bytes=sum(f.size_bytes for f in files), rules=len(checks), broken_rules=broken, passed=passed)
