"""Every kind of damage to a Habitat dataset is refused by its rule, and none stops the check."""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tasks.exports.habitat.rules import RULES, check_habitat
from tests.tasks.exports.habitat.habitat_damage import DATASET_DAMAGES
from tests.tasks.exports.habitat.habitat_datasets import office, other_room, write_dataset
from tests.tasks.exports.habitat.habitat_episode_damage import EPISODE_DAMAGES

DAMAGES = DATASET_DAMAGES | EPISODE_DAMAGES


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_dataset(tmp_path_factory.mktemp("place"), [office(), other_room()])


@pytest.fixture
def copy(dataset: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(dataset, tmp_path / "habitat"))


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_refused_by_its_rule(name: str, copy: Path) -> None:
    damage = DAMAGES[name]
    damage.do(copy)
    found = [finding for finding in check_habitat(copy) if finding.is_error]
    said = [f for f in found if f.rule == damage.rule and fnmatch(f.where.split(" ")[0], damage.file) and damage.field in str(f)]
    assert said, "\n".join(map(str, found))


def test_every_rule_has_a_kind_of_damage() -> None:
    assert {damage.rule for damage in DAMAGES.values()} == set(RULES)
    assert len(DAMAGES) > 100, "kinds of damage"


# ---- anything: no damage, however odd, stops the check


_NUMBERS = st.sampled_from([0, -1, 7, 2**31, 10**400, -(10**25), 0.5, -0.0, 1e-320, 1e300, float("nan"), float("inf"), float("-inf")])
_LEAVES = (
    st.none() | st.booleans() | _NUMBERS | st.sampled_from(["", "x", "../x", "/etc/hosts", "\x00", "%%", "\udce4", "*", "**x", "[", "0"])
)
_JUNK = st.recursive(
    _LEAVES,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(["id", "paths", "position", "template_name", ""]), inner),
    max_leaves=6,
)


def places(value: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Ways to everything inside a JSON value; of lists the first items only."""
    inner = value.items() if isinstance(value, dict) else enumerate(value[:3]) if isinstance(value, list) else ()
    for key, item in inner:
        yield (*here, key)
        yield from places(item, (*here, key))


def mutate(value: Any, draw: st.DrawFn) -> Any:
    """The same JSON value with one part replaced, removed, said twice, misspelt or put one level up."""
    where = draw(st.sampled_from([(), *places(value)]))
    if not where:
        return draw(_JUNK)
    holder = value
    for key in where[:-1]:
        holder = holder[key]
    key, kind = where[-1], draw(st.sampled_from(["replace", "replace", "remove", "repeat", "misspell", "unwrap"]))
    if kind == "remove":
        del holder[key]
    elif kind == "repeat" and isinstance(holder, list):
        holder.append(holder[key])
    elif kind == "misspell" and isinstance(holder, dict):
        holder[f"{key}_"] = holder.pop(key)
    elif kind == "unwrap" and isinstance(holder[key], dict | list) and holder[key]:
        inner = holder[key]
        holder[key] = next(iter(inner.values() if isinstance(inner, dict) else inner))
    else:
        holder[key] = draw(_JUNK)
    return value


@st.composite
def damaged(draw: st.DrawFn, path: Path, old: bytes) -> bytes:
    """The bytes of a file after some damage to its JSON, or to its bytes."""
    zipped, is_json = path.suffix == ".gz", path.name.endswith((".json", ".json.gz"))
    if is_json and draw(st.integers(0, 4)):
        value = json.loads(gzip.decompress(old) if zipped else old)
        for _ in range(draw(st.integers(1, 3))):
            value = mutate(value, draw)
        text = json.dumps(value).encode()
        return gzip.compress(text, 1, mtime=0) if zipped else text
    kind = draw(st.sampled_from(["cut", "flip", "empty", "deep", "utf-16", "longer"]))
    at = draw(st.integers(0, len(old) - 1))
    if kind == "cut":
        return old[:at]
    if kind == "flip":
        size = draw(st.sampled_from([1, 2, 4]))
        return old[:at] + draw(st.binary(min_size=size, max_size=size)) + old[at + size :]
    whole = {"empty": b"", "deep": b"[" * 100_000, "utf-16": "{}".encode("utf-16"), "longer": old + b"\0" * 7}[kind]
    return gzip.compress(whole, 1, mtime=0) if zipped and draw(st.booleans()) else whole


class Small:
    """A dataset of one room, and what its files hold."""

    def __init__(self, root: Path) -> None:
        self.root = root
        self.files = {path: path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file() and path.suffix != ".md"}


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Small:
    return Small(write_dataset(tmp_path_factory.mktemp("place"), [other_room()]))


@pytest.mark.whole
@settings(max_examples=120, deadline=None)
@given(data=st.data())
def test_no_damage_stops_the_check(small: Small, data: st.DataObject) -> None:
    root, files = small.root, small.files
    chosen = data.draw(st.lists(st.sampled_from(list(files)), min_size=1, max_size=2, unique=True), "files")
    try:
        for path in chosen:
            path.write_bytes(data.draw(damaged(path, files[path])))
        found = check_habitat(root)
        assert {finding.rule for finding in found} <= set(RULES)
        assert all("\n" not in str(finding) and finding.where for finding in found), "one line each"
    finally:
        for path in chosen:
            path.write_bytes(files[path])


@pytest.mark.whole
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_what_is_cut_short_is_refused_by_name(small: Small, data: st.DataObject) -> None:
    root, files = small.root, small.files
    path = data.draw(st.sampled_from(list(files)), "file")
    old = files[path]
    try:
        path.write_bytes(old[: data.draw(st.integers(0, len(old.rstrip()) - 1))])
        found = [finding for finding in check_habitat(root) if finding.is_error]
        assert any(path.relative_to(root).as_posix() in str(finding) for finding in found), found
    finally:
        path.write_bytes(old)
