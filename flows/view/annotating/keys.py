"""Tokens of the people of a batch, in a file next to its drafts that servers and commands share."""

from __future__ import annotations

import dataclasses
import json
import logging
import os
import stat
from collections.abc import Callable, Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from flows.server.access import new_token
from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file, write_whole
from schemas.wording import meant
from tasks.batches import parse_json
from warehouse.storage.locks import locked
from warehouse.tables.gate import person

_log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class Key:
    """The token of a person; None once it was withdrawn.

    since: time at which it was made or withdrawn, in ISO format; empty where an earlier version made it. roles: as last served.
    """

    token: str | None
    since: str = ""
    roles: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Keys:
    """Keys by name. port: the port that addresses were last given out with, 0 where none were; origin: the address without a path.

    is_exposed: True if other users may read or own the file. Its tokens let nobody in, and the next change replaces them.
    """

    people: dict[str, Key]
    port: int = 0
    origin: str = ""
    is_exposed: bool = False

    def address(self, name: str) -> str | None:
        """The address that lets a person in; None where they have no valid token, or where no server was started yet."""
        token = self.people[name].token
        return f"{self.origin}/?token={token}" if token and self.origin and not self.is_exposed else None


class KeyFile:
    """The file of keys of a batch. Each change reads it again and replaces it under a lock, so that none is lost."""

    def __init__(self, file: Path) -> None:
        self.file = file
        self._sign: tuple[int, ...] | None = None
        self._known: dict[str, str] = {}

    def read(self) -> Keys:
        """The keys as the file has them; none from a link or from a file of another user.

        Raises:
            InputError: the file holds something else.
        """
        try:
            status = os.lstat(self.file)
        except FileNotFoundError:
            return Keys({})
        if not _is_own_file(status):
            return Keys({}, is_exposed=True)
        document = parse_json(read_file(self.file, self.file.name, BUDGET.text_bytes), str(self.file))
        keys = _keys_of(document)
        if keys is None:
            raise InputError(str(self.file), "people", "is not a file of tokens", "remove it; the next start makes new addresses")
        return dataclasses.replace(keys, is_exposed=not _is_private(status))

    def exposure(self) -> str:
        """Warning about an exposed file, with its remedy, in one line."""
        problem = "is not private to this user, so its tokens let nobody in"
        remedy = "serve the batch again, or give `metascenes annotate tokens BATCH --renew NAME`: both make new addresses for all"
        return str(InputError(str(self.file), "mode", problem, remedy))

    def serve(self, roles: Mapping[str, tuple[str, ...]], port: int = 0, origin: str = "") -> Keys:
        """Keys for a server's people: new tokens for those who never had one. A port of 0 leaves port and origin as they were.

        Raises:
            InputError: the file holds something else, or the file system does not keep it private.
        """

        def change(keys: Keys) -> Keys:
            known = {name: dataclasses.replace(keys.people.get(name) or _new(), roles=held) for name, held in roles.items()}
            people = keys.people | known  # a reviewer who is left out once keeps the address
            return Keys(people, port, origin) if port else dataclasses.replace(keys, people=people)

        return self._change(change)

    def change(self, withdrawn: Iterable[str], renewed: Iterable[str], is_dry: bool = False) -> Keys:
        """Withdraw tokens of people, and make new ones for others; the keys afterwards. `is_dry`: leave the file as it is.

        Raises:
            InputError: a name is unknown, the file holds something else, or the file system does not keep it private.
        """

        def change(keys: Keys) -> Keys:
            people = dict(keys.people)
            for name in withdrawn:
                known = self._name(keys, name, "--withdraw")
                if people[known].token is not None:  # of a second withdrawal, the first time stays
                    people[known] = dataclasses.replace(people[known], token=None, since=_now())
            for name in renewed:
                known = self._name(keys, name, "--renew")
                people[known] = _renewed(people[known])
            return dataclasses.replace(keys, people=people)

        return change(_without_exposed(self.read())) if is_dry or not self.file.parent.is_dir() else self._change(change)

    def people(self, names: Iterable[str]) -> dict[str, str]:
        """Some people's names by token, as the file has them now. A file that is gone, damaged or exposed lets nobody in."""
        try:
            kept = os.lstat(self.file)
            sign: tuple[int, ...] = (kept.st_ino, kept.st_mtime_ns, kept.st_ctime_ns, kept.st_size, kept.st_mode)
        except OSError:
            sign = ()
        if sign != self._sign:
            try:
                keys = self.read()
                if keys.is_exposed:
                    _log.warning("%s", self.exposure())
                people = {} if keys.is_exposed else keys.people
                self._known = {key.token: name for name, key in people.items() if key.token}
            except InputError as error:
                _log.warning("%s", error)
                self._known = {}
            self._sign = sign
        wanted = frozenset(names)
        return {token: name for token, name in self._known.items() if name in wanted}

    def _change(self, change: Callable[[Keys], Keys]) -> Keys:
        with locked(self.file.parent):
            keys = change(_without_exposed(self.read()))
            people = {name: dataclasses.asdict(key) for name, key in keys.people.items()}
            document = {"port": keys.port, "origin": keys.origin, "people": people}
            write_whole(self.file, json.dumps(document, ensure_ascii=False).encode(), cache=True)
            # Some file systems drop owner and mode: the new addresses would let nobody in.
            if not _is_private(os.lstat(self.file)):
                problem = "cannot be private: its file system does not keep owner and mode"
                raise InputError(str(self.file), "mode", problem, "name a file on another file system with --drafts")
        return keys

    def _name(self, keys: Keys, name: str, option: str) -> str:
        """The name as the file spells it; letter case tells nobody apart."""
        known = {person(each): each for each in keys.people}
        if person(name) not in known:
            remedy = f"{meant(name, list(keys.people))}known are {', '.join(sorted(keys.people)) or 'none: no server was started'}"
            raise InputError(str(self.file), option, f"{name[:100]!r} has no token of this batch", remedy)
        return known[person(name)]


def _is_own_file(status: os.stat_result) -> bool:
    return stat.S_ISREG(status.st_mode) and status.st_uid == os.geteuid()


def _is_private(status: os.stat_result) -> bool:
    """True if this user alone may read a file."""
    return _is_own_file(status) and not stat.S_IMODE(status.st_mode) & 0o077


def _without_exposed(keys: Keys) -> Keys:
    """Keys with new tokens in place of exposed ones. Withdrawn people stay withdrawn: that is not a secret."""
    if not keys.is_exposed:
        return keys
    people = {name: _renewed(key) if key.token else key for name, key in keys.people.items()}
    return dataclasses.replace(keys, people=people, is_exposed=False)


def _keys_of(document: Any) -> Keys | None:
    """Keys from the content of a file; None where it is something else. Earlier versions wrote tokens alone."""
    if not isinstance(document, dict):
        return None
    port, origin, people = document.get("port"), document.get("origin", ""), document.get("people")
    if people is None and isinstance(document.get("tokens"), dict):
        people = {name: {"token": token} for name, token in document["tokens"].items()}
    if not isinstance(people, dict) or not isinstance(port, int) or not 0 <= port <= 65535 or not isinstance(origin, str):
        return None
    keys = {name: _key_of(entry) for name, entry in people.items()}
    return None if None in keys.values() else Keys({name: key for name, key in keys.items() if key is not None}, port, origin)


def _key_of(entry: Any) -> Key | None:
    if not isinstance(entry, dict) or not {"token"} <= entry.keys() <= {"token", "since", "roles"}:
        return None
    token, since, roles = entry["token"], entry.get("since", ""), entry.get("roles", [])
    is_token = token is None or (isinstance(token, str) and len(token) >= 32)
    is_sound = is_token and isinstance(since, str) and isinstance(roles, list) and all(isinstance(role, str) for role in roles)
    return Key(token, since, tuple(roles)) if is_sound else None


def _new() -> Key:
    return Key(new_token(), _now())


def _renewed(key: Key) -> Key:
    return dataclasses.replace(key, token=new_token(), since=_now())


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
