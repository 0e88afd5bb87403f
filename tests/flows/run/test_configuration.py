"""What a run is told: defaults, a TOML file, single settings, and one line for each that cannot be."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import pytest

from flows.run.configuration import Configuration, configure
from flows.run.fingerprints import canonical_json
from schemas.errors import InputError
from tasks.optimization import Default, Released
from tasks.pipeline import STAGES
from tests.conftest import REPOSITORY


def toml(folder: Path, text: str) -> Path:
    file = folder / "stages.toml"
    file.write_text(text)
    return file


def refusal(*arguments: object, **named: object) -> str:
    """The one line that `configure` refuses its arguments with."""
    with pytest.raises(InputError) as refused:
        configure(*arguments, **named)  # type: ignore[arg-type]
    line = str(refused.value)
    assert len(line.splitlines()) == 1
    return line


def test_without_anything_told_every_stage_has_its_defaults() -> None:
    told = configure()
    assert told == Configuration({stage.name: stage.config() for stage in STAGES}, None, 0)


IDENTITIES = REPOSITORY / "tests" / "golden" / "configs.json"
TOLD = [
    "capture.max_faces=7", "captions.provider.min_points=3", "selection.score.own_geometry=['x']", "annotation.reach_m=3",
    "optimization.method=released", "optimization.method.max_steps=7.0", "optimization.certificate.mujoco.impedance=[0.9, 0.99, 1]",
    "navigation.min_geodesic_m=2", "navigation.path_finder=recast", "navigation.path_finder.cell_size_m=1",
    "exports.formats=['usd', 'glb']",
    "exports.shell.floor_color=[1, 2, 3]", "exports.mjcf.engine.impedance=[0.9, 0.99, 1]", "exports.habitat.agent=robot",
    "exports.usd.instanceable=true", "evaluation.success_m=1",
]  # fmt: skip


def identities() -> dict[str, dict[str, Any]]:
    """The configs as fingerprints know them, by default and as told; content of the label map aside."""
    made = {}
    for name, told in (("default", []), ("told", TOLD)):
        configs = {stage: json.loads(canonical_json(config)) for stage, config in configure(None, told).stages.items()}
        configs["capture"]["label_map_sha256"] = ""
        made[name] = configs
    return made


def test_a_config_of_the_same_values_has_the_identity_that_it_had() -> None:
    """Else every lake would be computed again."""
    kept = json.loads(IDENTITIES.read_text())
    written = json.dumps(identities(), sort_keys=True)  # tells 2.0 from 2
    assert written == json.dumps(kept, sort_keys=True), "a default that changes on purpose is written with: make golden"


def test_a_file_changes_what_it_names_and_nothing_else(tmp_path: Path) -> None:
    text = "[navigation]\nmax_steps = 123\nmin_geodesic_m = 2\n[navigation.agent]\nradius_m = 0.25\n[exports]\nformats = ['usd']\n"
    told, default = configure(toml(tmp_path, text)), configure()
    navigation = told.stages["navigation"]
    assert (navigation.max_steps, navigation.min_geodesic_m, navigation.agent.radius_m) == (123, 2.0, 0.25)
    assert isinstance(navigation.min_geodesic_m, float), "a whole number given for a float field"
    assert told.stages["exports"].formats == ("usd",)
    back = dataclasses.replace(navigation, max_steps=500, min_geodesic_m=1.0, agent=dataclasses.replace(navigation.agent, radius_m=0.18))
    assert back == default.stages["navigation"]
    assert {name for name in told.stages if told.stages[name] != default.stages[name]} == {"navigation", "exports"}


def test_seed_and_library_may_stand_in_the_file_and_arguments_win(tmp_path: Path) -> None:
    (tmp_path / "one").mkdir()
    (tmp_path / "two").mkdir()
    file = toml(tmp_path, f"seed = 7\nlibrary = '{tmp_path / 'one'}'\n[optimization.method]\nmax_moves = 5\n")
    told = configure(file)
    assert (told.seed, told.library, told.stages["optimization"].method.max_moves) == (7, tmp_path / "one", 5)
    told = configure(file, library=tmp_path / "two", seed=3)
    assert (told.seed, told.library) == (3, tmp_path / "two")
    assert configure(file, seed=0).seed == 0, "a seed of 0 that was given is not the same as none"


def test_a_setting_reaches_nested_fields_and_wins_over_the_file(tmp_path: Path) -> None:
    file = toml(tmp_path, "[optimization.method]\nmax_moves = 5\nstep_m = 0.1\n")
    method = configure(file, ["optimization.method.max_moves=9"]).stages["optimization"].method
    assert (method.max_moves, method.step_m) == (9, 0.1)
    settings = [
        "navigation.agent.name=cart",
        "navigation.agent.height_m=0.5",
        "navigation.max_steps=10",
        "navigation.max_steps=11",
        "exports.formats=['habitat']",
    ]
    stages = configure(None, settings).stages
    assert (stages["navigation"].agent.name, stages["navigation"].agent.height_m) == ("cart", 0.5)
    assert stages["navigation"].max_steps == 11, "the last one wins"
    assert stages["exports"].formats == ("habitat",)


def test_a_word_chooses_among_the_methods_of_a_stage(tmp_path: Path) -> None:
    assert configure().stages["optimization"].method == Default()
    told = configure(None, ["optimization.method=released", "optimization.method.step_m=0.1"])
    assert told.stages["optimization"].method == Released(step_m=0.1)
    assert configure(None, ["optimization.method=released", "optimization.method=default"]) == configure()
    for text in ("[optimization]\nmethod = 'released'\n", "[optimization.method]\nkind = 'released'\nmax_steps = 7\n"):
        method = configure(toml(tmp_path, text)).stages["optimization"].method
        assert method == Released(max_steps=7 if "max_steps" in text else Released.max_steps)
    assert "paper, released, default" in refusal(None, ["optimization.method=best"])
    assert configure(None, ["optimization.method.kind=released"]).stages["optimization"].method == Released()
    assert "kind" in refusal(toml(tmp_path, "[navigation.agent]\nkind = 'cart'\n"))


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ("navigations.max_steps=1", "navigations"),
        ("navigation.max_step=1", "max_step"),
        ("navigation.agent.radius=1", "radius"),
        ("navigation.max_steps.more=1", "max_steps"),
        ("navigation.max_steps", "navigation.max_steps"),
        ("navigation=1", "navigation"),
        ("navigation.max_steps=many", "navigation.max_steps"),
        ("navigation.max_steps=1.5", "navigation.max_steps"),
        ("navigation.max_steps=true", "navigation.max_steps"),
        ("navigation.agent.radius_m=[1]", "navigation.agent.radius_m"),
        ("navigation.agent=1", "navigation.agent"),
        ("navigation.agent.radius_m=-1", "radius"),
        ("navigation.stop_m=5", "stop_m"),
        ("navigation.turn_degrees=7", "turn_degrees"),
        ("optimization.method=best", "optimization.method"),
        ("optimization.method=3", "optimization.method"),
        ("exports.formats='usd'", "exports.formats"),
        ("exports.formats=['usd', 3]", "exports.formats"),
        ("candidates.slots=[1, 2]", "candidates.slots"),
        ("=", "="),
        ("", ""),
        ("navigation..=1", "navigation"),
    ],
)
def test_a_setting_that_cannot_be_is_one_line_that_names_it(tmp_path: Path, setting: str, named: str) -> None:
    line = refusal(None, [setting])
    assert "--set" in line
    assert named in line


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[navigations]\nmax_steps = 1\n", "navigations"),
        ("navigation = 3\n", "navigation"),
        ("[navigation]\nmax_step = 1\n", "max_step"),
        ("[navigation]\nmax_steps = 'many'\n", "navigation.max_steps"),
        ("[navigation.agent]\nradius_m = 'wide'\n", "navigation.agent.radius_m"),
        ("[navigation.agent]\nwidth = 1\n", "width"),
        ("[navigation.max_steps]\nmore = 1\n", "max_steps"),
        ("[navigation]\nturn_degrees = 7\n", "turn_degrees"),
        ("[navigation]\nmax_steps = 2026-01-02\n", "navigation.max_steps"),
        ("[optimization.method]\nkind = 'best'\n", "optimization.method"),
        ("seed = 'seven'\n", "seed"),
        ("seed = true\n", "seed"),
        ("seed = 1.5\n", "seed"),
        ("library = 3\n", "library"),
        ("library = 'not/there'\n", "not/there"),
        ("[navigation\n", "stages.toml"),
    ],
)
def test_a_file_that_cannot_be_is_one_line_that_names_file_and_field(tmp_path: Path, text: str, named: str) -> None:
    line = refusal(toml(tmp_path, text))
    assert named in line
    assert "stages.toml" in line or "library" in line


@pytest.mark.parametrize("content", [b"[navigation]\n# \xff\xfe\nmax_steps = 1\n", "[navigation]\nmax_steps = 1\n".encode("utf-16")])
def test_a_file_that_is_not_utf8_is_one_line_that_names_it(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "stages.toml"
    file.write_bytes(content)
    assert "stages.toml" in refusal(file)


def test_a_file_or_library_that_is_not_there_is_one_line_that_names_it(tmp_path: Path) -> None:
    assert "absent.toml" in refusal(tmp_path / "absent.toml")
    (tmp_path / "file.glb").touch()
    assert "file.glb" in refusal(None, [], tmp_path / "file.glb")
    assert "absent" in refusal(None, [], tmp_path / "absent")


def test_every_plain_default_given_back_as_a_setting_changes_nothing() -> None:
    """No default breaks its own rule or the rule of its type."""
    settings = []
    for stage in STAGES:
        config = stage.config()
        for field in dataclasses.fields(config):
            if not field.init:
                continue
            value = getattr(config, field.name)
            if isinstance(value, bool):
                settings.append(f"{stage.name}.{field.name}={str(value).lower()}")
            elif isinstance(value, int | float | str):
                settings.append(f"{stage.name}.{field.name}={value!r}")
    assert len(settings) > 20
    assert configure(None, settings) == configure()


def test_what_is_exported_is_what_is_certified() -> None:
    with pytest.raises(InputError, match=r"exports\.pieces: differ from optimization\.pieces"):
        configure(None, ["exports.pieces.early_share=0.05"])
    both = configure(None, ["exports.pieces.early_share=0.05", "optimization.pieces.early_share=0.05"])
    assert both.stages["exports"].pieces == both.stages["optimization"].pieces
    assert both.stages["exports"].pieces.early_share == 0.05


@pytest.mark.parametrize(("field", "value"), [("forward_m", 0.5), ("turn_degrees", 15.0), ("success_m", 0.3)])
def test_the_exported_robot_is_that_of_the_episodes(field: str, value: float) -> None:
    with pytest.raises(InputError, match=rf"exports\.habitat\.{field}: differs from navigation"):
        configure(None, [f"navigation.{field}={value}"])
    both = configure(None, [f"navigation.{field}={value}", f"exports.habitat.{field}={value}"])
    assert getattr(both.stages["exports"].habitat, field) == getattr(both.stages["navigation"], field) == value


def test_what_is_exported_falls_as_it_is_certified() -> None:
    name = "timestep_s=0.002"
    with pytest.raises(InputError, match=r"exports\.mjcf\.engine: differs from optimization\.certificate\.mujoco"):
        configure(None, [f"optimization.certificate.mujoco.{name}"])
    both = configure(None, [f"optimization.certificate.mujoco.{name}", f"exports.mjcf.engine.{name}"])
    assert both.stages["exports"].mjcf.engine.timestep_s == 0.002


LONG = "1" * 5000
ENDLESS = [
    "1" * 400, "-" + "1" * 400, LONG, f"-{LONG}", f"1.{LONG}", f"1e{LONG}", f"0x{'f' * 5000}", "1e400", "inf", "nan",
    "[" * 500, "[" * 50_000, "[" * 50_000 + "]" * 50_000, "{a=" * 300 + "1" + "}" * 300, "{a=" * 50_000, "a." * 50_000,
    "[" + "1," * 5000 + "]", '"' + "x" * 100_000 + '"',
]  # fmt: skip


@pytest.mark.parametrize("field", ["optimization.steps", "navigation.success_m", "optimization.method", "exports.pieces"])
@pytest.mark.parametrize("value", ENDLESS, ids=lambda text: f"{text[:3]} {len(text)}")
def test_a_number_or_nesting_without_end_is_one_short_line(field: str, value: str, tmp_path: Path) -> None:
    file = toml(tmp_path, f"{field} = {value}")
    deep = f"{field}{'.a' * 50_000}={value}"
    for told in ({"settings": [f"{field}={value}"]}, {"file": file}, {"settings": [deep]}):
        assert len(refusal(**told)) < 1000  # a number of many decimals is none too many, but the exported robot would be another


def test_numbers_and_nesting_without_end_are_refused_as_parameters_of_a_run() -> None:
    deep: Any = 1
    for _ in range(100_000):
        deep = [deep]
    for value in (10**400, 10**5000, -(10**5000), deep, {"a": deep}, float("inf")):
        for stage in STAGES:
            for field in dataclasses.fields(stage.config()):
                assert len(refusal(tables={stage.name: {field.name: value}})) < 2500


@pytest.mark.parametrize("seed", [10**400, -(10**400), 10**5000], ids=["400", "-400", "5000"])
def test_a_seed_without_end_is_refused(seed: int, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="seed: is too large; give a number of up to 18 digits"):
        configure(seed=seed)


@pytest.mark.parametrize(
    ("setting", "said"),
    [
        (
            "optimisation.steps=3",
            "--set: optimisation.steps: there is no stage optimisation; did you mean optimization? stages are capture, ",
        ),
        ("navigaton.max_steps=3", "there is no stage navigaton; did you mean navigation? "),
        ("zzz.max_steps=3", "there is no stage zzz; stages are capture, "),
        ("navigation.max_step=3", "has no field max_step; did you mean max_steps? it has "),
        ("navigation=3", "--set: navigation=3: is not stage.field=value; as in navigation.max_steps=250; stages are capture, "),
        ("navigation.max_steps", "is not stage.field=value"),
    ],
)
def test_a_mistyped_stage_or_field_names_the_nearest(setting: str, said: str) -> None:
    assert said in refusal(settings=[setting])
