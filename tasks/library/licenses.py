"""Licenses as libraries name them, by their SPDX identifiers."""

from __future__ import annotations

import re
from typing import NamedTuple


class License(NamedTuple):
    """name: SPDX identifier, or the text as it is where there is none. is_noncommercial: It allows no commercial use."""

    name: str
    is_noncommercial: bool


UNKNOWN = License("unknown", False)

CURRENT = "4.0"
"""Version of Creative Commons where none is named."""

NAMED = {
    "mit": "MIT", "mit-0": "MIT-0", "apache": "Apache-2.0", "apache-2.0": "Apache-2.0", "bsd-3-clause": "BSD-3-Clause",
    "bsd-2-clause": "BSD-2-Clause", "cc0": "CC0-1.0", "cc0-1.0": "CC0-1.0", "public domain": "CC0-1.0", "odc-by": "ODC-By-1.0",
    "odc-by-1.0": "ODC-By-1.0", "gpl-3.0": "GPL-3.0-only",
}  # fmt: skip
"""Licenses by what people call them."""

_CREATIVE = re.compile(r"^(?:cc[- ]?)?(by(?:[- ](?:nc|sa|nd))*)(?:[- ](\d\.\d))?$")
_URL = re.compile(r"creativecommons\.org/(?:licenses|publicdomain)/([a-z-]+)/(\d\.\d)")
_WORDS = (("attribution", "by"), ("noncommercial", "nc"), ("sharealike", "sa"), ("noderivatives", "nd"), ("noderivs", "nd"))


def license_of(text: str) -> License:
    """The license that a text names: an identifier, Sketchfab's short forms (`by-nc`), a title or an address of Creative Commons.

    >>> license_of("by-nc-sa")
    License(name='CC-BY-NC-SA-4.0', is_noncommercial=True)
    """
    plain = " ".join(text.split())
    if not plain:
        return UNKNOWN
    lower = plain.lower()
    if lower in NAMED:
        return License(NAMED[lower], False)
    words = [*lower.split(), ""]
    if words[0] in NAMED and words[1] in ("text", "license", "licence", "(c)"):
        return License(NAMED[words[0]], False)
    address = _URL.search(lower)
    if address is not None:
        kind, version = address.groups()
        return License("CC0-1.0", False) if kind == "zero" else _creative(kind, version)
    short = lower.removesuffix(" international").removeprefix("creative commons ").replace("non-commercial", "noncommercial")
    for word, sign in _WORDS:
        short = short.replace(word, sign)
    match = _CREATIVE.match(short.replace("share-alike", "sa").replace("share alike", "sa"))
    if match is not None:
        return _creative(match[1].replace(" ", "-"), match[2] or CURRENT)
    return License(plain[:120], bool(re.search(r"non-?\s?commercial|\bnc\b", lower)))


def _creative(kind: str, version: str) -> License:
    return License(f"CC-{kind.upper()}-{version}", "nc" in kind.split("-"))
