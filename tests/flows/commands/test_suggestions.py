"""Mistyped scenes and commands: one line that says what was meant; and what the command line says of itself and of the lake's name."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from flows.cli import EXIT_CODES, cli
from flows.commands.demo import next_commands
from schemas.capture import Scene
from schemas.errors import InputError
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    made = Lake.open(tmp_path_factory.mktemp("lake") / "a lake's")
    for number, scene in enumerate(("demo/kitchen_00", "demo/bedroom_00")):
        rows = {"scenes": [sample(Scene, scene_id=scene, mesh_blob=made.blobs.put(b"mesh", "glb"))]}
        made.stage_rows(stage_run(scene, "capture", fingerprint(number)), rows)
    made.commit()
    return made


def said(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str]:
    from flows.cli import main

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "argv", ["metascenes", *words])
        with pytest.raises(SystemExit) as end:
            main()
    told = capsys.readouterr()
    return int(end.value.code or 0), told.out + told.err


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (("explain", "demo/kichen_00"), "demo/kitchen_00"),
        (("explain", "demo/kichen_00/0003"), "demo/kitchen_00"),
        (("explain", "bedrom_00"), "bedroom_00"),
        (("export", "--out", "{out}", "--scene", "demo/bedroom_0"), "demo/bedroom_00"),
        (("annotate", "create", "--batch", "one", "--annotator", "ada", "--out", "{out}", "--scene", "demo/bedroom_0"), "demo/bedroom_00"),
        (("lake", "erase", "demo/kitchen_0", "--dry-run"), "demo/kitchen_00"),
    ],
    ids=lambda each: " ".join(each[:2]) if isinstance(each, tuple) else each,
)
def test_a_mistyped_scene_is_told_which_was_meant(
    words: tuple[str, ...], meant: str, lake: Lake, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, text = said(capsys, *(word.format(out=tmp_path / "out") for word in words), "--lake", lake.address)
    assert code == (0 if "--dry-run" in words else 2), text
    assert f"did you mean {meant}?" in text
    assert not (tmp_path / "out").exists()


def test_a_mistyped_scene_to_show_is_told_which_was_meant(lake: Lake) -> None:
    from flows.view.scene import Scenes

    with pytest.raises(InputError, match=r"did you mean demo/kitchen_00\?"):
        Scenes(lake, None).place("demo/kitchn_00")


def test_a_mistyped_scan_of_a_run_is_told_which_was_meant(tmp_path: Path) -> None:
    from flows.scans.choice import chosen
    from tasks.capture.scan import Scan

    scans = [Scan("glb", tmp_path, "demo", name) for name in ("kitchen_00", "bedroom_00")]
    for word, meant in (("demo/kitchen_OO", "demo/kitchen_00"), ("bedroom", "bedroom_00")):
        with pytest.raises(InputError, match=rf"did you mean {meant}\?"):
            chosen(scans, scenes=[word])


def test_a_mistyped_part_of_a_benchmark_is_told_which_was_meant(capsys: pytest.CaptureFixture[str]) -> None:
    code, text = said(capsys, "bench", "capture", "--parts", "storys")
    assert code == 2
    assert "'storys' is none of" in text
    assert "did you mean storeys?" in text


def test_help_names_the_variable_of_the_lake_and_every_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    code, text = said(capsys, "--help")
    assert code == 0
    words = " ".join(text.split())
    assert "METASCENES_LAKE" in words
    assert all(f"{number} {meaning}" in words for number, meaning in EXIT_CODES.items())
    assert EXIT_CODES[130] == "interrupted"
    assert "METASCENES_LAKE" in said(capsys, "status", "--help")[1]


@pytest.mark.whole
def test_what_a_demo_prints_at_its_end_works_in_a_shell(lake: Lake, tmp_path: Path) -> None:
    lines = next_commands(Path(lake.address), is_viewed=True)
    assert list(lines) == ["look at it", "ask the lake", "name it once"]
    ours = f'metascenes() {{ {shlex.quote(sys.executable)} -m flows.cli "$@"; }}'
    script = f"{ours}\n{lines['ask the lake']} --json\n{lines['name it once']}\nmetascenes scenes --json"
    done = subprocess.run(["bash", "-e", "-c", script], cwd=Path(__file__).parents[3], capture_output=True, text=True, check=True)
    assert done.stdout.count("demo/kitchen_00") == 2
    assert cli.commands == {}, "commands are imported when they are used"
