"""The scan as an input of stages besides capture: given where a config asks for it, and named by the fingerprint then alone."""

from __future__ import annotations

from pathlib import Path

import pytest

from flows.run.configuration import configure
from flows.run.plan import Plan, make_plan
from flows.run.scene import job_of
from tasks.capture.formats import find_scans
from tasks.capture.scan import Scan
from tasks.stage import Outcome, Stage
from tests.scans import write_scan
from warehouse.lake import Lake

PLAIN = 'candidates.slots=[{provider="procedural"}, {provider={kind="scan_crop"}}]'
TWINS = 'candidates.slots=[{provider="procedural"}, {provider={kind="textured", of=1}}]'
PROGRAM = (
    'candidates.slots=[{provider="procedural"},'
    ' {provider={kind="textured", painter={kind="texture_command", words=["paint", "{mesh}", "{out}"], license="MIT"}}}]'
)


def planned(folder: Path, lake: Lake, *settings: str) -> tuple[Plan, dict[str, tuple[str, ...]], dict[str, object]]:
    """A plan of one scan, the parts of the fingerprint of its candidates by name, and what their job is given from outside."""
    configuration = configure(settings=settings)
    plan = make_plan(lake, *find_scans(folder), configuration)
    (scene,) = plan.scenes
    step = next(step for step in scene.steps if step.stage == "candidates")
    parts = dict(part.split("=", 1) for part in step.fingerprint.parts)
    return plan, parts, dict(job_of(lake, scene, step, configuration).outside)


def test_candidates_are_given_the_scan_where_frames_are_to_paint(tmp_path: Path) -> None:
    write_scan(tmp_path / "scans", "scene0001_00")
    lake = Lake.open(tmp_path / "lake")
    for settings, is_wanted in ((PLAIN, False), (PROGRAM, False), (TWINS, True)):
        plan, parts, outside = planned(tmp_path / "scans", lake, settings)
        assert ("scan" in parts, "content" in parts) == (is_wanted, False)
        assert set(outside) == {"library", "scan"}
        assert outside["scan"] == (plan.scenes[0].scan if is_wanted else None)
        capture = plan.scenes[0].steps[0]
        assert capture.stage == "capture"
        assert not is_wanted or f"scan={parts['scan']}" in capture.fingerprint.parts


def test_without_twins_nothing_of_the_scan_is_in_the_fingerprint_but_its_capture(tmp_path: Path) -> None:
    """A file that changes is another scan for capture, and for twins; the rest hangs on what capture made of it."""
    scan = write_scan(tmp_path / "scans", "scene0001_00")
    lake = Lake.open(tmp_path / "lake")
    before = {settings: planned(tmp_path / "scans", lake, settings)[1] for settings in (PLAIN, TWINS)}
    text = scan / "scene0001_00.txt"
    text.write_text(text.read_text() + "appVersionId = 2\n")
    after = {settings: planned(tmp_path / "scans", lake, settings)[1] for settings in (PLAIN, TWINS)}
    changed = {s: {name for name in after[s] if after[s][name] != before[s].get(name)} for s in (PLAIN, TWINS)}
    assert changed == {PLAIN: {"capture", "captions"}, TWINS: {"capture", "captions", "scan"}}


def test_only_stages_with_the_input_may_decide_about_it() -> None:
    def run(**inputs: object) -> Outcome:
        return Outcome()

    with pytest.raises(ValueError, match="`scan_wanted` is there for the outside input `scan` alone"):
        Stage(name="captions", reads=(), writes=(), config=Scan, run=run, scan_wanted=lambda config: True)
    always = Stage(name="captions", reads=(), writes=(), config=Scan, run=run, outside=("scan",))
    never = Stage(name="captions", reads=(), writes=(), config=Scan, run=run)
    assert (always.takes_scan(None), never.takes_scan(None)) == (True, False)
