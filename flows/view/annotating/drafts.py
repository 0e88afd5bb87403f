"""Drafts: what annotators have begun and not saved, in an SQLite file. A draft is on the disk before its page hears that it was kept."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import sqlite3
import stat
import threading
from collections.abc import Collection, Iterator, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from schemas.errors import InputError, LakeError
from schemas.parsing import json_value
from warehouse.lake import DRAFT_FOLDER

if TYPE_CHECKING:
    from warehouse.lake import Lake
    from warehouse.upkeep.erasure import Traces

LAYOUT = 1
"""Goes up when the table changes."""

_TABLE = """CREATE TABLE drafts (
    batch_id TEXT NOT NULL, scene_id TEXT NOT NULL, instance_id TEXT NOT NULL, annotator TEXT NOT NULL,
    body TEXT, edit INTEGER NOT NULL, page TEXT NOT NULL, saved_at TEXT NOT NULL,
    PRIMARY KEY (batch_id, scene_id, instance_id, annotator)
) WITHOUT ROWID"""
_WAIT_SECONDS = 10.0

Key = tuple[str, str]
"""Scene and instance."""


@dataclasses.dataclass(frozen=True)
class KeptDraft:
    """What an annotator has begun for an object. `body`: as the page sent it; None once it was saved as an answer or thrown away.

    `edit`: the page's count of edits of the object; `page`: which open page counted.
    """

    body: Mapping[str, Any] | None
    edit: int
    page: str
    saved_at: str


class Drafts:
    """The drafts of one batch. Safe for threads, and for several processes."""

    def __init__(self, file: Path, batch_id: str) -> None:
        """Opens the file, or makes it; from then on its owner alone can read it.

        Raises:
            InputError: it cannot be opened, is a link or somebody else's, holds something else, or was written by another version.
        """
        self.file, self._batch, self._lock = file, batch_id, threading.Lock()
        try:
            file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            _check_owner(file)
            self._connection = sqlite3.connect(file, timeout=_WAIT_SECONDS, isolation_level=None, check_same_thread=False)
        except OSError as error:
            raise InputError(str(file), "--drafts", f"cannot be opened ({error.strerror})", "check path and permissions") from error
        except sqlite3.Error as error:
            raise InputError(str(file), "--drafts", f"cannot be opened ({error})", "check path and permissions") from error
        try:
            self._prepare()
            for kept in (file, *(file.with_name(file.name + end) for end in ("-wal", "-shm"))):
                with contextlib.suppress(FileNotFoundError):
                    kept.chmod(0o600)  # only now: a file that is none of ours stays as it is
        except OSError as error:
            self._connection.close()
            raise InputError(str(file), "--drafts", f"cannot be made private ({error.strerror})", "check its permissions") from error
        except sqlite3.Error as error:
            self._connection.close()
            raise InputError(str(file), "--drafts", f"is no file of drafts ({error})", "name another one, or move it away") from error
        except InputError:
            self._connection.close()
            raise

    def _prepare(self) -> None:
        ask = self._connection.execute
        ask("PRAGMA synchronous = FULL")  # each commit is on the disk when it returns
        ask("BEGIN IMMEDIATE")
        try:
            layout = ask("PRAGMA user_version").fetchone()[0]
            if layout == 0 and not ask("SELECT count(*) FROM sqlite_schema").fetchone()[0]:
                ask(_TABLE)
                ask(f"PRAGMA user_version = {LAYOUT}")
            elif layout != LAYOUT or not self._has_table():
                problem = f"has layout {layout} of drafts, this version reads {LAYOUT}"
                remedy = f"save its drafts as answers with the version that wrote it, then remove {self.file.name}"
                raise InputError(str(self.file), "--drafts", problem, remedy)
        finally:
            ask("COMMIT")
        ask("PRAGMA journal_mode = WAL")  # only now: a file that is none of ours stays as it is

    def _has_table(self) -> bool:
        columns = [row[1] for row in self._connection.execute("PRAGMA table_info(drafts)")]
        return columns == ["batch_id", "scene_id", "instance_id", "annotator", "body", "edit", "page", "saved_at"]

    def close(self) -> None:
        """Close the file; what was acknowledged is in it already."""
        with self._lock, contextlib.suppress(sqlite3.Error):
            self._connection.close()

    def save(self, key: Key, annotator: str, body: Mapping[str, Any], edit: int, page: str) -> tuple[bool, KeptDraft]:
        """Keep a draft. Of one page a later edit holds, whichever came first; of several pages what came last.

        Returns whether it was kept, and what is kept now.

        Raises:
            LakeError: it could not be written; nothing changed then.
        """
        draft = KeptDraft(dict(body), edit, page, datetime.now(UTC).isoformat(timespec="milliseconds"))
        with self._changing():
            stored = self._stored(key, annotator)
            is_of_page = stored is not None and page != "" and stored.page == page
            # what was answered is no draft again by an edit from before
            if stored is not None and is_of_page and (edit < stored.edit or (edit == stored.edit and stored.body is None)):
                return False, stored
            self._put(key, annotator, draft)
        return True, draft

    def remove(self, key: Key, annotator: str, edit: int = 0, page: str = "") -> None:
        """Throw a draft away, or take it for saved. Edits of its page up to this one that come late change nothing any more; a later
        one of that page stays.

        Raises:
            LakeError: it could not be written; nothing changed then.
        """
        with self._changing():
            stored = self._stored(key, annotator)
            if stored is not None and page and stored.page == page and stored.edit > edit:
                return
            if stored is not None and not page:
                edit, page = max(edit, stored.edit), stored.page
            if stored is not None or page:
                self._put(key, annotator, KeptDraft(None, edit, page, datetime.now(UTC).isoformat(timespec="milliseconds")))

    def of(self, annotator: str) -> dict[Key, KeptDraft]:
        """An annotator's drafts."""
        with self._asking() as ask:
            rows = ask(
                "SELECT scene_id, instance_id, body, edit, page, saved_at FROM drafts WHERE batch_id = ? AND annotator = ? "
                "AND body IS NOT NULL ORDER BY scene_id, instance_id",
                (self._batch, annotator),
            ).fetchall()
        return {(row[0], row[1]): _draft(row[2:]) for row in rows}

    def count(self) -> dict[str, int]:
        """How many drafts every annotator has."""
        with self._asking() as ask:
            rows = ask(
                "SELECT annotator, count(*) FROM drafts WHERE batch_id = ? AND body IS NOT NULL GROUP BY annotator", (self._batch,)
            ).fetchall()
        return {str(name): int(count) for name, count in rows}

    def erase(self, traces: Traces, dry_run: bool = False) -> int:
        """Remove the drafts of all batches for a scene, so that the file's bytes tell nothing of it; how many there were."""
        with self._asking() as ask:
            counts = ask("SELECT scene_id, count(body) FROM drafts GROUP BY scene_id").fetchall()  # without those that were answered
            scenes = {scene: int(count) for scene, count in counts if traces.in_text(scene)}
        if not dry_run:
            self.remove_scenes(scenes)
        return sum(scenes.values())

    def remove_scenes(self, scenes: Collection[str]) -> None:
        """Remove the drafts of all batches for some scenes, so that the file's bytes tell nothing of them."""
        with self._asking() as ask:
            ask("PRAGMA secure_delete = ON")
            for scene in scenes:
                ask("DELETE FROM drafts WHERE scene_id = ?", (scene,))
            if scenes:
                ask("VACUUM")
            ask("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()

    def _stored(self, key: Key, annotator: str) -> KeptDraft | None:
        row = self._connection.execute(
            "SELECT body, edit, page, saved_at FROM drafts WHERE batch_id = ? AND scene_id = ? AND instance_id = ? AND annotator = ?",
            (self._batch, *key, annotator),
        ).fetchone()
        return None if row is None else _draft(row)

    def _put(self, key: Key, annotator: str, draft: KeptDraft) -> None:
        body = None if draft.body is None else json.dumps(draft.body, allow_nan=False)
        self._connection.execute(
            "INSERT OR REPLACE INTO drafts VALUES (?, ?, ?, ?, ?, ?, ?, ?)",
            (self._batch, *key, annotator, body, draft.edit, draft.page, draft.saved_at),
        )

    @contextlib.contextmanager
    def _asking(self) -> Iterator[Any]:
        with self._lock:
            try:
                yield self._connection.execute
            except sqlite3.Error as error:
                raise LakeError(f"{self.file}: drafts cannot be read or written ({error}); nothing changed") from error

    @contextlib.contextmanager
    def _changing(self) -> Iterator[None]:
        with self._asking() as ask:
            ask("BEGIN IMMEDIATE")
            try:
                yield
                ask("COMMIT")
            except BaseException:
                with contextlib.suppress(sqlite3.Error):  # the first error is the one to say
                    ask("ROLLBACK")
                raise


def _check_owner(file: Path) -> None:
    """Make a file of drafts where there is none.

    Raises:
        InputError: it is a link, or somebody else's: who can change where it leads could read what is written to it.
    """
    if file.is_symlink():
        raise InputError(str(file), "--drafts", "is a link", "name the file itself")
    handle = os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NONBLOCK | os.O_NOFOLLOW, 0o600)
    try:
        kept = os.fstat(handle)
    finally:
        os.close(handle)
    if not stat.S_ISREG(kept.st_mode) or kept.st_nlink > 1 or kept.st_uid != os.geteuid():
        raise InputError(str(file), "--drafts", "is no file of your own", "name another one")


def drafts_folder(lake: Lake) -> Path | None:
    """Where the drafts of a lake's batches lie, a file for each; None for a lake that is in no local folder."""
    return lake.storage.local_path(DRAFT_FOLDER)


def erase_drafts(lake: Lake, traces: Traces, dry_run: bool = False) -> int:
    """Remove the drafts that a lake's folder has for a scene; how many there were, or would go. Drafts in files elsewhere stay.

    Raises:
        InputError: a file there is of another version.
    """
    folder, count = drafts_folder(lake), 0
    for file in sorted(folder.glob("*.sqlite")) if folder is not None else ():
        with contextlib.closing(Drafts(file, file.stem)) as drafts:
            count += drafts.erase(traces, dry_run)
    return count


def _draft(row: tuple[str | None, int, str, str]) -> KeptDraft:
    return KeptDraft(None if row[0] is None else json_value(row[0]), row[1], row[2], row[3])
