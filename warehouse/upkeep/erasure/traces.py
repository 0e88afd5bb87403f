"""What would tell that a scene was in the lake: its names in all spellings, and the hashes of what only it had."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator
from functools import cached_property

from warehouse.tables.staging import quoted_scene

ERASED = "erased"
"""What stands in the place of a name in texts that other rows have to keep."""

_START = r"(?:(?<![A-Za-z0-9])|(?<=\\[bfnrt])|(?<=\\u[0-9A-Fa-f]{4}))"
"""No letter or digit stands before a name, unless it ends an escape of JSON: the n of a line break is no part of a word."""

_HASH = rb"(?<![0-9a-f])[0-9a-f]{64}(?![0-9a-f])"


@dataclasses.dataclass(frozen=True)
class Traces:
    """Names and hashes to look for.

    `names` are spellings, `spared` names of other scenes that hold one of them, `hashes` 64 hex digits each. A name
    counts where no letter or digit stands right before or after it and it is no part of a spared name. Line breaks and
    other escapes of JSON do not count as letters.
    """

    names: frozenset[str]
    spared: frozenset[str] = frozenset()
    hashes: frozenset[str] = frozenset()

    def __or__(self, other: Traces) -> Traces:
        return Traces(self.names | other.names, self.spared | other.spared, self.hashes | other.hashes)

    @cached_property
    def cores(self) -> tuple[str, ...]:
        """The shortest names: a text that holds any name holds one of these."""
        return tuple(sorted(name for name in self.names if not any(other != name and other in name for other in self.names)))

    def redacted(self, text: str) -> str:
        """The text with every name replaced."""
        return self._text.sub(lambda match: match[0] if match["other"] is not None else ERASED, text)

    def in_text(self, text: str) -> bool:
        """Whether a text holds a name or a hash."""
        return any(True for _ in self.in_bytes(text.encode(errors="surrogatepass")))  # of paths that are not UTF-8

    def in_bytes(self, data: bytes) -> Iterator[str]:
        """The names and hashes that bytes hold, as often as they do."""
        if any(core in data for core in self._core_bytes):
            for match in self._bytes.finditer(data):
                if match["other"] is None:
                    yield match[0].decode()
        if self.hashes:
            for match in re.finditer(_HASH, data):
                if match[0].decode() in self.hashes:
                    yield match[0].decode()

    @cached_property
    def _core_bytes(self) -> tuple[bytes, ...]:
        return tuple(core.encode() for core in self.cores)

    @cached_property
    def _text(self) -> re.Pattern[str]:
        return re.compile(self._pattern)

    @cached_property
    def _bytes(self) -> re.Pattern[bytes]:
        return re.compile(self._pattern.encode())

    @property
    def _pattern(self) -> str:
        own, other = (_alternatives(names) for names in (self.names, self.spared))
        return f"(?P<other>{other})|{own}" if self.spared else f"(?P<other>(?!))|{own}"


def spellings(name: str) -> set[str]:
    """How a scene's or room's `<dataset>/<scan>` is written in tables, file names, addresses and JSON."""
    return {name, name.replace("/", "_"), name.replace("/", "%2F"), name.replace("/", "\\/"), quoted_scene(name)}


def is_telling(name: str) -> bool:
    """Whether a scan's bare name can be no word of the language: `scene0001_00` cannot, `kitchen` and `room2` can."""
    return len(name) >= 6 and any(character.isdigit() for character in name)


def traces_of(scene_id: str, rooms: Iterable[str], other_names: Iterable[str]) -> Traces:
    """Traces of a scene. `rooms` are those that it alone shows, `others` the ids of all other scenes and their rooms."""
    other_names = set(other_names) - {scene_id}
    names: set[str] = set()
    for name in {scene_id, *rooms} - other_names:
        names |= spellings(name)
        bare = name.partition("/")[2]
        if is_telling(bare) and not any(other.partition("/")[2] == bare for other in other_names):
            names.add(bare)
    cores = Traces(frozenset(names)).cores
    spared = {
        spelled
        for other in other_names
        for spelled in {*spellings(other), other.partition("/")[2]}
        if any(core in spelled for core in cores)
    }
    return Traces(frozenset(names), frozenset(spared - names))


def _alternatives(names: Iterable[str]) -> str:
    """A pattern of names, the longest first."""
    ordered = sorted(names, key=lambda name: (-len(name), name))
    return f"{_START}(?:{'|'.join(map(re.escape, ordered))})(?![A-Za-z0-9])"
