"""What an export is asked for and the lake has not: never passed over, never an older export in its place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from flows import exporting
from flows.cli import cli
from flows.commands.demo import exporting as exporting_beside
from flows.outputs.export import write_exports
from schemas.errors import InputError
from schemas.exports import ExportCheck, ExportFile
from tasks.geometry.transforms import translation, yaw_pose
from tests.flows.outputs.test_export_folder import contents
from tests.flows.outputs.test_export_licenses import MUTE, PLAIN, stage
from tests.replicas import cube, obj
from tests.samples import fingerprint, stage_run
from warehouse.lake import Lake
from warehouse.release import make_release
from warehouse.release.licenses import Allowed


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """A scene in two formats, one in one of them; the release `v1` has both, and one more is not exported at all."""
    lake = Lake.open(tmp_path_factory.mktemp("choice") / "lake")
    stage(lake, PLAIN, [obj("stool", yaw_pose(0.3, [0.5, 0.0, 0.0]), seed=7)], ("mjcf", "glb"))
    stage(lake, MUTE, [cube((0.3, 0.2, 0.25), translation([0.0, 0.0, 0.0]))], ("glb",))
    lake.commit("some formats")
    make_release(lake, "v1")
    return lake


def older(out: Path, *formats: str) -> dict[str, bytes]:
    """Folders that an older export left; their files."""
    for name in formats:
        (out / name).mkdir(parents=True)
        (out / name / ".exported").write_text("older")
        (out / name / "old.xml").write_text("older")
    return contents(out)


def ask(lake: Lake, out: Path, *more: str) -> Any:
    return CliRunner().invoke(cli, ["export", "--lake", lake.address, "--out", str(out), *more])


@pytest.mark.parametrize("more", [(), ("--release", "v1"), ("--dry-run",), ("--license-allow", "CC0-1.0,Apache-2.0"), ("--json",)])
@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (("--format", "urdf"), "the lake has no urdf export; it has glb, mjcf"),
        (("--format", "glb", "--format", "usd"), "the lake has no usd export"),
        (("--format", "mjcf", "--scene", MUTE), f"no mjcf export of {MUTE}; it has glb"),
        (("--format", "mjcf", "--scene", PLAIN, "--scene", MUTE), f"no mjcf export of {MUTE}"),
        (("--scene", "demo/gone"), "no export of demo/gone"),
        (("--usdz",), "asks for packages of USD scenes"),
    ],
)
def test_what_is_named_and_not_there_is_refused_and_nothing_changes(
    lake: Lake, tmp_path: Path, asked: tuple[str, ...], said: str, more: tuple[str, ...]
) -> None:
    if "--dry-run" in more and "--usdz" in asked:
        return
    before = older(tmp_path, "urdf", "glb", "usd")
    done = ask(lake, tmp_path, *asked, *more)
    assert isinstance(done.exception, InputError), done.output
    assert said in str(done.exception)
    assert contents(tmp_path) == before


def test_an_empty_lake_exports_nothing_and_says_so(tmp_path: Path) -> None:
    empty = Lake.open(tmp_path / "lake")
    empty.stage_rows(stage_run(PLAIN, "capture", fingerprint(1)), {"scenes": []})
    empty.commit()
    before = older(tmp_path / "out", "glb")
    done = ask(empty, tmp_path / "out")
    assert "the lake has no exports" in str(done.exception)
    assert contents(tmp_path / "out") == before


def test_all_means_what_the_lake_has_and_an_older_export_of_the_rest_goes(lake: Lake, tmp_path: Path) -> None:
    older(tmp_path, "urdf", "glb")
    done = ask(lake, tmp_path)
    assert done.exit_code == 0, done.output
    assert sorted(folder.name for folder in tmp_path.iterdir()) == ["glb", "mjcf"]
    assert not (tmp_path / "glb" / "old.xml").exists()
    for line in (
        f"{MUTE}: no mjcf export",
        "urdf: the lake has no export in this format",
        f"{tmp_path / 'urdf'}: an older export was removed",
    ):
        assert f"note: {line}" in done.output
    assert json.loads(ask(lake, tmp_path, "--json").stdout)["notes"][0] == f"{MUTE}: no mjcf export"


def test_a_format_that_only_other_scenes_have_is_not_absent(lake: Lake, tmp_path: Path) -> None:
    older(tmp_path, "urdf", "mjcf")
    done = ask(lake, tmp_path, "--scene", MUTE)
    assert done.exit_code == 0, done.output
    assert sorted(folder.name for folder in tmp_path.iterdir()) == ["glb", "mjcf"]
    assert (tmp_path / "mjcf" / "old.xml").read_text() == "older"
    notes = [line for line in done.output.splitlines() if "mjcf" in line]
    assert notes == [f"note: {MUTE}: no mjcf export"]


def test_a_folder_that_no_export_wrote_is_not_removed(lake: Lake, tmp_path: Path) -> None:
    (tmp_path / "urdf").mkdir()
    (tmp_path / "urdf" / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="holds files that no export wrote"):
        write_exports(lake, tmp_path)
    assert set(contents(tmp_path)) == {"urdf/mine.txt"}


@pytest.mark.whole
def test_licenses_that_leave_nothing_fail_the_export(lake: Lake, tmp_path: Path) -> None:
    older(tmp_path, "mjcf", "glb")
    dry = ask(lake, tmp_path, "--license-allow", "unknown", "--dry-run")
    done = ask(lake, tmp_path, "--license-allow", "unknown")
    for said in (dry, done):
        assert said.exit_code == 1
        assert "failed: mjcf: the allowed licenses leave nothing of it" in said.output
        assert "failed: glb: the allowed licenses leave nothing of it" in said.output
        assert f"left out: scene {PLAIN}" in said.output
    assert {Path(name).name for name in contents(tmp_path)} == {"LEFT_OUT.md", "ATTRIBUTION.md", ".exported"}


@pytest.mark.whole
def test_the_flow_fails_as_the_command_does(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exporting, "create_link_artifact", lambda **told: None)
    before = older(tmp_path, "urdf")
    with pytest.raises(InputError, match="the lake has no urdf export"):
        exporting.export.fn(lake.address, str(tmp_path), formats=["urdf"])
    with pytest.raises(InputError, match=f"no mjcf export of {MUTE}"):
        exporting.export.fn(lake.address, str(tmp_path), formats=["mjcf"], scenes=[MUTE], release="v1")
    assert contents(tmp_path) == before
    assert exporting.export.fn(lake.address, str(tmp_path)).is_completed()
    nothing = exporting.export.fn(lake.address, str(tmp_path), licenses=["unknown"])
    assert nothing.is_failed()
    assert "leave nothing" in nothing.message


@pytest.mark.whole
def test_a_scene_that_lacks_objects_fails_although_its_files_pass(lake: Lake, tmp_path: Path) -> None:
    from shutil import copytree

    copytree(lake.address, tmp_path / "lake")
    other = Lake.open(tmp_path / "lake")
    reader = other.snapshot()
    checks = [
        ExportCheck(scene_id=PLAIN, format=name, rule="complete", passed=name == "glb", message=None if name == "glb" else "1 of 2 objects")
        for name in ("mjcf", "glb")
    ]
    print_ = fingerprint(PLAIN, "incomplete")
    above = f"optimization={fingerprint(PLAIN, 'optimization')}"
    rows = {"export_files": reader.rows(ExportFile, PLAIN), "export_checks": checks}
    other.stage_rows(stage_run(PLAIN, "exports", print_, above, at=60), rows)
    other.commit()
    assert write_exports(other, tmp_path / "out").findings == (f"{PLAIN}: mjcf: complete: 1 of 2 objects",)
    assert write_exports(other, tmp_path / "out", ("glb",)).findings == ()
    alone = write_exports(other, tmp_path / "out", ("mjcf",), allowed=Allowed(("CC0-1.0", "Apache-2.0", "unknown")))
    assert alone.findings == (f"{PLAIN}: mjcf: complete: 1 of 2 objects",)


@pytest.mark.whole
def test_a_demo_exports_beside_its_other_work(lake: Lake, tmp_path: Path) -> None:
    with exporting_beside(lake, tmp_path / "one", 1) as finish:
        assert not (tmp_path / "one").exists(), "one worker does one thing after another"
        alone = finish()
    with exporting_beside(lake, tmp_path / "two", 2) as finish:
        beside = finish()
    assert (beside.files, beside.problems) == (alone.files, alone.problems)
    assert contents(tmp_path / "two") == contents(tmp_path / "one")
    empty = Lake.open(tmp_path / "lake")
    for workers in (1, 2):
        with exporting_beside(empty, tmp_path / "none", workers) as finish, pytest.raises(InputError):
            finish()
        with pytest.raises(KeyError), exporting_beside(lake, tmp_path / f"left{workers}", workers):
            raise KeyError("a report that cannot be drawn ends it all")
