"""Files of somebody's own beside the tables of a lake: CSV, JSON or Parquet, each under a name that a statement can ask.

DuckDB is given each under a path of our making, a link: what is in a file's name is no SQL, no pattern and no partition then, and the
connection, which reads nothing that it was not told, is told that path alone.
"""

from __future__ import annotations

import contextlib
import dataclasses
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from schemas.errors import InputError
from schemas.files import open_file
from schemas.machine.scratch import temporary_folder
from schemas.text import one_line
from warehouse.questions.catalog import entries
from warehouse.questions.quoting import literal, quoted

_READERS = {
    ".csv": "read_csv", ".tsv": "read_csv", ".parquet": "read_parquet", ".json": "read_json", ".jsonl": "read_json", ".ndjson": "read_json",
}  # fmt: skip
"""What reads a file by its ending; text may be packed besides (`.csv.gz`)."""

_PACKED = (".gz", ".zst")

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,62}")

_MOST_BYTES = 2**60
"""As large as it likes: it is read row by row, within the statement's bounds."""


@dataclasses.dataclass(frozen=True)
class Attached:
    """A file and the name of its rows. link: The path by which DuckDB knows it."""

    name: str
    path: Path
    link: str
    reader: str

    @property
    def statement(self) -> str:
        """The statement that makes its rows a view."""
        return f"CREATE VIEW {quoted(self.name)} AS FROM {self.reader}({literal(self.link)})"

    def said(self, text: object) -> str:
        """A message of DuckDB's in one line, with the file's own name."""
        return one_line(str(text).partition("\n\nLINE ")[0].replace(self.link, str(self.path)))

    def refusal(self, error: object) -> InputError:
        """What to say of a file that DuckDB does not read."""
        return InputError(str(self.path), f"--attach {self.name}", f"cannot be read ({self.said(error)})", "is it what its ending says?")


@contextlib.contextmanager
def attached(files: Mapping[str, Path]) -> Iterator[tuple[Attached, ...]]:
    """Files by the names of their rows, ready to be given to `ask` for as long as this lasts. Each is opened once, to see that it can be.

    Raises:
        InputError: a name is none that SQL takes as it stands, or the lake's own; a file is missing, no regular file, of no known
            ending, or cannot be read.
    """
    import duckdb

    with temporary_folder() as folder:
        opened = tuple(_attached(name, path, folder) for name, path in files.items())
        for each in opened:
            with duckdb.connect(":memory:") as connection:
                connection.execute(f"SET allowed_paths = [{literal(each.link)}]")
                connection.execute("SET enable_external_access = false")
                try:
                    connection.execute(each.statement)
                except duckdb.Error as error:
                    raise each.refusal(error) from error
        yield opened


def _attached(name: str, path: Path, folder: Path) -> Attached:
    """A file with its link in a folder."""
    _check_name(name)
    field = f"--attach {name}"
    endings = [ending.lower() for ending in path.suffixes]
    packed = endings.pop() if endings and endings[-1] in _PACKED else ""
    ending = endings[-1] if endings else ""
    if ending not in _READERS or (packed and _READERS[ending] == "read_parquet"):
        known = f"{', '.join(_READERS)}, text also with {' or '.join(_PACKED)} behind it"
        raise InputError(str(path), field, "has no ending that says what it is", f"name it with one of {known}")
    try:
        open_file(path, str(path), _MOST_BYTES).close()
        link = folder / f"{name}{ending}{packed}"
        link.symlink_to(path.resolve())
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(str(path), field, f"cannot be read ({reason})", "check the path and its permissions") from error
    return Attached(name, path, str(link), _READERS[ending])


def _check_name(name: str) -> None:
    """Refuse what is no name of a relation, or the name of another."""
    import duckdb

    field = "--attach"
    if not _NAME.fullmatch(name):
        raise InputError(
            field, name, "is no name of a relation", "use letters, digits and _, not a digit first: --attach weights=weights.csv"
        )
    for entry in entries():
        if entry.name.lower() == name.lower():
            raise InputError(field, name, f"is a {entry.kind} of the lake", "give another name")
    with duckdb.connect(":memory:") as connection:
        reserved = "SELECT 1 FROM duckdb_keywords() WHERE keyword_name = ? AND keyword_category = 'reserved'"
        if connection.execute(reserved, [name.lower()]).fetchall():
            raise InputError(field, name, "is a word of SQL", "give another name")
