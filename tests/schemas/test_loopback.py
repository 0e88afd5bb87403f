"""Spellings of this machine's own addresses, and the proxies that they go past."""

from __future__ import annotations

import os
import urllib.request

import pytest

from schemas.machine.loopback import bypass_proxies, is_loopback, is_this_machine

LOOPBACK = (
    "localhost", "LOCALHOST", "LocalHost", "%6cocalhost", "127.0.0.1", "127.8.9.1", "127.1", "0x7f.1", "0x7f000001",
    "2130706433", "017700000001", "::1", "[::1]", "0:0:0:0:0:0:0:1", "::ffff:127.0.0.1", "[::FFFF:7f00:1]", "\uff11\uff12\uff17.0.0.1",
)  # fmt: skip
NEAR = ("localhost.", "127.0.0.1.", "viewer.localhost", "0.0.0.0", "0", "::", "[::]")
FAR = (
    "example.org", "10.0.0.4", "localhost.a.org", "127.0.0.1.a.org", "fe80::1", "::ffff:10.0.0.4", "128.0.0.1", "notlocalhost", "",
    "127.0.0.256", "a..b", "127", "\ud800",
)  # fmt: skip


@pytest.mark.parametrize("host", LOOPBACK)
def test_loopback_is_known_in_every_spelling(host: str) -> None:
    assert is_loopback(host)
    assert is_this_machine(host)


@pytest.mark.parametrize("host", NEAR)
def test_what_a_resolver_decides_is_near_but_permits_no_secret(host: str) -> None:
    assert not is_loopback(host)
    assert is_this_machine(host)


@pytest.mark.parametrize("host", FAR)
def test_other_machines_are_far(host: str) -> None:
    assert not is_loopback(host)
    assert not is_this_machine(host)


@pytest.fixture
def _no_exceptions(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("no_proxy", "NO_PROXY", "PREFECT_API_URL", "AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3"):
        monkeypatch.setenv(name, "to be restored")
        monkeypatch.delenv(name)


@pytest.mark.usefixtures("_no_exceptions")
def test_loopback_goes_past_proxies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_PROXY", "intern.example, 10.0.0.4")
    monkeypatch.setenv("PREFECT_API_URL", "http://127.1:4200/api")
    monkeypatch.setenv("AWS_ENDPOINT_URL", "https://store.example")
    bypass_proxies()
    once = dict(os.environ)
    bypass_proxies()
    assert dict(os.environ) == once
    for name in ("no_proxy", "NO_PROXY"):
        assert os.environ[name].split(",") == ["intern.example", "10.0.0.4", "localhost", "127.0.0.1", "::1", "127.1"]
    for host in ("localhost:8000", "127.0.0.1:8000", "127.1:4200", "10.0.0.4", "a.intern.example"):
        assert urllib.request.proxy_bypass(host), host
    assert not urllib.request.proxy_bypass("store.example")


@pytest.mark.usefixtures("_no_exceptions")
def test_what_goes_past_all_proxies_stays_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("no_proxy", "*")
    bypass_proxies()
    assert os.environ["no_proxy"] == "*"
