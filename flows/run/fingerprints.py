"""Fingerprints: what a stage's result depends on, as hashes. Reuse is keyed on them, not on time stamps.

A fingerprint covers the inputs (outside files by content, upstream stages by their own fingerprints), the config,
the code that the stage imports and the seed. A file's hash is remembered with its size, inode and change time, so
that a second look at an unchanged scan costs one `stat` per file; the hash alone decides.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import hashlib
import json
import os
import re
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, MutableMapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import open_file, read_file, sane_bytes, write_whole
from schemas.parsing import json_value
from schemas.tables import TABLES

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("schemas", "tasks")
MECHANISM = ("tasks.settings", "tasks.stage", "tasks.training", "schemas.tables", "schemas.record", "schemas.errors", "schemas.files")
"""Modules that carry rows around and compute none: a change there redoes nothing."""

DATA = (".csv", ".json", ".txt", ".yaml")
"""Suffixes of data files that count as code."""

PICTURES = "pictures-"
"""Folders of the cache with drawn pictures begin with it; a hash of the code follows. Charts name scenes that never had a blob."""

RACY_SECONDS = 2.0
"""A file changed this recently may change again within its time stamp's resolution: its hash is not remembered."""


def digest(*parts: str) -> str:
    """SHA-256 of texts, each with its length, so that no two lists of texts look alike."""
    hasher = hashlib.sha256()
    for part in parts:
        raw = part.encode()
        hasher.update(f"{len(raw)}:".encode() + raw)
    return hasher.hexdigest()


def canonical(config: Any) -> Any:
    """A config as plain JSON values: dataclasses by type name and fields, so that union members differ."""
    if dataclasses.is_dataclass(config) and not isinstance(config, type):
        fields = {f.name: canonical(getattr(config, f.name)) for f in dataclasses.fields(config)}
        return {"type": type(config).__name__, **fields}
    if isinstance(config, dict):
        return {str(key): canonical(value) for key, value in sorted(config.items())}
    if isinstance(config, list | tuple):
        return [canonical(value) for value in config]
    if isinstance(config, Path):
        return str(config)
    return config


def canonical_json(config: Any) -> str:
    """A config as JSON text: sorted keys, no spaces; the same config gives the same text."""
    return json.dumps(canonical(config), default=str, sort_keys=True, separators=(",", ":"), allow_nan=False)


def annotations_digest(rows: Iterable[Mapping[str, object]]) -> str:
    """Hash of a scene's annotations, given as rows by column; '' where there are none.

    Columns that say what rows of before say are left out, so that these have the hash that they had.
    """
    later = {**TABLES["annotations"].earlier, "tool": None}
    texts = ["|".join(f"{name}={row[name]!r}" for name in sorted(row) if name not in later or row[name] != later[name]) for row in rows]
    return digest(*sorted(hashlib.sha256(text.encode()).hexdigest() for text in texts)) if texts else ""


@cache
def code_fingerprint(module: str) -> str:
    """Hash of a module and all modules of ours that it imports, anywhere in them; comments and docstrings do not count.

    The members of an open family count as imported where `tasks.families.members` makes their tuple.

    Data files (CSV, JSON, YAML) in the folders of those modules count as code. Parsing them all takes seconds, so what was found
    for exactly these contents is remembered between processes: beside the code, else in the user's cache folder.
    """
    known = {name: value for store in reversed(_code_stores()) for name, value in _remembered(store).items()}
    if module not in known:
        known[module] = _fingerprint_of(module)
        if _marks() == _marks_of_rooms():  # no file was edited meanwhile
            _remember(json.dumps({"contents": _contents_of_rooms(), "modules": known}).encode())
    return known[module]


def _code_stores() -> tuple[Path, ...]:
    """Files with fingerprints of code: among the compiled modules, which all users of an installation share, and this user's own."""
    name = "code_fingerprints.json"
    return (ROOT / "flows" / "run" / "__pycache__" / name, cache_folder() / name)


def _remember(data: bytes) -> None:
    """Write the first file of fingerprints that can be written."""
    for store in _code_stores():
        with contextlib.suppress(OSError):
            write_whole(store, data)
            return


def _remembered(store: Path) -> dict[str, str]:
    """Fingerprints of modules that were found for the files as they are now."""
    try:
        read = json_value(store.read_bytes())
        hashes = {str(name): str(value) for name, value in read["modules"].items()} if read["contents"] == _contents_of_rooms() else {}
    except (OSError, KeyError, ValueError, TypeError, AttributeError):
        return {}
    return {name: value for name, value in hashes.items() if re.fullmatch("[0-9a-f]{64}", value)}


def _marks() -> dict[Path, tuple[int, int, int]]:
    """Size and times of every file that may count: those that are edited change."""
    paths = sorted(path for room in ROOMS for path in (ROOT / room).rglob("*") if path.suffix in (".py", *DATA))
    return {path: (stat.st_size, stat.st_mtime_ns, stat.st_ctime_ns) for path in paths for stat in [path.stat()]}


_marks_of_rooms = cache(_marks)
"""Marks of the files as they are when this process reads them first."""


@cache
def _contents_of_rooms() -> str:
    """Hash of all that fingerprints of code are made of: every file that may count, Python's grammar, and how it is done."""
    parts = [f"{path.relative_to(ROOT).as_posix()}={hashlib.sha256(path.read_bytes()).hexdigest()}" for path in _marks_of_rooms()]
    return digest(sys.version, hashlib.sha256(Path(__file__).read_bytes()).hexdigest(), *parts)


def _fingerprint_of(module: str) -> str:
    """The fingerprint of a module's code, from its files."""
    seen: dict[str, Path] = {}
    queue = [module]
    while queue:
        name = queue.pop()
        path = _module_file(name)
        if path is None or name in seen or name in MECHANISM:
            continue
        seen[name] = path
        queue.extend(_code(path)[0])
    folders = sorted({path.parent for path in seen.values() if path.parent.parent != ROOT})
    data = [p for folder in folders for p in sorted(folder.iterdir()) if p.suffix in DATA]
    parts = [f"{name}={_code(path)[1]}" for name, path in sorted(seen.items())]
    parts += [f"{p.relative_to(ROOT)}={hashlib.sha256(p.read_bytes()).hexdigest()}" for p in data]
    return digest(*parts)


@cache
def _module_file(name: str) -> Path | None:
    """The file of a module of ours, or None when it is somebody else's."""
    if name.split(".")[0] not in ROOMS:
        return None
    base = ROOT.joinpath(*name.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.is_file():
            return path
    return None


@cache
def _code(path: Path) -> tuple[tuple[str, ...], str]:
    """Modules named by the import statements of a file, with the packages that they lie in, and the hash of its code. The tree itself is
    let go: hundreds of them would cost the garbage collector more than parsing does."""
    tree = ast.parse(path.read_text())
    imports = _imports(tree)
    return imports, _code_hash(tree)


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """All statements inside one, at any depth: a tenth of its nodes."""
    for field in ("body", "handlers", "cases", "orelse", "finalbody"):
        children = getattr(node, field, None)
        for child in children if isinstance(children, list) else ():  # a lambda's or a condition's is an expression
            yield child
            yield from _statements(child)


def _imports(tree: ast.Module) -> tuple[str, ...]:
    names, sources = [], _sources(tree)
    has_members = MEMBERS in sources.values()  # whose calls may stand anywhere; else only statements are of interest
    for node in ast.walk(tree) if has_members else _statements(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and sources.get(node.func.id) == MEMBERS:
            names += _members(node, sources)
    return (*names, *(name.rpartition(".")[0] for name in names))


MEMBERS = ("tasks.families", "members")
"""What imports the members of an open family by their names."""


def _members(call: ast.Call, sources: Mapping[str, tuple[str, str]]) -> list[str]:
    """Modules that a call of `tasks.families.members` imports.

    Raises:
        ValueError: the package is no literal, or the names come from no module that spells them out.
    """
    package, names = (ast.unparse(argument) for argument in call.args[:2])
    module, variable = sources.get(names, ("", ""))
    file = _module_file(module)
    for node in ast.parse(file.read_text()).body if file is not None else ():
        if isinstance(node, ast.Assign) and [ast.unparse(target) for target in node.targets] == [variable]:
            return [f"{ast.literal_eval(package)}.{name}" for name in ast.literal_eval(node.value)]
    raise ValueError(f"{ast.unparse(call)}: names must be imported from the module that spells them out")


def _sources(tree: ast.Module) -> dict[str, tuple[str, str]]:
    """Where the names come from that a file imports at its top: module, and name there."""
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    return {alias.asname or alias.name: (node.module or "", alias.name) for node in imports for alias in node.names}


def _code_hash(tree: ast.Module) -> str:
    """Hash of a file's code: parsed and printed again, docstrings left out."""
    for node in [tree, *_statements(tree)]:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body
            if body and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant) and isinstance(body[0].value.value, str):
                node.body = body[1:] or [ast.Pass()]
    return hashlib.sha256(ast.unparse(tree).encode()).hexdigest()


class FileHashes:
    """Hashes of files by content, remembered between runs in one small file of the user's cache folder.

    Losing that file costs time, never correctness: an entry counts only when size, inode and change time agree.
    """

    def __init__(self, store: Path | None = None) -> None:
        self._store = store or cache_folder() / "file_hashes.json"
        self._known: dict[str, list[Any]] = {}
        self._changed = False
        try:
            read = json_value(read_file(self._store, self._store.name, BUDGET.json_bytes))
        except (InputError, OSError, ValueError):
            read = None
        if isinstance(read, dict):  # anything else was not written by us, or not whole
            self._known = {path: entry for path, entry in read.items() if isinstance(entry, list) and len(entry) == 5}

    def hash(self, path: Path, name: str = "") -> str:
        """SHA-256 of a file's content; `name` is what errors call it.

        Raises:
            InputError: it is no regular file, or has more bytes than files of its kind.
            OSError: it cannot be read.
        """
        stat = path.stat()
        mark = [stat.st_size, stat.st_ino, stat.st_mtime_ns, stat.st_ctime_ns]
        key = str(path.resolve())
        known = self._known.get(key)
        if known and known[:4] == mark:
            return str(known[4])
        with open_file(path, name or path.name, sane_bytes(path)) as file:
            value = hashlib.file_digest(file, "sha256").hexdigest()
        if time.time() - max(stat.st_mtime, stat.st_ctime) > RACY_SECONDS:
            self._known[key] = [*mark, value]
            self._changed = True
        return value

    def entries(self, root: Path, files: Iterable[Path]) -> list[tuple[str, str]]:
        """Files as their paths relative to `root` and the hashes of their contents, sorted; raises what `hash` raises. One that lies
        elsewhere, as what the scans of a folder share, goes by its name: it is the same wherever it lies."""
        named = [(path.relative_to(root).as_posix() if path.is_relative_to(root) else path.name, path) for path in files]
        return [(name, self.hash(path, f"{root.name}/{name}")) for name, path in sorted(named, key=lambda item: item[0].split("/"))]

    def tree(self, root: Path, files: Iterable[Path]) -> str:
        """Hash of a set of files: their paths relative to `root` and their contents; raises what `hash` raises."""
        return digest(*(f"{path}={value}" for path, value in self.entries(root, files)))

    def save(self) -> None:
        """Write what was learned. Two runs may write at once: the last one wins, whole."""
        if not self._changed:
            return
        try:
            write_whole(self._store, json.dumps(self._known).encode(), cache=True)
        except OSError:  # a read-only home only costs the next run some time
            return
        self._changed = False


class FileCache(MutableMapping[str, bytes]):
    """Values by key in files of a folder, each whole or not there at all. A folder that cannot be written keeps nothing."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._unwritten: dict[str, bytes] = {}

    def __getitem__(self, key: str) -> bytes:
        try:
            return (self._folder / key).read_bytes()
        except OSError:
            if key in self._unwritten:
                return self._unwritten[key]
            raise KeyError(key) from None

    def __setitem__(self, key: str, value: bytes) -> None:
        try:
            write_whole(self._folder / key, value, cache=True)
        except OSError:
            self._unwritten[key] = value

    def __delitem__(self, key: str) -> None:
        if key not in set(self):
            raise KeyError(key)
        self._unwritten.pop(key, None)
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            (self._folder / key).unlink()

    def __iter__(self) -> Iterator[str]:
        written = {path.name for path in self._folder.glob("*") if not path.name.startswith(".")}
        return iter(sorted(written | set(self._unwritten)))

    def __len__(self) -> int:
        return sum(1 for _ in self)


class ModuleCaches:
    """A cache for every module of ours, `caches["tasks.geometry.pieces"]`: all stages share it; a change of its code begins a new one."""

    def __getitem__(self, module: str) -> FileCache:
        if _module_file(module) is None:
            raise KeyError(module)
        return FileCache(cache_folder() / "modules" / f"{module}-{code_fingerprint(module)[:16]}")


def cache_folder() -> Path:
    """Where caches of this machine lie: METASCENES_CACHE, else `metascenes` in the user's cache folder."""
    named = os.environ.get("METASCENES_CACHE")
    if named:
        return Path(named)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "metascenes"


@dataclasses.dataclass(frozen=True)
class Fingerprint:
    """A stage's fingerprint on one scene, with its parts, so that a difference can be explained.

    `facts` are further `<name>=<value>` that are kept beside the parts and decide nothing.
    """

    inputs: tuple[str, ...]
    config: str
    code: str
    seed: int
    facts: tuple[str, ...] = ()

    @property
    def value(self) -> str:
        """The fingerprint itself, 64 hex digits."""
        return digest("fingerprint-1", *self.inputs, "|", self.config, self.code, str(self.seed))

    @property
    def parts(self) -> tuple[str, ...]:
        """Parts as `<part>=<value>`, as `stage_runs.reasons` keeps them."""
        return (*self.inputs, f"config={digest(self.config)}", f"code={self.code}", f"seed={self.seed}", *self.facts)

    def changes(self, before: Sequence[str]) -> list[str]:
        """Names of the parts that differ from an earlier run's `reasons`."""
        old = dict(part.split("=", 1) for part in before)
        new = dict(part.split("=", 1) for part in self.parts)
        facts = {fact.partition("=")[0] for fact in self.facts}
        return [name for name in {**new, **old} if old.get(name) != new.get(name) and name not in facts]
