"""Addresses of this machine: spellings of loopback, and proxies that such addresses go past."""

from __future__ import annotations

import ipaddress
import os
import re
import socket
import urllib.parse

LOOPBACK_NAMES = ("localhost", "127.0.0.1", "::1")
"""Hosts for `no_proxy`. In brackets, IPv6 would be an error to Prefect's client."""

ADDRESS_VARIABLES = ("PREFECT_API_URL", "AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3")
"""Variables that may name a server of this machine in a spelling of its own."""

_LISTED = re.compile(r"[\w.:-]+")
_NUMBERS = re.compile(r"[0-9a-fx.]+")


def is_loopback(host: str) -> bool:
    """True if a host can only be this machine's loopback interface, in any spelling that resolvers take.

    Args:
        host: host of an address, as `localhost`, `127.1`, `0x7f000001`, `::1` or `::ffff:127.0.0.1`.
    """
    name = _plain(host)
    address = _numeric_address(name)
    return name == "localhost" or (address is not None and address.is_loopback)


def is_this_machine(host: str) -> bool:
    """True if a host means this machine: loopback, names below `localhost`, and the unspecified address.

    More than `is_loopback`: a resolver may answer otherwise, so it permits no secret in plain text.
    """
    name = _plain(host).rstrip(".")
    address = _numeric_address(name)
    is_unspecified = address is not None and address.is_unspecified
    return is_unspecified or is_loopback(name) or name.endswith(".localhost")


def bypass_proxies() -> None:
    """Add loopback to the hosts that this process and its children reach without a proxy."""
    hosts = list(LOOPBACK_NAMES)
    for variable in ADDRESS_VARIABLES:
        host = host_of(os.environ.get(variable, ""))
        if _LISTED.fullmatch(host) and is_this_machine(host) and host not in hosts:
            hosts.append(host)
    # Libraries look at one spelling or the other.
    present = {name: os.environ[name] for name in ("no_proxy", "NO_PROXY") if name in os.environ}
    for variable, other in (("no_proxy", "NO_PROXY"), ("NO_PROXY", "no_proxy")):
        value = present.get(variable, present.get(other, ""))
        listed = [part.strip() for part in value.split(",") if part.strip()]
        if "*" not in listed:
            os.environ[variable] = ",".join([*listed, *(host for host in hosts if host not in listed)])


def host_of(address: str) -> str:
    """Host of an address, '' if it has none."""
    try:
        return urllib.parse.urlsplit(address).hostname or ""
    except ValueError:
        return ""


def _numeric_address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    """Address that a host spells in numbers; None for a name. An IPv4 address inside of IPv6 counts as itself."""
    try:
        if _NUMBERS.fullmatch(name):
            return ipaddress.IPv4Address(socket.inet_aton(name))
        address = ipaddress.ip_address(name)
    except (ValueError, OSError):
        return None
    return getattr(address, "ipv4_mapped", None) or address


def _plain(host: str) -> str:
    """A host as resolvers see it: without escapes, in ASCII and small letters; '' if it cannot be one."""
    try:
        return urllib.parse.unquote(host).strip("[]").encode("idna").decode().lower()
    except UnicodeError:
        return ""
