"""Completion of the command line in a shell, by the lines that docs/install.md gives."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from flows.cli import COMMANDS, COMPLETE
from schemas.families.scan_formats import SCAN_FORMATS
from tests.conftest import REPOSITORY


@pytest.fixture(scope="module")
def bin_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `metascenes`, as an installation has it."""
    script = tmp_path_factory.mktemp("bin") / "metascenes"
    script.write_text(f"#!{sys.executable}\nimport sys\nfrom flows.cli import main\nsys.argv[0] = 'metascenes'\nmain()\n")
    script.chmod(0o755)
    return script.parent


def completed(bin_folder: Path, line: str) -> list[str]:
    """What bash is told of the last word of a line: kind and value of each."""
    words = [*shlex.split(line), *([""] if line.endswith(" ") else [])]
    environment = {
        **os.environ, COMPLETE: "bash_complete", "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1), "PYTHONPATH": str(REPOSITORY),
    }  # fmt: skip
    done = subprocess.run([bin_folder / "metascenes"], env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split()


@pytest.mark.whole
def test_words_become_commands_options_choices_and_folders(bin_folder: Path) -> None:
    assert completed(bin_folder, "metascenes ") == [f"plain,{name}" for name in COMMANDS]
    assert completed(bin_folder, "metascenes sce") == ["plain,scenes"]
    assert completed(bin_folder, "metascenes lake ba") == ["plain,backup"]
    assert completed(bin_folder, "metascenes lake vacuum --da") == ["plain,--days"]
    assert completed(bin_folder, "metascenes run --format m") == [f"plain,{name}" for name in SCAN_FORMATS if name.startswith("m")]
    assert completed(bin_folder, "metascenes status --lake ./la") == ["dir,./la"]
    assert completed(bin_folder, "metascenes nosuch --la") == []


@pytest.mark.whole
def test_bash_takes_the_line_of_the_page_and_completes(bin_folder: Path) -> None:
    page = (REPOSITORY / "docs" / "install.md").read_text()
    (line,) = re.findall(rf'^(eval "\$\({COMPLETE}=bash_source metascenes\)")', page, re.MULTILINE)
    typed = 'COMP_WORDS=(metascenes scen); COMP_CWORD=1; _metascenes_completion metascenes scen metascenes; echo "${COMPREPLY[@]}"'
    environment = {**os.environ, "PATH": f"{bin_folder}{os.pathsep}{os.environ['PATH']}", "PYTHONPATH": str(REPOSITORY)}
    done = subprocess.run(
        ["bash", "--norc", "-c", f"{line}\ncomplete -p metascenes\n{typed}"], env=environment, capture_output=True, text=True
    )
    assert done.stderr == ""
    assert done.stdout.splitlines() == ["complete -o nosort -F _metascenes_completion metascenes", "scenes"]
