"""The schema of the parameter `stages` says the same as what `configure` accepts."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import jsonschema
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from flows.run.configuration import TABLES, configs_with, configure
from flows.run.parameters import StageTables, checked_tables, stages_schema
from schemas.errors import InputError
from tasks.candidates.library import LibraryRetrieval
from tasks.candidates.parametric import Parametric
from tasks.candidates.procedural import Procedural
from tasks.candidates.scan_crop import ScanCrop
from tasks.candidates.slots import SlotConfig
from tasks.optimization import Default, Released
from tasks.pipeline import STAGES
from tasks.settings import ByKind
from tests.conftest import REPOSITORY

DEFAULTS = {stage.name: stage.config() for stage in STAGES}
SCHEMA = json.loads(json.dumps(stages_schema()))
VALID = jsonschema.Draft202012Validator(SCHEMA)

WORDS = ["usd", "paper", "default", "xpbd", "recast", "", "é"]
ITEMS = st.one_of(st.floats(0.001, 1), st.integers(0, 255), st.sampled_from(["usd", "glb"]))
PLAIN = st.one_of(st.none(), st.booleans(), st.integers(-3, 10**6), st.floats(-3, 1e6), st.sampled_from(WORDS), st.lists(ITEMS, max_size=4))
"""Values that fit some field or none."""

PROVIDERS = {"procedural": Procedural, "parametric": Parametric, "scan_crop": ScanCrop, "library": LibraryRetrieval}


def kinds_of(config: Any, field: str) -> dict[str, type]:
    """The configs that a field may hold, by the word for each, where there are several."""
    hint = get_type_hints(config, include_extras=True)[field]
    return {kind.kind: kind for kind in get_args(hint.__origin__)} if ByKind in map(type, getattr(hint, "__metadata__", ())) else {}


def slots() -> st.SearchStrategy[list[dict[str, Any]]]:
    """Slots, one more than there may be at most."""
    provider = st.one_of(st.sampled_from(list(PROVIDERS)), *(tables_of(kind(), name) for name, kind in PROVIDERS.items()))
    fallback = st.one_of(st.none(), st.just("procedural"), tables_of(Procedural()), tables_of(Procedural(), "procedural"))
    return st.lists(st.fixed_dictionaries({"provider": provider}, optional={"fallback": fallback}), max_size=11)


def fitting(config: Any, field: str) -> st.SearchStrategy[Any]:
    """Values of a field's type, near its default, told as JSON tells them."""
    present, kinds = getattr(config, field), kinds_of(type(config), field)
    if kinds:
        tables = [tables_of(kind(), name) for name, kind in kinds.items()]
        return st.one_of(st.sampled_from(list(kinds)), *tables, tables_of(present))
    if dataclasses.is_dataclass(present):
        return tables_of(present)
    return plain(get_type_hints(type(config))[field], present)


def plain(kind: Any, present: Any) -> st.SearchStrategy[Any]:
    if kind is bool:
        return st.booleans()
    if kind is int:
        return st.integers(-2, 4).map(lambda more: present + more)
    if kind is float:
        return st.one_of(st.just(present), st.floats(0.9, 1.1).map(lambda share: present * share), st.floats(-1, 1e3))
    if kind is str:
        return st.sampled_from([present, "other"])
    if get_origin(kind) is Literal:
        return st.sampled_from(get_args(kind))
    if get_origin(kind) is tuple and not present:
        return st.lists(st.sampled_from(["alpha", "beta"]), max_size=2)
    if get_origin(kind) is tuple:
        return slots() if isinstance(present[0], SlotConfig) else st.permutations(list(present))
    assert get_origin(kind) in (Union, type(str | None)), f"{kind}: say here how such a value is drawn"
    return st.sampled_from([None, "other"])


def tables_of(config: Any, kind: str | None = None) -> st.SearchStrategy[dict[str, Any]]:
    """Tables of some fields of a config, whose values fit, named by `kind` if there is one."""
    fields = {f.name: fitting(config, f.name) for f in dataclasses.fields(config) if f.init}
    drawn = st.fixed_dictionaries({}, optional=fields)
    return drawn if kind is None else drawn.map(lambda table: {"kind": kind, **table})


@st.composite
def damaged(draw: st.DrawFn, tables: dict[str, Any]) -> dict[str, Any]:
    """Tables with one value, field or stage replaced by something that fits or does not."""
    copy: dict[str, Any] = json.loads(json.dumps(tables))
    place = copy
    while place:
        name = draw(st.sampled_from(sorted(place)))
        if isinstance(place[name], dict) and place[name] and draw(st.booleans()):
            place = place[name]
            continue
        if draw(st.booleans()):
            place[draw(st.sampled_from(["max_step", "kind", "navigation", "radius_m", "x"]))] = place.pop(name)
        else:
            place[name] = draw(PLAIN)
        break
    return copy


FITTING = st.fixed_dictionaries({}, optional={name: tables_of(config) for name, config in DEFAULTS.items()})
NONSENSE = st.dictionaries(st.sampled_from([*DEFAULTS, "seed"]), st.one_of(PLAIN, st.dictionaries(st.text(), PLAIN)))


def rule_between_fields(error: InputError) -> bool:
    """Whether every value is right by itself: a file that one names is not, or two contradict each other. A table needs its kind only
    where the one around it is of another kind than before: then there is none that it could be of."""
    cause = error.__cause__
    return error.file != TABLES or (isinstance(cause, ValidationError) and cause.errors()[0]["type"] in ("value_error", "no_kind"))


def refusal(tables: dict[str, Any]) -> InputError | None:
    """What the configs have against tables."""
    try:
        configs_with(DEFAULTS, tables)
    except InputError as error:
        return error
    return None


@settings(deadline=None)
@given(st.one_of(FITTING.flatmap(damaged), NONSENSE))
def test_the_schema_and_the_configs_accept_the_same_tables_but_for_rules_between_fields(tables: dict[str, Any]) -> None:
    refused = refusal(tables)
    if refused is None:
        VALID.validate(tables)
    elif not rule_between_fields(refused):
        assert not VALID.is_valid(tables), f"only the schema accepts {tables}: {refused}"


@settings(deadline=None)
@given(FITTING)
@example({"candidates": {"slots": [{"provider": "procedural", "fallback": "procedural"}]}})
def test_tables_of_the_right_types_and_limits_arrive_in_the_configs(tables: dict[str, Any]) -> None:
    refused = refusal(tables)
    if refused is not None:
        assert rule_between_fields(refused) or not VALID.is_valid(tables)
        with pytest.raises(ValueError) as told:
            checked_tables(tables)
        assert str(told.value) == str(refused)
        return
    VALID.validate(tables)
    assert checked_tables(tables) is tables
    made = configs_with(DEFAULTS, tables)
    for stage, table in tables.items():
        assert_told(made[stage], DEFAULTS[stage], table)
    assert all(made[name] == DEFAULTS[name] for name in DEFAULTS.keys() - tables.keys())


def assert_told(made: Any, before: Any, table: dict[str, Any]) -> None:
    """`made` has what `table` says and everything else as it was `before`."""
    for field in (f.name for f in dataclasses.fields(made) if f.init):
        kinds = kinds_of(type(before), field)
        value, old = table.get(field, {}), getattr(before, field)
        if kinds and field in table:
            kind = value if isinstance(value, str) else value.get("kind")
            old = kinds[kind]() if kind else old
            value = {} if isinstance(value, str) else {k: v for k, v in value.items() if k != "kind"}
        if field not in table:
            assert getattr(made, field) == old
        elif isinstance(value, list) and old and isinstance(old[0], SlotConfig):
            assert getattr(made, field) == tuple(slot_of(item) for item in value)
        elif dataclasses.is_dataclass(old):
            assert type(getattr(made, field)) is type(old)
            assert_told(getattr(made, field), old, value)
        else:
            told = getattr(made, field)
            assert told == (tuple(value) if isinstance(value, list) else value)
            assert not isinstance(old, float) or isinstance(told, float)


def slot_of(table: dict[str, Any]) -> SlotConfig:
    """The slot that a table says."""

    def provider(value: Any) -> Any:
        if value is None or isinstance(value, str):
            return value and PROVIDERS[value]()
        return PROVIDERS[value.get("kind", "procedural")](**{name: field for name, field in value.items() if name != "kind"})

    return SlotConfig(provider(table["provider"]), provider(table.get("fallback")))


def test_defaults_of_the_schema_are_the_configs_own() -> None:
    """Somebody who sends the whole form back, as filled in, changes nothing."""

    def filled(schema: dict[str, Any]) -> dict[str, Any]:
        return {name: filled(field) if field.get("type") == "object" else field["default"] for name, field in schema["properties"].items()}

    form = filled(SCHEMA)
    VALID.validate(form)
    assert configs_with(DEFAULTS, form) == DEFAULTS
    counted = sum(len(table) for table in form.values())
    assert counted > 50


def test_fields_that_depend_on_each_other_may_come_in_any_order() -> None:
    """JSON objects have no order, and a database may change it."""
    told = {"success_m": 0.5, "stop_m": 0.4}
    for fields in (told, dict(reversed(told.items()))):
        navigation = configs_with(DEFAULTS, {"navigation": fields})["navigation"]
        assert (navigation.success_m, navigation.stop_m) == (0.5, 0.4)
    with pytest.raises(InputError, match="stop_m"):
        configs_with(DEFAULTS, {"navigation": {"stop_m": 0.4}})


def test_tables_go_between_the_file_and_single_settings(tmp_path: Any) -> None:
    file = tmp_path / "stages.toml"
    file.write_text("[navigation]\nmax_steps = 1\ntrain_episodes = 1\ntest_episodes = 1\n")
    told = configure(file, ["navigation.test_episodes=3"], tables={"navigation": {"train_episodes": 2, "test_episodes": 2}})
    navigation = told.stages["navigation"]
    assert (navigation.max_steps, navigation.train_episodes, navigation.test_episodes) == (1, 2, 3)
    told = configure(tables={"optimization": {"method": {"kind": "released", "step_m": 0.1}}})
    assert told.stages["optimization"].method == Released(step_m=0.1)
    assert (
        configure(None, ["optimization.method=default"], tables={"optimization": {"method": "released"}}).stages["optimization"].method
        == Default()
    )
    with pytest.raises(InputError, match=r"^stages: exports\.pieces: differ from optimization\.pieces"):
        configure(tables={"exports": {"pieces": {"faces": 500}}})


def test_stages_that_only_agree_together_with_the_file_pass_the_parameter() -> None:
    """Whether two stages contradict each other is only known once the file was read."""
    tables = {"exports": {"habitat": {"forward_m": 0.5}}}
    assert checked_tables(tables) == tables
    with pytest.raises(InputError, match="forward_m"):
        configure(tables=tables)
    assert configure(None, ["navigation.forward_m=0.5"], tables=tables)


@pytest.mark.parametrize(
    ("tables", "named"),
    [
        ({"navigations": {}}, "navigations"),
        ({"navigation": 3}, "navigation"),
        ({"navigation": {"max_steps": "many"}}, "navigation.max_steps"),
        ({"navigation": {"max_steps": 1.5}}, "navigation.max_steps"),
        ({"navigation": {"max_steps": None}}, "navigation.max_steps"),
        ({"navigation": {"max_steps": True}}, "navigation.max_steps"),
        ({"navigation": {"agent": {"radius": 1}}}, "navigation.agent.radius"),
        ({"optimization": {"method": {"kind": ["paper"]}}}, "optimization.method"),
        ({"optimization": {"certificate": {"newton": {"solver": "best"}}}}, "optimization.certificate.newton.solver"),
        ({"optimization": {"certificate": {"mujoco": {"impedance": [0.9, 0.9]}}}}, "optimization.certificate.mujoco.impedance"),
        ({"capture": {"label_map_sha256": "0" * 64}}, "capture.label_map_sha256"),
        ({"capture": {"label_map": 5}}, "capture.label_map"),
        ({"candidates": {"slots": []}}, "candidates.slots"),
    ],
)
def test_a_wrong_table_is_refused_by_both_in_one_line_that_names_it(tables: dict[str, Any], named: str) -> None:
    assert not VALID.is_valid(tables)
    with pytest.raises(InputError) as refused:
        configs_with(DEFAULTS, tables)
    assert named in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


def test_a_label_map_of_ones_own_is_known_by_its_content(tmp_path: Any) -> None:
    own = tmp_path / "labels.csv"
    own.write_bytes(next((REPOSITORY / "tasks" / "capture").glob("*.csv")).read_bytes() + b"\n")
    told, default = configure(None, [f"capture.label_map={own}"]).stages["capture"], DEFAULTS["capture"]
    assert told.label_map_sha256 not in ("", default.label_map_sha256)


def test_prefect_makes_the_same_schema_of_a_flow_and_refuses_by_the_same_rules() -> None:
    from prefect import flow
    from prefect.exceptions import ParameterTypeError
    from prefect.utilities.callables import parameter_schema

    @flow(name="takes-tables")
    def takes_tables(stages: StageTables = {}) -> None:  # noqa: B006
        """A flow."""

    made = parameter_schema(takes_tables).model_dump()["properties"]["stages"]
    assert {name: value for name, value in made.items() if name not in ("position", "title")} == {
        name: value for name, value in SCHEMA.items() if name != "title"
    }
    takes_tables.validate_parameters({"stages": {"navigation": {"max_steps": 3}}})
    with pytest.raises(ParameterTypeError, match="stop_m"):
        takes_tables.validate_parameters({"stages": {"navigation": {"stop_m": 4.0}}})


def test_a_deployment_of_a_flow_has_the_schema_and_its_import_does_not_make_it() -> None:
    code = (
        "from flows.pipeline import replicate; from flows.run import parameters\n"
        "from prefect.utilities.callables import parameter_schema\n"
        "assert parameters.stages_schema.cache_info().currsize == 0\n"
        "assert replicate.parameters.properties['stages']['type'] == 'object'\n"
        "print(*parameter_schema(replicate).properties['stages']['properties'])"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY).stdout.split()
    assert told == list(SCHEMA["properties"])


def test_the_command_line_does_not_pay_for_it() -> None:
    code = "import sys, flows.cli; print(*sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=REPOSITORY).stdout.split()
    assert not {"flows.run.parameters", "pydantic", "prefect"} & set(loaded)
