"""Licenses: which are allowed, and what they ask."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from schemas.errors import InputError
from schemas.lineage.licenses import OF_THE_SCAN, UNKNOWN, all_of, is_of_scan, is_partly_unknown, is_unknown, of_asset
from warehouse.release.licenses import Allowed, duties

NAMES = ("CC0-1.0", "CC-BY-4.0", "CC-BY-NC-4.0", "MIT", "MIT-0", "ScanNet Terms of Use, see the site")


@pytest.mark.parametrize("license_", NAMES)
@pytest.mark.parametrize("spelled", [str.lower, str.upper, str])
def test_a_license_is_allowed_by_its_name_in_any_case_and_by_no_other(license_: str, spelled) -> None:
    allowed = Allowed((spelled(license_),))
    assert [name for name in NAMES if allowed.permits(name)] == [license_]


def test_a_star_stands_for_a_version_and_nothing_else() -> None:
    allowed = Allowed(("CC-BY-*",))
    assert all(allowed.permits(f"CC-BY-{version}") for version in ("4.0", "3.0", "2"))
    assert not any(allowed.permits(name) for name in ("CC-BY-NC-4.0", "CC-BY-SA-4.0", "CC-BY-", "CC-BY-4.0-DE", "XCC-BY-4.0", "unknown"))
    assert not Allowed(("*",)).permits("CC0-1.0")


@pytest.mark.parametrize("unstated", [None, "", " ", "unknown", "UNKNOWN", "NOASSERTION", "none", "not stated"])
def test_what_nobody_stated_passes_only_where_unknown_is_named(unstated: str | None) -> None:
    assert is_unknown(unstated)
    assert not Allowed((*NAMES, "*")).permits(unstated)
    assert Allowed(("unknown",)).permits(unstated)
    assert not Allowed(("unknown",)).permits("CC0-1.0")


trees = st.recursive(
    st.sampled_from(["A-1.0", "B-1.0", "C-1.0"]),
    lambda inner: st.tuples(st.sampled_from(["OR", "AND"]), inner, inner),
    max_leaves=6,
)


def written(tree) -> str:
    return tree if isinstance(tree, str) else f"({written(tree[1])} {tree[0]} {written(tree[2])})"


def value(tree, names: set[str]) -> bool:
    if isinstance(tree, str):
        return tree in names
    return (any if tree[0] == "OR" else all)(value(part, names) for part in tree[1:])


@given(trees, st.sets(st.sampled_from(["A-1.0", "B-1.0", "C-1.0"]), min_size=1))
def test_expressions_mean_what_logic_says(tree, names: set[str]) -> None:
    assert Allowed(tuple(sorted(names))).permits(written(tree)) is value(tree, names)


@pytest.mark.parametrize(
    "broken", ["MIT AND", "OR MIT", "(MIT OR CC0-1.0", "MIT OR CC0-1.0)", "AND", "MIT OR OR MIT", "()", "MIT AND (  )"]
)
def test_a_broken_expression_is_not_allowed(broken: str) -> None:
    assert not Allowed(("MIT", "CC0-1.0")).permits(broken)


def test_and_binds_more_than_or() -> None:
    assert Allowed(("A",)).permits("A OR B AND C")
    assert not Allowed(("C",)).permits("A OR B AND C")
    assert Allowed(("GPL-2.0 WITH Classpath-exception-2.0",)).permits("MIT OR GPL-2.0 WITH Classpath-exception-2.0")
    assert not Allowed(("unknown",)).permits("MIT AND unknown")
    assert Allowed(("unknown", "MIT")).permits("MIT AND unknown")


def test_allowed_licenses_come_from_options_and_files(tmp_path: Path) -> None:
    file = tmp_path / "allowed.txt"
    file.write_text("# ours\nCC0-1.0\n\nScanNet Terms of Use, see the site  # asked on Monday\n")
    assert Allowed.parse(["MIT-0, MIT", f"@{file}", "MIT"]).names == ("MIT-0", "MIT", "CC0-1.0", "ScanNet Terms of Use, see the site")
    for wrong, message in (([f"@{tmp_path / 'none'}"], "cannot be read"), ([""], "names no license"), ([" , "], "names no license")):
        with pytest.raises(InputError, match=message):
            Allowed.parse(wrong)


def test_what_was_cut_from_a_scan_has_its_license() -> None:
    scans = {"demo/a": "CC0-1.0", "demo/b": None}
    assert of_asset(OF_THE_SCAN, "scan demo/a", scans) == "CC0-1.0"
    assert of_asset(OF_THE_SCAN, "scan demo/b", scans) == of_asset(OF_THE_SCAN, "scan demo/gone", scans) == UNKNOWN
    assert of_asset("MIT", "scan demo/b", scans) == "MIT"
    assert of_asset("", "a library", scans) == UNKNOWN


def test_what_was_painted_with_a_scan_has_both_licenses() -> None:
    scans = {"demo/a": "CC0-1.0", "demo/b": None, "demo/c": "MIT OR CC-BY-4.0"}
    both = all_of(["MIT-0 OR 0BSD", OF_THE_SCAN, OF_THE_SCAN, ""])
    assert both == f"(MIT-0 OR 0BSD) AND {OF_THE_SCAN} AND unknown"
    assert of_asset(both, "scan demo/a; chair.glb", scans) == "(MIT-0 OR 0BSD) AND CC0-1.0 AND unknown"
    assert of_asset(both, "scan demo/c; chair.glb", scans) == "(MIT-0 OR 0BSD) AND (MIT OR CC-BY-4.0) AND unknown"
    assert all_of([OF_THE_SCAN, OF_THE_SCAN]) == OF_THE_SCAN
    assert [is_of_scan(text) for text in (OF_THE_SCAN, both, f"({OF_THE_SCAN})", "LicenseRef-scanner", "MIT")] == [True] * 3 + [False] * 2
    painted = of_asset(f"MIT AND {OF_THE_SCAN}", "scan demo/a; chair.glb", scans)
    assert Allowed(("MIT", "CC0-1.0")).permits(painted)
    assert not Allowed(("MIT",)).permits(painted)
    assert not Allowed(("MIT", "CC0-1.0")).permits(of_asset(f"MIT AND {OF_THE_SCAN}", "scan demo/b; chair.glb", scans))


def test_a_license_is_partly_unknown_where_one_of_several_is() -> None:
    assert all(map(is_partly_unknown, (None, "", "unknown", "unknown AND MIT", "CC-BY-4.0 AND unknown", all_of(["", OF_THE_SCAN]))))
    assert not any(map(is_partly_unknown, ("MIT", "CC-BY-4.0 AND MIT", "(MIT OR CC0-1.0) AND CC-BY-4.0", "unknown-license-1.0")))


def test_duties_name_what_a_license_asks() -> None:
    assert duties("CC0-1.0") == duties("mit-0") == "nothing"
    assert "ask" in duties(None)
    assert "ask" in duties("unknown AND CC-BY-4.0"), "what was painted of a model that nobody licensed"
    assert duties("LicenseRef-own") == "read the license"
    words = duties("CC-BY-NC-SA-4.0")
    assert all(part in words for part in ("author", "no commercial use", "same license"))
    assert "commercial" not in duties("CC-BY-4.0")
    assert "copyright notice" in duties("MIT")
    assert "changed versions" in duties("CC-BY-ND-4.0")
