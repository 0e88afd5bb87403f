"""NVIDIA's validator on our files: nothing to object to, and its words where there is."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from flows.commands.doctor import command
from schemas.errors import InputError
from tasks import exports
from tasks.exports.usd import write_usd
from tasks.exports.usd.omniverse import RULE, check_omniverse
from tasks.exports.usd.package import package
from tests.replicas import rows_of
from tests.tasks.exports.usd.test_exports_usd import BOX, DAMAGES, bedding, edit_layer, replica_of, with_bedding
from tests.tasks.exports.usd.test_exports_usd_package import files_of


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = exports.ExportsConfig()
    return write_usd(tmp_path_factory.mktemp("usd"), replica_of(*with_bedding(rows_of(bedding())), config), config)


def test_it_has_nothing_to_say_of_a_scene_a_package_and_an_asset_in_all_variants(scene: Path, tmp_path: Path) -> None:
    packed = tmp_path / "scene.usdz"
    packed.write_bytes(package(files_of(scene.parent), "scene.usda"))
    pillow = next(scene.parent.glob("assets/pillow_*/pillow_*[0-9a-f].usda"))
    for path in (scene, packed, pillow):
        assert [str(finding) for finding in check_omniverse(path)] == []


def test_instances_have_no_failures_either(tmp_path: Path) -> None:
    config = exports.ExportsConfig(usd=exports.UsdConfig(instanceable=True))
    path = write_usd(tmp_path, replica_of(*rows_of(bedding()), config), config)
    assert [str(finding) for finding in check_omniverse(path) if finding.is_error] == []


@pytest.mark.parametrize("name", ["no default prim", "no units", "position that is no number", "lost geometry"])
def test_damage_is_found_by_it_too(name: str, scene: Path, tmp_path: Path) -> None:
    copy = Path(shutil.copytree(scene.parent, tmp_path / "copy")) / scene.name
    DAMAGES[name][1](copy)
    found = [finding for finding in check_omniverse(copy) if finding.is_error]
    assert found
    assert all(finding.rule == RULE and "\n" not in finding.message and str(tmp_path) not in str(finding) for finding in found)


@pytest.mark.slow
@pytest.mark.whole
def test_the_command_adds_what_it_says_to_the_gates_findings(scene: Path, tmp_path: Path) -> None:
    run = CliRunner().invoke
    clean = run(command, ["usd", str(scene), "--omniverse", "--json"])
    assert clean.exit_code == 0, clean.output
    told = json.loads(clean.stdout)
    assert told["errors"] == []
    copy = Path(shutil.copytree(scene.parent, tmp_path / "copy")) / scene.name
    edit_layer(copy, lambda stage: stage.GetPrimAtPath(f"{BOX}/Visual/Part_00").GetAttribute("normals").Block())
    assert json.loads(run(command, ["usd", str(copy), "--json"]).stdout)["errors"] == []
    asked = run(command, ["usd", str(copy), "--omniverse", "--json"])
    assert asked.exit_code == 1
    errors = json.loads(asked.stdout)["errors"]
    assert errors
    assert all(line.startswith(f"{RULE}: {BOX}/Visual/Part_00: NormalsExistChecker") for line in errors), errors


def test_without_the_package_one_line_says_how_to_get_it(scene: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "omni.asset_validator", None)
    with pytest.raises(
        InputError, match=r"omniverse-asset-validator: .*not installed.*pip install omniverse-asset-validator==1\.18\.0"
    ) as refused:
        check_omniverse(scene)
    assert len(str(refused.value).splitlines()) == 1
