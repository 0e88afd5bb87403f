"""Who takes part in a batch, and by which token each of them comes in."""

from __future__ import annotations

import dataclasses
import os
import stat
from collections.abc import Iterable, Sequence
from pathlib import Path

from flows.server.access import new_token
from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file, write_whole
from tasks.batches import parse_json
from warehouse.tables.gate import person

ANNOTATOR, REVIEWER = "annotator", "reviewer"


def roles_of(annotators: Iterable[str], reviewers: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Everybody's roles by name. Who answers and reviews is one person, by the name that was asked; letter case tells nobody apart.

    Raises:
        InputError: a reviewer's name cannot be used.
    """
    names = {person(name): name for name in sorted(annotators)}
    roles = {name: [ANNOTATOR] for name in names.values()}
    for name in reviewers:
        if not name.strip() or name != name.strip() or not name.isprintable() or len(name) > 100:
            raise InputError("--reviewer", repr(name[:60]), "is no name", "give up to 100 letters without spaces around them")
        known = names.setdefault(person(name), name)
        if REVIEWER not in roles.setdefault(known, []):
            roles[known].append(REVIEWER)
    return {name: tuple(held) for name, held in roles.items()}


@dataclasses.dataclass(frozen=True)
class Keys:
    """Tokens by name, and the port that they were last given out with; 0 where there is none yet."""

    tokens: dict[str, str]
    port: int = 0


def kept_keys(file: Path, names: Iterable[str]) -> Keys:
    """The tokens in a file, and new ones for people who have none there; all new where others could have read it.

    Raises:
        InputError: the file holds something else.
    """
    known = _read(file)
    return Keys({name: known.tokens.get(name) or new_token() for name in names}, known.port)


def keep_keys(file: Path, keys: Keys) -> None:
    """Write tokens down, for their owner alone, so that a server that starts again gives the same addresses."""
    import json

    known = _read(file).tokens  # a reviewer who is left out once keeps the address
    write_whole(file, json.dumps({"port": keys.port, "tokens": known | keys.tokens}, ensure_ascii=False).encode(), cache=True)


def _read(file: Path) -> Keys:
    try:
        kept = os.lstat(file)
    except FileNotFoundError:
        return Keys({})
    if not stat.S_ISREG(kept.st_mode) or kept.st_uid != os.geteuid() or stat.S_IMODE(kept.st_mode) & 0o077:
        return Keys({})
    document = parse_json(read_file(file, file.name, BUDGET.text_bytes), str(file))
    tokens = document.get("tokens") if isinstance(document, dict) else None
    port = document.get("port") if isinstance(document, dict) else None
    is_known = isinstance(tokens, dict) and all(isinstance(token, str) and len(token) >= 32 for token in tokens.values())
    if not is_known or not isinstance(port, int) or not 0 <= port <= 65535:
        raise InputError(str(file), "tokens", "is no file of tokens", "remove it; the next start makes new addresses")
    assert isinstance(tokens, dict)
    return Keys(tokens, port)
