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

from tasks.exports.habitat_rules import RULES, check_habitat
from tests.habitat_damage import DATASET_DAMAGES, edit
from tests.habitat_datasets import office, other_room, write_dataset
from tests.habitat_episode_damage import EPISODE_DAMAGES

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


_WRONG = [None, 3, -1.5, "x", [], {}, [1], {"a": 1}, True, [None], 1e300, "../x", [[]], [{}], {"id": []}]


def places(value: Any, here: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Ways to everything inside a JSON value; of lists the first items only."""
    yield here
    inner = value.items() if isinstance(value, dict) else enumerate(value[:3]) if isinstance(value, list) else ()
    for key, item in inner:
        yield from places(item, (*here, key))


def test_no_value_of_the_wrong_kind_stops_the_check(copy: Path) -> None:
    import random

    chance = random.Random(5)
    files = sorted(path for path in copy.rglob("*") if path.name.endswith((".json", ".json.gz")) and "objects" not in path.parts)
    noticed = 0
    for _ in range(40):
        path = chance.choice(files)
        old = path.read_bytes()
        where = chance.choice(list(places(json.loads(gzip.decompress(old) if path.suffix == ".gz" else old)))[1:])

        def change(value: Any, where: tuple[Any, ...] = where) -> None:
            for key in where[:-1]:
                value = value[key]
            value[where[-1]] = chance.choice(_WRONG)

        edit(path, change)
        found = check_habitat(copy)
        assert all(finding.rule in RULES for finding in found)
        noticed += bool(found)
        path.write_bytes(old)
    assert noticed > 25, "most such damage is noticed; what the rest hits is free text"
