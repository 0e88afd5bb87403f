"""Licenses of scans and assets: which may be shipped, whom to name, and what a license asks for.

A license is a text, an SPDX identifier where there is one. Of `A OR B` one may be chosen, `A AND B` asks for both.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path

from schemas.candidates import Asset
from schemas.errors import InputError
from schemas.files import read_file
from schemas.lineage.licenses import is_of_scan, is_partly_unknown, is_unknown, of_asset, scan_of
from warehouse.tables.snapshot import Reader

MAX_LIST_BYTES = 2**20
"""Some ten thousand licenses; SPDX knows seven hundred."""

# Nothing needs to be named or added, at most thanks are due.
_FREE = re.compile(r"cc0-1\.0|mit-0|0bsd|unlicense|pddl-1\.0|cc-pddc|wtfpl|public domain", re.IGNORECASE)

_PARTS: tuple[tuple[str, str], ...] = (
    (r"cc-by\b", "name author and source, link the license, say what was changed"),
    (r"odc-by\b|cdla-permissive\b|cdla-sharing\b", "name the source and the license"),
    (r"-sa\b|odbl\b|cdla-sharing\b|l?gpl|mpl\b", "hand on changed versions under the same license"),
    (r"-nc\b", "no commercial use"),
    (r"-nd\b", "no changed versions; scaling an asset is a change"),
    (r"\bmit\b(?!-0)|bsd-|apache-|\bisc\b|zlib|l?gpl|mpl\b", "add the copyright notice and the text of the license"),
)


@dataclasses.dataclass(frozen=True)
class Allowed:
    """Licenses that may be shipped. Case does not matter; a `*` stands for a version: `CC-BY-*` is no `CC-BY-NC-4.0`.

    What has no license passes only where `unknown` is named.
    """

    names: tuple[str, ...]

    @classmethod
    def parse(cls, values: Iterable[str]) -> Allowed:
        """From values as people give them: licenses, several with commas between, or `@FILE` with one per line (`#` comments).

        Raises:
            InputError: a file cannot be read, or nothing is named.
        """
        names: list[str] = []
        for value in values:
            if value.startswith("@"):
                try:
                    lines = read_file(Path(value[1:]), value[1:], MAX_LIST_BYTES).decode().splitlines()
                except UnicodeError as error:
                    raise InputError(
                        value[1:], "licenses", f"cannot be read ({error})", "name a text file with a license per line"
                    ) from error
                names += [line.partition("#")[0] for line in lines]
            else:
                names += value.split(",")
        stated = tuple(dict.fromkeys(name.strip() for name in names if name.strip()))
        if not stated:
            raise InputError("--license-allow", "", "names no license", "name one, such as CC0-1.0")
        return cls(stated)

    def permits(self, license_: str | None) -> bool:
        """Whether a license, or an expression of several, is among these."""
        if is_unknown(license_):
            return any(is_unknown(name) for name in self.names)
        text = str(license_).strip()
        if self._named(text):
            return True
        tokens = re.findall(r"\(|\)|[^()\s]+", text)
        if not any(token.upper() in ("OR", "AND") for token in tokens):
            return False
        try:
            value, rest = self._either(tokens)
        except IndexError:  # a broken expression states nothing
            return False
        return value and not rest

    def _either(self, tokens: list[str]) -> tuple[bool, list[str]]:
        value, tokens = self._both(tokens)
        while tokens and tokens[0].upper() == "OR":
            other, tokens = self._both(tokens[1:])
            value = value or other
        return value, tokens

    def _both(self, tokens: list[str]) -> tuple[bool, list[str]]:
        value, tokens = self._operand(tokens)
        while tokens and tokens[0].upper() == "AND":
            other, tokens = self._operand(tokens[1:])
            value = value and other
        return value, tokens

    def _operand(self, tokens: list[str]) -> tuple[bool, list[str]]:
        if tokens[0] == "(":
            value, rest = self._either(tokens[1:])
            if rest[0] != ")":
                raise IndexError
            return value, rest[1:]
        words = []
        while tokens and tokens[0] not in "()" and tokens[0].upper() not in ("OR", "AND"):
            words.append(tokens[0])
            tokens = tokens[1:]
        if not words:
            raise IndexError
        name = " ".join(words)
        return (any(map(is_unknown, self.names)) if is_unknown(name) else self._named(name)), tokens

    def _named(self, text: str) -> bool:
        for name in self.names:
            pattern = re.escape(name).replace(r"\*", r"[0-9]+(\.[0-9]+)*")
            if re.fullmatch(pattern, text, re.IGNORECASE) and not is_unknown(text):
                return True
        return False


def with_licenses_of_scans(assets: Sequence[Asset], snapshot: Callable[[], Reader], scene_id: str) -> list[Asset]:
    """A scene's assets, those that were cut from other scans with the license of these, as `snapshot` has it.

    The scene's own scan is left to whoever has its row: it may not be in a snapshot yet.
    """
    sources = {scan_of(asset.source) for asset in assets if is_of_scan(asset.license)} - {scene_id}
    if not sources:
        return list(assets)
    rows = snapshot().matching("scenes", {"scene_id": sources}, ["license"]).to_pylist()
    scans = {row["scene_id"]: row["license"] for row in rows}
    return [
        asset if scan_of(asset.source) == scene_id else replace(asset, license=of_asset(asset.license, asset.source, scans))
        for asset in assets
    ]


def duties(license_: str | None) -> str:
    """What a license asks of whoever hands the work on, in a few words."""
    if is_partly_unknown(license_):
        return "unknown: ask before handing it on"
    text = str(license_).strip()
    if _FREE.fullmatch(text):
        return "nothing"
    parts = [words for pattern, words in _PARTS if re.search(pattern, text, re.IGNORECASE)]
    return "; ".join(dict.fromkeys(parts)) or "read the license"
