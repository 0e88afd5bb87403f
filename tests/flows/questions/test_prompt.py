"""The prompt of `metascenes sql`: statements from a stream, and a person at a real terminal."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import pty
import signal
import stat
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from flows.questions.bounds import Bounds
from flows.questions.names import COMMANDS, SqlNames
from flows.questions.prompt import MORE, PROMPT, SqlPrompt
from schemas.capture import Scene
from schemas.errors import InputError
from tests.conftest import REPOSITORY
from tests.samples import fingerprint, sample, stage_run
from warehouse.lake import Lake
from warehouse.questions.attached import attached
from warehouse.questions.catalog import entries


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    """A lake of two scenes."""
    made = Lake.open(tmp_path_factory.mktemp("lake"))
    for number, scene in enumerate(("demo/a", "demo/b")):
        rows = {"scenes": [sample(Scene, scene_id=scene, mesh_blob=made.blobs.put(b"mesh", "glb"))]}
        made.stage_rows(stage_run(scene, "capture", fingerprint(number)), rows)
    made.commit()
    return made


def told(lake: Lake, capfd: pytest.CaptureFixture[str], text: str, form: str = "jsonl") -> str:
    """What is printed for statements that are read."""
    SqlPrompt(lake.snapshot(), form, 1000, Bounds(60, 3)).read(text.splitlines(keepends=True))  # type: ignore[arg-type]
    return capfd.readouterr().out


def test_statements_are_read_over_lines_and_answered_in_turn(lake: Lake, capfd: pytest.CaptureFixture[str]) -> None:
    text = "SELECT 1 AS a; SELECT ';' AS b -- ; \n  , 2 AS c;\n\n;\nFROM scenes SELECT count(*)\nAS n"
    assert [json.loads(line) for line in told(lake, capfd, text).splitlines()] == [{"a": 1}, {"b": ";", "c": 2}, {"n": 2}]


def test_the_first_error_ends_what_is_read_and_nothing_is_written(lake: Lake, capfd: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    target = tmp_path / "out.csv"
    with pytest.raises(InputError, match="only reading is allowed"):
        told(lake, capfd, f"SELECT 1 AS a;\nCOPY (SELECT 1) TO '{target}';\nSELECT 2 AS a;")
    assert capfd.readouterr().out == '{"a": 1}\n'
    assert not target.exists()
    with pytest.raises(InputError, match="there is no statement"):
        told(lake, capfd, " -- nothing\n;\n")


def test_a_listing_names_what_the_catalog_names_and_the_columns_that_sql_tells(lake: Lake, capfd: pytest.CaptureFixture[str]) -> None:
    listed = told(lake, capfd, "\\d\n").splitlines()
    assert [line.split()[:2] for line in listed] == [[entry.kind, entry.signature.split()[0]] for entry in entries()]
    columns = told(lake, capfd, "\\d scene_overview;\n").splitlines()
    described = [json.loads(line) for line in told(lake, capfd, "DESCRIBE scene_overview").splitlines()]
    assert [line.split()[:2] for line in columns] == [[row["column_name"], row["column_type"].split()[0]] for row in described]
    assert "Scene, <dataset>/<scan>" in told(lake, capfd, "\\d scenes"), "columns of tables are described"
    assert told(lake, capfd, "\\d wilson_interval").startswith("macro  wilson_interval(")
    assert all(command in told(lake, capfd, "\\?") for command in COMMANDS)
    for line, hint in (("\\d scene_overvew", "did you mean scene_overview?"), ("\\quit", r"\\\? lists them")):
        with pytest.raises(InputError, match=hint):
            told(lake, capfd, line)
    assert told(lake, capfd, "\\q\nSELECT 1;") == ""


def test_rows_are_expanded_and_put_back(lake: Lake, capfd: pytest.CaptureFixture[str]) -> None:
    question = "SELECT scene_id, 1 AS number FROM scenes ORDER BY ALL;\n"
    assert told(lake, capfd, f"\\x\n{question}", "table") == (
        "[row 1]\nscene_id  demo/a\nnumber    1\n[row 2]\nscene_id  demo/b\nnumber    1\n(2 rows)\n"
    )
    assert told(lake, capfd, f"\\x\n\\x\n{question}", "table") == told(lake, capfd, question, "table")


def test_words_become_names_that_fit_their_place(lake: Lake, tmp_path: Path) -> None:
    file = tmp_path / "w.csv"
    file.write_text("scene_id,importance\ndemo/a,1\n")
    with attached({"weights": file}) as files:
        names = SqlNames(lake.snapshot(), files)
        assert names.completions("SELECT * FROM ", "scene_ov") == ["scene_overview"]
        assert names.completions("FROM ", "WEI") == ["weights"]
        assert "SELECT" in names.completions("", "SEL")
        assert "select" in names.completions("", "sel")
        assert names.completions("FROM weights SELECT ", "impo") == ["import", "importance"]
        assert names.completions("SELECT ", "wilson") == ["wilson_interval("]
        assert names.completions("\\d ", "scene_ov") == ["scene_overview"]
        assert names.completions("", "\\") == ["\\?", "\\d", "\\q", "\\x"]
        assert {"stage", "stage_runs"} <= set(names.completions("SELECT x FROM stage_runs WHERE ", "stage"))
        assert "floor_area_m2" not in names.completions("FROM stage_runs SELECT ", "floor"), "columns of other tables do not fit"


class Terminal:
    """`metascenes sql` at a terminal of its own, as a person sees it."""

    def __init__(self, ours: int, process: subprocess.Popen[bytes]) -> None:
        self._ours, self.process, self._unread = ours, process, b""

    def until(self, text: str) -> str:
        """What is printed up to a text, which is waited for."""
        wanted = text.encode()
        while wanted not in self._unread:
            self._unread += os.read(self._ours, 4096)  # fails when the command has ended without it
        seen, _, self._unread = self._unread.partition(wanted)
        return seen.decode()

    def type(self, text: str) -> None:
        os.write(self._ours, text.encode())

    def interrupt(self) -> None:
        """Ctrl-C to a command that waits for a line: one that comes between the prompt and the wait would be noticed at the next key."""
        stat = Path(f"/proc/{self.process.pid}/stat")
        while stat.read_text().rpartition(")")[2].split()[0] != "S":
            assert self.process.poll() is None
        self.type("\x03")

    def ask(self, line: str) -> list[str]:
        """What is answered to a line, in lines, once the next prompt is there."""
        self.type(f"{line}\n")
        self.until("\n")
        return self.until(PROMPT).splitlines()

    def left(self) -> tuple[int, str]:
        """The exit code, and what is still printed."""
        with contextlib.suppress(OSError):  # Linux says so of a terminal that nobody holds any more
            while more := os.read(self._ours, 4096):
                self._unread += more
        return self.process.wait(), self._unread.decode().strip()


@contextlib.contextmanager
def terminal(lake: Lake, home: Path, *words: str) -> Iterator[Terminal]:
    ours, theirs = pty.openpty()

    def prepare() -> None:
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job ignores Ctrl-C
        fcntl.ioctl(0, termios.TIOCSCTTY, 0)

    environment = {**os.environ, "TERM": "dumb", "INPUTRC": os.devnull, "HOME": str(home), "XDG_STATE_HOME": str(home / "state")}
    command = [sys.executable, "-m", "flows.cli", "sql", "--lake", lake.address, *words]
    process = subprocess.Popen(
        command, cwd=REPOSITORY, env=environment, stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True, preexec_fn=prepare
    )
    os.close(theirs)
    try:
        yield Terminal(ours, process)
    finally:
        process.kill()
        process.wait()
        os.close(ours)


@pytest.mark.whole
def test_a_person_at_a_terminal(lake: Lake, tmp_path: Path) -> None:
    with terminal(lake, tmp_path) as seen:
        assert "snapshot 1" in seen.until(PROMPT)
        seen.type("SELECT count(*) AS n\n")
        seen.until(MORE)
        assert seen.ask("FROM scenes;") == ["n", "-", "2", "(1 row)"]
        for wrong in ("SELECT nosuch FROM scenes;", "DROP TABLE scenes;", "SELEC 1;", "\\nosuch"):
            (line,) = seen.ask(wrong)
            assert line.startswith("SQL: "), line
        seen.type("SELECT 'a line that is dropped\n")
        seen.until(MORE)
        seen.interrupt()
        seen.until(PROMPT)
        assert seen.ask("SELECT 2 AS n;") == ["n", "-", "2", "(1 row)"], "nothing is left of the line before"
        seen.type("SELECT scene_id FROM scene_ov\t")
        seen.until("scene_overview")
        assert seen.ask(" ORDER BY 1;")[2:] == ["demo/a", "demo/b", "(2 rows)"]
        seen.ask("\\x")
        assert seen.ask("SELECT 3 AS three;") == ["[row 1]", "three  3", "(1 row)"]
        seen.type("\x04")
        assert seen.left() == (0, "")
    history = tmp_path / "state" / "metascenes" / "sql_history"
    assert stat.S_IMODE(history.stat().st_mode) == 0o600
    assert history.read_text().splitlines()[0] == "SELECT count(*) AS n FROM scenes;"
    with terminal(lake, tmp_path) as seen:
        seen.until(PROMPT)
        seen.type("\x1b[A\x1b[A\n")  # the statement before the last line
        assert "SELECT 3 AS three;" in seen.until("\n") + seen.until(PROMPT), "of the command before"
        assert seen.ask("\\d scene_overview")[0].split() == ["scene_id", "VARCHAR"]
        seen.type("\\q\n")
        seen.until("\n")
        assert seen.left() == (0, "")


@pytest.mark.whole
def test_ctrl_c_ends_the_question_and_not_the_prompt(lake: Lake, tmp_path: Path) -> None:
    endless = "SELECT count(*) FROM range(100000000000000) AS t(i) WHERE i % 7 = 3;"
    with terminal(lake, tmp_path, "--timeout", "0") as seen:
        seen.until(PROMPT)
        threads = Path(f"/proc/{seen.process.pid}/task")
        idle = len(list(threads.iterdir()))
        seen.type(f"{endless}\n")
        seen.until("\n")
        while len(list(threads.iterdir())) <= idle:  # it is asked in a thread of its own
            assert seen.process.poll() is None
        seen.type("\x03")
        assert seen.until(PROMPT).splitlines()[-1].endswith("interrupted")
        assert seen.ask("SELECT 1 AS a;")[2] == "1"
        seen.type("\x04")
        assert seen.left() == (0, "")


@pytest.mark.whole
def test_ctrl_c_ends_a_single_question_with_130_and_leaves_no_file(lake: Lake, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    endless = "SELECT count(*) FROM range(100000000000000) AS t(i) WHERE i % 7 = 3"
    with terminal(lake, tmp_path, endless, "--timeout", "0", "--out", str(out)) as seen:
        while not list(tmp_path.glob(".out.csv.*.tmp")):
            assert seen.process.poll() is None
        seen.type("\x03")
        code, said = seen.left()
        assert code == 130
        assert said.endswith("interrupted; the same command goes on where this one stopped")
    assert list(tmp_path.glob("*.csv*")) == list(tmp_path.glob(".*.tmp")) == []


@pytest.mark.whole
def test_what_is_no_terminal_is_read_to_its_end(lake: Lake) -> None:
    command = [sys.executable, "-m", "flows.cli", "sql", "--lake", lake.address, "--json"]
    done = subprocess.run(command, cwd=REPOSITORY, input="\ufeffSELECT 1 AS a;\nSELECT 'ä' AS b", capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == '[\n{"a": 1}\n]\n[\n{"b": "ä"}\n]\n'
    wrong = subprocess.run(command, cwd=REPOSITORY, input="SELECT 1 AS a;\nSELECT b;\nSELECT 2 AS a;", capture_output=True, text=True)
    assert (wrong.returncode, wrong.stdout, len(wrong.stderr.splitlines())) == (2, '[\n{"a": 1}\n]\n', 1)
    empty = subprocess.run(command, cwd=REPOSITORY, input="", capture_output=True, text=True)
    assert (empty.returncode, empty.stdout) == (2, "")
    assert "there is no statement" in empty.stderr


@pytest.mark.whole
def test_a_history_that_cannot_be_kept_is_said_to_be_and_nothing_else_changes(lake: Lake, tmp_path: Path) -> None:
    (tmp_path / "state").write_text("no folder")
    with terminal(lake, tmp_path) as seen:
        assert "state/metascenes/sql_history: the history is not kept (Not a directory)" in seen.until(PROMPT)
        assert seen.ask("SELECT 1 AS n;") == ["n", "-", "1", "(1 row)"]
        seen.type("\x04")
        assert seen.left() == (0, "")
