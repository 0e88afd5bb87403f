"""Settings of a run: where the lake is, which scans, the seed, and every stage's config."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping, Sequence
from functools import reduce
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from flows.run.libraries import given_library, may_be_name
from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.text import cut
from tasks.pipeline import STAGES
from tasks.settings import LARGEST, Config, adapter, fields_of, first_of, nearest, plain, shown


@dataclasses.dataclass(frozen=True)
class Configuration:
    """Settings of a run besides its scans. library: A folder, or the name of a library of the lake, which comes first."""

    stages: Mapping[str, Any]
    library: Path | None = None
    seed: int = 0


def configure(
    file: Path | None = None,
    settings: Sequence[str] = (),
    library: Path | None = None,
    seed: int | None = None,
    tables: Mapping[str, Mapping[str, Any]] | None = None,
) -> Configuration:
    """Configs of all stages: their defaults, then a TOML file's tables, then `tables`, then `stage.field=value` settings.

    Raises:
        InputError: names a stage or field that does not exist, or a value of the wrong type; or exports would take
            other convex pieces or another MuJoCo than certificates, or another robot than episodes.
    """
    from_file: dict[str, Any] = {}
    origin = TABLES if tables else "defaults"
    if file is not None:
        origin = file.name
        try:
            from_file = tomllib.loads(read_file(file, str(file), BUDGET.settings_bytes).decode("utf-8-sig"))
        except ValueError as error:
            raise InputError(file.name, "content", str(error), "give a TOML file with one table per stage") from error
        except RecursionError as error:
            raise InputError(file.name, "content", "is nested too deep", "give a TOML file with one table per stage") from error
    named_seed, named_library = from_file.pop("seed", 0), from_file.pop("library", None)
    if type(named_seed) is not int or not isinstance(named_library, str | None):
        raise InputError(origin, "seed, library", "must be a whole number and a path", "mend the file")
    seed = seed if seed is not None else named_seed
    if abs(seed) > LARGEST:
        raise InputError(origin, "seed", "is too large", "give a number of up to 18 digits")
    library = library or (given_library(named_library) if named_library else None)
    if library is not None and not library.is_dir() and not may_be_name(library):
        raise InputError(str(library), "library", "is not a folder", "name a folder of models, or a library of the lake")
    configs = configs_with(configs_with({stage.name: stage.config() for stage in STAGES}, from_file, origin), tables or {})
    for setting in settings:
        path, sign, text = setting.partition("=")
        stage, *fields = path.strip().split(".", MOST_LEVELS)
        if not sign or not fields:
            raise InputError(
                "--set", cut(setting), "is not stage.field=value", f"as in navigation.max_steps=250; stages are {', '.join(configs)}"
            )
        if stage not in configs:
            raise InputError("--set", cut(path), f"there is no stage {cut(stage)}", nearest(stage, configs, "stages are"))
        table = reduce(lambda value, field: {field: value}, reversed(fields), _value(text, path))
        configs[stage] = _with_table(configs[stage], table, "--set", stage)
    _check_agreement(configs, "--set" if origin == "defaults" else origin)
    return Configuration(configs, library, seed)


MOST_LEVELS = 16
"""Names in the path of a setting; configs are a third as deep."""

TABLES = "stages"
"""How errors name the tables that came as the parameter of a run."""


def configs_with(configs: Mapping[str, Any], tables: Mapping[str, Any], origin: str = TABLES) -> dict[str, Any]:
    """Stages' configs, overlaid with tables of fields by stage.

    The fields of a table are set together, so that their order does not matter.

    Raises:
        InputError: names a stage or field that does not exist, or a value that breaks its type or its config's own rules.
    """
    made = dict(configs)
    for name, table in tables.items():
        if name not in configs or not isinstance(table, Mapping):
            remedy = nearest(name, configs, "stages are") if name not in configs else "give a table of fields"
            raise InputError(origin, cut(name), "is no stage" if name not in configs else "is no table", remedy)
        made[name] = _with_table(configs[name], table, origin, name)
    return made


def _check_agreement(configs: Mapping[str, Any], origin: str) -> None:
    """Refuse configs of two stages that contradict each other."""
    if configs["exports"].pieces != configs["optimization"].pieces:
        problem = "differ from optimization.pieces: what is exported would not be what is certified"
        raise InputError(origin, "exports.pieces", problem, "set both alike")
    if configs["exports"].mjcf.engine != configs["optimization"].certificate.mujoco:
        problem = "differs from optimization.certificate.mujoco: what is exported would not fall as it is certified"
        raise InputError(origin, "exports.mjcf.engine", problem, "set both alike")
    for field in ("forward_m", "turn_degrees", "success_m"):
        if getattr(configs["exports"].habitat, field) != getattr(configs["navigation"], field):
            problem = f"differs from navigation.{field}: the robot of the dataset would not be that of its episodes"
            raise InputError(origin, f"exports.habitat.{field}", problem, "set both alike")


def _value(text: str, path: str) -> Any:
    """A value in TOML's notation; anything that is none is taken as text.

    Raises:
        InputError: a number of thousands of digits, or brackets in brackets without end.
    """
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text.strip()
    except (ValueError, RecursionError) as error:  # Python's own bounds
        problem = "is nested too deep" if isinstance(error, RecursionError) else "has too many digits"
        raise InputError("--set", cut(path), f"{cut(text)} {problem}", "give a shorter value") from error


def _with_table(config: Any, table: Mapping[str, Any], origin: str, path: str) -> Any:
    """`config` with what a table says."""
    try:
        return adapter(type(config)).validate_python(_overlaid(config, table))
    except ValidationError as error:
        names, problem, remedy = first_of(error)
        present = reduce(lambda held, name: getattr(held, name, None), names, config)
        before = f"it was {shown(plain(present))}" if present is not None else ""
        raise InputError(origin, ".".join([path, *names]), problem, remedy or before) from error


def _overlaid(config: Any, table: Mapping[str, Any]) -> dict[str, Any]:
    """Fields of a config with what a table says in place of them; a table within that names no kind keeps the one there is."""
    fields = {name: getattr(config, name) for name in fields_of(type(config))}
    for name, value in table.items():
        present = fields.get(name)
        if isinstance(value, Mapping) and isinstance(present, Config) and "kind" not in value:
            value = _overlaid(present, value) | ({"kind": present.kind} if present.kind else {})
        fields[name] = value
    return fields
