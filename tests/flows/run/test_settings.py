"""Every field of every config: set alike from everywhere, held against its type, explained, and refused in code, too."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args, get_type_hints

import pytest

from flows.documentation.settings import configuration_page
from flows.run.configuration import configs_with, configure
from flows.run.fingerprints import canonical_json
from flows.run.parameters import stages_schema
from schemas.errors import InputError
from tasks.candidates import CandidatesConfig
from tasks.candidates.library import LibraryRetrieval
from tasks.candidates.procedural import Procedural
from tasks.candidates.scan_crop import ScanCrop
from tasks.candidates.slots import SlotConfig
from tasks.navigation.configuration import Agent, NavigationConfig
from tasks.navigation.planar import PlanarConfig
from tasks.navigation.recast import RecastConfig
from tasks.optimization import Default, OptimizationConfig, Released
from tasks.pipeline import STAGES
from tasks.settings import ByKind, ByWord, Config, reasons
from tasks.shell import ShellConfig
from tests.conftest import REPOSITORY

DEFAULTS = {stage.name: stage.config() for stage in STAGES}

Leaf = tuple[tuple[str, ...], Any, tuple[str, ...]]


def leaves(schema: dict[str, Any], path: tuple[str, ...] = (), kinds: tuple[str, ...] = ()) -> Iterator[Leaf]:
    """Path and schema of every field that holds no table, with the settings that choose the kinds on the way."""
    for name, field in schema["properties"].items():
        place = (*path, name)
        if name == "kind":
            continue
        if field.get("type") == "object":
            yield from leaves(field, place, kinds)
            continue
        yield place, field, kinds
        for table in field.get("anyOf", []):
            kind = table.get("properties", {}).get("kind")
            if kind and "items" not in field:
                yield from leaves(table, place, (*kinds, f"{'.'.join(place)}={kind['const']}"))


LEAVES = list(leaves({"properties": stages_schema()["properties"]}))
NAMES = [" ".join([*kinds, ".".join(path)]) for path, _, kinds in LEAVES]


def configs() -> Iterator[type[Config]]:
    """The class of every config and of every table in one."""
    waiting = Config.__subclasses__()
    while waiting:
        yield (config := waiting.pop())
        waiting += config.__subclasses__()


def table_of(path: tuple[str, ...], value: Any) -> dict[str, Any]:
    for name in reversed(path):
        value = {name: value}
    return dict(value)


def test_no_field_is_left_out() -> None:
    """The fields of the schema are those of the classes, a union's configs each with its own."""

    def count(config: Config) -> int:
        counted = 0
        for field in dataclasses.fields(config):
            hint, present = get_type_hints(type(config), include_extras=True)[field.name], getattr(config, field.name)
            marks = set(map(type, getattr(hint, "__metadata__", ())))
            if ByKind in marks:
                counted += 1 + sum(count(kind()) for kind in get_args(hint.__origin__))
            elif ByWord in marks:
                counted += 1 + count(present)
            elif field.init:
                counted += count(present) if isinstance(present, Config) else 1
        return counted

    assert len(set(NAMES)) == len(LEAVES) == sum(map(count, DEFAULTS.values())) > 200


@pytest.mark.parametrize(("path", "schema", "kinds"), LEAVES, ids=NAMES)
def test_a_default_given_back_changes_nothing_wherever_it_is_given(
    path: tuple[str, ...], schema: Any, kinds: tuple[str, ...], tmp_path: Path
) -> None:
    before = configure(None, kinds).stages
    value = schema["default"]
    assert configs_with(before, table_of(path, value)) == before
    if value is None or (isinstance(value, list) and value and isinstance(value[0], dict)):  # TOML has no null; slots come below
        return
    items = [f"{name} = {json.dumps(held)}" for name, held in value.items()] if isinstance(value, dict) else []
    setting = f"{'.'.join(path)}={'{' + ', '.join(items) + '}' if items else json.dumps(value)}"
    assert configure(None, [*kinds, setting]).stages == before
    file = tmp_path / "settings.toml"
    file.write_text("\n".join([*(re.sub("=(.*)", r".kind='\1'", kind) for kind in kinds), setting]))
    assert configure(file).stages == before


WRONG: list[Any] = [
    10**19, 10**400, float("nan"), float("inf"), [[]], {"a": 1}, object(), "\x1b[31m", True, "1", b"1", 1.5, 7, None, ["x", 1],
]  # fmt: skip


@pytest.mark.parametrize(("path", "schema", "kinds"), LEAVES, ids=NAMES)
def test_no_value_of_another_type_gets_in(path: tuple[str, ...], schema: Any, kinds: tuple[str, ...]) -> None:
    before = configure(None, kinds).stages
    default = schema["default"]
    for value in WRONG:
        try:
            made: Any = configs_with(before, table_of(path, value))
        except InputError as error:
            text = str(error)
            assert len(text.splitlines()) == 1
            assert len(text) < 900
            assert "\x1b" not in text
            continue
        for name in path:
            made = made[name] if isinstance(made, dict) else getattr(made, name)
        if made is None or isinstance(made, str):  # a path, or a text, or none of either
            assert made == value
            assert default is None or isinstance(default, str)
        else:
            assert made == value
            assert type(made) is type(default)
            assert type(value) is not bool or isinstance(default, bool)
            assert not isinstance(value, str)


SLOTS = (SlotConfig(Procedural(2)), SlotConfig(ScanCrop("pieces")), SlotConfig(LibraryRetrieval(3), fallback=Procedural(9)))
SLOT_TABLES = [
    {"provider": {"kind": "procedural", "variant": 2}},
    {"provider": {"kind": "scan_crop", "mode": "pieces"}},
    {"provider": {"kind": "library", "k": 3}, "fallback": {"variant": 9}},
]
SLOTS_TOML = """[{provider = {kind = "procedural", variant = 2}}, {provider = {kind = "scan_crop", mode = "pieces"}}, \
{provider = {kind = "library", k = 3}, fallback = {variant = 9}}]"""


def test_slots_are_set_alike_from_everywhere(tmp_path: Path) -> None:
    file = tmp_path / "settings.toml"
    file.write_text(f"[candidates]\nslots = {SLOTS_TOML}\n")
    tables = {"candidates": {"slots": SLOT_TABLES}}
    for made in (configure(file), configure(None, [f"candidates.slots={SLOTS_TOML}"]), configure(tables=tables)):
        assert made.stages["candidates"] == CandidatesConfig(SLOTS)
    short = {"candidates": {"slots": [{"provider": "library", "fallback": "procedural"}]}}
    assert configs_with(DEFAULTS, short)["candidates"].slots == (SlotConfig(LibraryRetrieval(), Procedural()),)


@pytest.mark.parametrize(
    ("slots", "problem"),
    [
        ([], "candidates.slots: must be a list of at least 1, is []"),
        ([{"provider": "library"}] * 11, "candidates.slots: must be a list of at most 10, is "),
        ([{"provider": "libary"}], "must name a kind, is 'libary'; it is one of procedural, parametric, scan_crop, library"),
        ([{"provider": {"variant": 2}}], "candidates.slots: item 1: provider: must name a kind, is {'variant': 2}; it is one of "),
        ([{}], "candidates.slots: item 1: provider: is missing"),
        ([{"provider": "library", "fallback": {"kind": "scan_crop"}}], "must name a kind, is {'kind': 'scan_crop'}; it is procedural"),
        ([SLOT_TABLES[0], {"provider": {"kind": "library", "variant": 2}}], "item 2: provider: variant: LibraryRetrieval has no field "),
        ([{"provider": "library", "fallbak": "procedural"}], "SlotConfig has no field fallbak; did you mean fallback? it has "),
        ([{"provider": {"kind": "scan_crop", "mode": "open"}}], "item 1: provider: mode: must be closed or pieces, is 'open'"),
    ],
)  # fmt: skip
def test_a_slot_that_cannot_be_is_named(slots: Any, problem: str) -> None:
    with pytest.raises(InputError, match=re.escape(problem)):
        configs_with(DEFAULTS, {"candidates": {"slots": slots}})


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: Agent(radius_m="0.2"), "radius_m: must be a finite number, is '0.2'"),  # type: ignore[arg-type]
        (lambda: Agent(radius_m=True), "radius_m: must be a finite number, is True"),
        (lambda: Agent(name=3), "name: must be a text, is 3"),  # type: ignore[arg-type]
        (lambda: Released(max_steps=1.5), "max_steps: must be a whole number, is 1.5"),  # type: ignore[arg-type]
        (lambda: Released(max_steps=10**19), "max_steps: 10000000000000000000 is too large"),
        (lambda: Default(cooling=1.0), "cooling: must be below 1, is 1"),
        (lambda: OptimizationConfig(method=Agent()), "method: must name a kind, is Agent("),  # type: ignore[arg-type]
        (lambda: OptimizationConfig(supports=Agent()), "supports: must be a table of fields, is Agent("),  # type: ignore[arg-type]
        (lambda: NavigationConfig(path_finder="best"), "path_finder: must name a kind, is 'best'"),  # type: ignore[arg-type]
        (lambda: ShellConfig(floor_color=(1, 2)), "floor_color: item 3: is missing"),  # type: ignore[arg-type]
        (lambda: dataclasses.replace(Agent(), height_m=0.1), "height_m: must be above max_climb_m, 0.2, is 0.1"),
        (lambda: SlotConfig(PlanarConfig()), "provider: must name a kind, is PlanarConfig("),  # type: ignore[arg-type]
    ],
)
def test_what_cannot_be_is_refused_in_code_too(make: Any, problem: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(problem)}") as refused:
        make()
    assert len(str(refused.value).splitlines()) == 1


def test_equal_numbers_have_one_identity() -> None:
    """A whole number for a length is that length, and 2.0 for a count is 2, whoever says it."""
    assert canonical_json(Agent(radius_m=1, height_m=2)) == canonical_json(Agent(radius_m=1.0, height_m=2.0))
    assert canonical_json(Released(max_steps=7.0)) == canonical_json(Released(max_steps=7))  # type: ignore[arg-type]
    assert canonical_json(RecastConfig()) != canonical_json(PlanarConfig())


def test_every_config_is_one_of_settings_and_names_its_kind_where_others_could_stand() -> None:
    for config in configs():
        assert config.__dataclass_params__.frozen  # type: ignore[attr-defined]
    for path, schema, _ in LEAVES:
        for words in (part["enum"] for part in schema.get("anyOf", []) if "enum" in part):
            assert all(words), f"{path}: a config without kind"
            assert len(set(words)) == len(words)


def test_the_page_of_settings_is_what_the_configs_say() -> None:
    page = configuration_page()
    assert (REPOSITORY / "docs" / "configuration.md").read_text() == page, "write it with: make golden"
    for path, schema, _ in LEAVES:
        assert f"| `{'.'.join(path)}` | " in page
        assert schema["description"], f"{path} has no reason"
    for config in configs():
        assert set(reasons(config)) <= {field.name for field in dataclasses.fields(config)}
