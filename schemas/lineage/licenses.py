"""Which license holds for an asset. A license is a text, an SPDX identifier where there is one."""

from __future__ import annotations

from collections.abc import Mapping

UNKNOWN = "unknown"
"""What stands for a license that nobody stated."""

OF_THE_SCAN = "LicenseRef-scan"
"""The license of assets that were cut from a scan, as `assets` has it: the scan's own. Nothing that leaves the lake says it."""

UNSTATED = frozenset({"", "unknown", "not stated", "noassertion", "none"})
"""Ways to say that nobody stated a license, in small letters."""


def is_unknown(license_: str | None) -> bool:
    """Whether nobody stated the license."""
    return license_ is None or license_.strip().lower() in UNSTATED


def stated(license_: str | None) -> str:
    """A license, `unknown` where nobody stated it."""
    return UNKNOWN if license_ is None or is_unknown(license_) else license_


def of_asset(license_: str, source: str, scans: Mapping[str, str | None]) -> str:
    """The license that holds for an asset: that of its scan where it was cut from one. `scans`: license by scene."""
    return stated(scans.get(scan_of(source)) if license_ == OF_THE_SCAN else license_)


def scan_of(source: str) -> str:
    """The scene whose scan an asset was cut from, by the source of such an asset."""
    return source.removeprefix("scan ")
