"""Which license holds for an asset. A license is a text, an SPDX identifier where there is one."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

UNKNOWN = "unknown"
"""What stands for a license that nobody stated."""

OF_THE_SCAN = "LicenseRef-scan"
"""The license of assets that were cut from a scan, as `assets` has it: the scan's own. Nothing that leaves the lake says it.

What was painted with a scan's frames has it beside that of the model: `CC-BY-4.0 AND LicenseRef-scan`.
"""

BESIDE = "; "
"""In the source of what was painted with a scan's frames, between the scan and where the model is from."""

UNSTATED = frozenset({"", "unknown", "not stated", "noassertion", "none"})
"""Ways to say that nobody stated a license, in small letters."""


def is_unknown(license_: str | None) -> bool:
    """Whether nobody stated the license."""
    return license_ is None or license_.strip().lower() in UNSTATED


def is_partly_unknown(license_: str | None) -> bool:
    """Whether nobody stated the license, or that of a part of what was made of several things."""
    return is_unknown(license_) or any(is_unknown(each) for each in re.split(r"\sAND\s", str(license_)))


def stated(license_: str | None) -> str:
    """A license, `unknown` where nobody stated it."""
    return UNKNOWN if license_ is None or is_unknown(license_) else license_


def is_of_scan(license_: str) -> bool:
    """Whether an asset has the license of a scan, alone or beside others."""
    return OF_THE_SCAN in re.findall(r"[^\s()]+", license_)


def of_asset(license_: str, source: str, scans: Mapping[str, str | None]) -> str:
    """The license that holds for an asset: that of its scan where it was cut from one. `scans`: license by scene."""
    if not is_of_scan(license_):
        return stated(license_)
    held = stated(scans.get(scan_of(source)))
    return license_.replace(OF_THE_SCAN, _operand(held)) if license_ != OF_THE_SCAN else held


def scan_of(source: str) -> str:
    """The scene whose scan an asset was cut from, or painted with, by the source of such an asset."""
    return source.removeprefix("scan ").partition(BESIDE)[0]


def all_of(licenses: Iterable[str]) -> str:
    """The license of what was made of several things: all of theirs, each once."""
    named = list(dict.fromkeys(stated(license_) for license_ in licenses))
    return " AND ".join(map(_operand, named)) if len(named) > 1 else named[0]


def _operand(license_: str) -> str:
    """A license as a part of an expression that asks for all of several."""
    return f"({license_})" if re.search(r"\sOR\s", license_, re.IGNORECASE) else license_
