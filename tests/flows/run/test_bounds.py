"""Readers without bounds of their own: their death is a finding, never a hang and never ours."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from flows.cli import cli
from flows.run.bounds import OutOfBounds, bounded, findings_of
from schemas.budget import BUDGET
from schemas.errors import InputError
from tasks.exports.findings import Finding
from tests import attacks

MODEST = 2**29


def sound(path: Path) -> list[Finding]:
    return [Finding("xml", path.name, "is odd")]


def hungry(path: Path) -> list[Finding]:
    return [Finding("xml", str(np.ones(2**28).sum()), "2 GiB")]


def busy(path: Path) -> list[Finding]:
    while True:
        pass


def waiting(path: Path) -> list[Finding]:
    return [Finding("xml", path.read_text(), "nobody writes")]


def crashing(path: Path) -> list[Finding]:
    ctypes.string_at(0)
    return []


def refusing(path: Path) -> list[Finding]:
    raise InputError(path.name, "field", "is odd", "mend it")


class Local(Exception):
    """One that cannot be made again from what it holds."""

    def __init__(self, one: str, two: str) -> None:
        super().__init__(one + two)


def failing(path: Path) -> list[Finding]:
    raise Local("a defect ", "of ours")


@pytest.mark.whole
def test_what_a_check_finds_or_refuses_comes_back_as_it_is(tmp_path: Path) -> None:
    assert findings_of(sound, tmp_path / "a") == sound(tmp_path / "a")
    with pytest.raises(InputError, match="a: field: is odd; mend it"):
        findings_of(refusing, tmp_path / "a")
    with pytest.raises(RuntimeError, match="Local: a defect of ours"):
        findings_of(failing, tmp_path / "a")


def test_a_folder_that_says_it_has_terabytes_is_checked(tmp_path: Path) -> None:
    """Time follows from the bytes, and the operating system waits for so long at most."""
    for number in range(3):
        with (tmp_path / f"{number}.json").open("wb") as file:
            file.truncate(2**40)
    assert findings_of(sound, tmp_path, times=1e6) == sound(tmp_path)


@pytest.mark.whole
@pytest.mark.parametrize(
    ("check", "seconds", "words"),
    [(hungry, 60, "takes more than 512 MB of memory"), (busy, 1, "takes more than 1 s"), (crashing, 60, "dies (SIGSEGV)")],
    ids=lambda value: getattr(value, "__name__", ""),
)  # fmt: skip
def test_a_reader_that_takes_too_much_or_dies_is_told(
    check: Callable[[Path], list[Finding]], seconds: float, words: str, tmp_path: Path
) -> None:
    with pytest.raises(OutOfBounds) as raised:
        bounded(check, tmp_path / "a", seconds=seconds, memory_bytes=MODEST)
    assert words in str(raised.value)
    assert len(str(raised.value).splitlines()) == 1


def test_a_reader_that_waits_for_ever_is_ended(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a")
    with pytest.raises(OutOfBounds, match="takes more than 0 s"):
        bounded(waiting, tmp_path / "a", seconds=0.1, memory_bytes=MODEST)


def test_the_finding_says_how_to_give_it_more(tmp_path: Path) -> None:
    (found,) = findings_of(hungry, tmp_path / "a", times=0.5)
    assert str(found) == "budget: a: cannot be checked: a reader of it takes more than 768 MB of memory; --budget 1 gives it twice as much"


@pytest.mark.parametrize(
    ("kind", "name", "counts"),
    [
        ("mjcf", "a.xml", True),
        ("usd", "a.usda", True),
        ("urdf", "a.urdf", True),
        ("urdf", ".", True),
        ("glb", "a.glb", False),
        ("nav2", "a.yaml", True),
        ("sdf", "a.sdf", True),
    ],
)
def test_a_file_that_names_others_is_given_what_they_take(
    kind: str, name: str, counts: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mesh beside it, one that a link leads to, a link that leads nowhere and a pipe."""
    folder = tmp_path / "scene"
    (folder / "meshes").mkdir(parents=True)
    (folder / "a.bin" if name == "." else folder / name).write_bytes(b"x" * 10)
    (folder / "meshes" / "chair.obj").write_bytes(b"x" * 1_000)
    (tmp_path / "table.obj").write_bytes(b"x" * 100_000)
    (folder / "meshes" / "table.obj").symlink_to(tmp_path / "table.obj")
    (folder / "meshes" / "gone.obj").symlink_to(tmp_path / "gone.obj")
    os.mkfifo(folder / "meshes" / "pipe")
    given: list[int] = []

    def budgeted(*told: Any, memory_bytes: int, seconds: float) -> list[Finding]:
        given.append(memory_bytes)
        return []

    monkeypatch.setattr("flows.run.bounds.bounded", budgeted)
    ended = CliRunner().invoke(cli, ["doctor", kind, str(folder / name)])
    assert ended.exit_code == 0, ended.output
    assert given == [BUDGET.child_bytes + BUDGET.child_bytes_per_byte * (101_010 if counts else 10)]


CHECKED = "import sys; from pathlib import Path; from tasks.exports.mjcf.rules import check_mjcf; print(*check_mjcf(Path(sys.argv[1])))"

MODELS = {
    "replicate": '<worldbody><replicate count="1000000" offset="1 0 0"><body><geom size="1"/></body></replicate></worldbody>',
    "nested replicates": "<worldbody>" + '<replicate count="100">' * 9 + '<geom size="1"/>' + "</replicate>" * 9 + "</worldbody>",
    "flexcomp": '<worldbody><flexcomp name="a" type="grid" count="9999 9999 9999"/></worldbody>',
    "composite": '<worldbody><composite type="cable" count="99999999 1 1"><geom size="1"/></composite></worldbody>',
    "hfield": '<asset><hfield name="a" nrow="99999" ncol="99999" size="1 1 1 1"/></asset>',
    "texture": '<asset><texture name="a" builtin="flat" width="65000" height="65000"/></asset>',
}


@pytest.mark.parametrize("name", MODELS)
def test_a_model_of_few_words_that_mujoco_makes_much_of_is_found(name: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco>{MODELS[name]}</mujoco>")
    said = attacks.below_ceiling(CHECKED, path)
    assert said.startswith("budget: scene.xml: MuJoCo would make ")


@pytest.mark.parametrize(
    "text", ["<a>" * 200_000 + "</a>" * 200_000, "<mujoco>" + "<geom/>" * 2_100_000 + "</mujoco>"], ids=["deep", "wide"]
)
def test_xml_that_is_deep_or_wide_is_no_defect(text: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text(text)
    assert attacks.below_ceiling(CHECKED, path).startswith("xml: scene.xml: ")


def test_models_that_include_one_another_are_no_defect(tmp_path: Path) -> None:
    for i in range(1500):
        (tmp_path / f"{i}.xml").write_text(f'<mujoco><include file="{i + 1}.xml"/></mujoco>')
    (tmp_path / "1500.xml").write_text("<mujoco/>")
    ended = CliRunner().invoke(cli, ["doctor", "mjcf", str(tmp_path / "0.xml")])
    assert ended.exit_code in (0, 1), ended.output


@pytest.mark.whole
def test_doctor_reads_with_bounds_and_says_when_they_are_reached(tmp_path: Path) -> None:
    path = tmp_path / "scene.xml"
    path.write_text('<mujoco><size memory="3G"/><worldbody><geom size="1"/></worldbody></mujoco>')
    ended = CliRunner().invoke(cli, ["doctor", "mjcf", str(path), "--budget", "0.5"])
    assert ended.exit_code == 1, ended.output
    assert "budget" in ended.output or "compiles" in ended.output
    stage = tmp_path / "scene.usda"
    stage.write_text('#usda 1.0\n(\n    upAxis = "Z"\n    metersPerUnit = 1\n    defaultPrim = "a"\n)\ndef Xform "a"\n{\n}\n')
    ended = CliRunner().invoke(cli, ["doctor", "usd", str(stage)])
    assert "budget" not in ended.output
    assert ended.exit_code in (0, 1)
    stage.write_text("#usda 1.0\n" + 'def "a" {\n' * 100_000 + "}\n" * 100_000)
    ended = CliRunner().invoke(cli, ["doctor", "usd", str(stage), "--budget", "0.25"])
    assert ended.exit_code == 1, ended.exception
    assert ended.output.startswith("wrong: ")
