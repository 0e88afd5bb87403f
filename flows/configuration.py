"""What a run is told: where the lake is, which scans, the seed, and every stage's config."""

from __future__ import annotations

import dataclasses
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, get_args, get_type_hints

from schemas.errors import InputError
from tasks.pipeline import STAGES


@dataclasses.dataclass(frozen=True)
class Configuration:
    """Settings of a run besides its scans."""

    stages: Mapping[str, Any]
    library: Path | None = None
    seed: int = 0


def configure(
    file: Path | None = None, settings: Sequence[str] = (), library: Path | None = None, seed: int | None = None
) -> Configuration:
    """Configs of all stages: their defaults, then a TOML file's tables, then `stage.field=value` settings.

    Raises:
        InputError: names a stage or field that does not exist, or a value of the wrong type; or exports would take
            other convex pieces or another MuJoCo than certificates, or another robot than episodes.
    """
    told: dict[str, Any] = {}
    origin = "defaults"
    if file is not None:
        origin = file.name
        try:
            told = tomllib.loads(file.read_text())
        except (OSError, ValueError) as error:
            raise InputError(file.name, "content", str(error), "give a TOML file with one table per stage") from error
    named_seed, named_library = told.pop("seed", 0), told.pop("library", None)
    if type(named_seed) is not int or not isinstance(named_library, str | None):
        raise InputError(origin, "seed, library", "must be a whole number and a path", "mend the file")
    seed = seed if seed is not None else named_seed
    library = library or (Path(named_library) if named_library else None)
    if library is not None and not library.is_dir():
        raise InputError(str(library), "library", "is not a folder", "name a folder of GLB files")
    configs = {stage.name: stage.config() for stage in STAGES}
    for name, table in told.items():
        if name not in configs or not isinstance(table, dict):
            raise InputError(origin, name, "is no stage", f"stages are {', '.join(configs)}")
        for field, value in table.items():
            configs[name] = _with(configs[name], [field], value, origin, f"{name}.{field}")
    for setting in settings:
        path, sign, text = setting.partition("=")
        stage, *fields = path.strip().split(".")
        if not sign or stage not in configs or not fields:
            raise InputError("--set", setting, "is not stage.field=value", f"stages are {', '.join(configs)}")
        configs[stage] = _with(configs[stage], fields, _value(text), "--set", path)
    if configs["exports"].pieces != configs["optimization"].pieces:
        problem = "differ from optimization.pieces: what is exported would not be what is certified"
        raise InputError(origin if told else "--set", "exports.pieces", problem, "set both alike")
    if configs["exports"].mjcf.engine != configs["optimization"].certificate.mujoco:
        problem = "differs from optimization.certificate.mujoco: what is exported would not fall as it is certified"
        raise InputError(origin if told else "--set", "exports.mjcf.engine", problem, "set both alike")
    for field in ("forward_m", "turn_degrees", "success_m"):
        if getattr(configs["exports"].habitat, field) != getattr(configs["navigation"], field):
            problem = f"differs from navigation.{field}: the robot of the dataset would not be that of its episodes"
            raise InputError(origin if told else "--set", f"exports.habitat.{field}", problem, "set both alike")
    return Configuration(configs, library, seed)


def _value(text: str) -> Any:
    """A value in TOML's notation; anything that is none is taken as text."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text.strip()


def _with(config: Any, fields: Sequence[str], value: Any, origin: str, path: str) -> Any:
    """`config` with one field, named by its path, set to `value`, checked against the type of the present one.

    Where several configs may stand in a field, a word names one (`method = "paper"`), alone or as `kind` of a table.
    """
    field, *rest = fields
    known = [f.name for f in dataclasses.fields(config)]
    if field not in known:
        raise InputError(origin, path, f"{type(config).__name__} has no field {field}", f"it has {', '.join(known)}")
    present = getattr(config, field)
    if rest:
        if not dataclasses.is_dataclass(present):
            raise InputError(origin, path, f"{field} has no fields of its own", "shorten the path")
        return dataclasses.replace(config, **{field: _with(present, rest, value, origin, path)})
    kinds = _kinds(config, field)
    if kinds and (isinstance(value, str) or (isinstance(value, dict) and "kind" in value)):
        kind, value = (value, {}) if isinstance(value, str) else (value["kind"], {k: v for k, v in value.items() if k != "kind"})
        if kind not in kinds:
            raise InputError(origin, path, f"there is no {kind!r}", f"it is one of {', '.join(kinds)}")
        present = kinds[kind]()
    if isinstance(value, dict) and dataclasses.is_dataclass(present):
        for name, inner in value.items():
            present = _with(present, [name], inner, origin, f"{path}.{name}")
        return dataclasses.replace(config, **{field: present})
    try:
        return dataclasses.replace(config, **{field: _coerce(present, value)})
    except (TypeError, ValueError) as error:
        raise InputError(origin, path, str(error), f"the default is {present!r}") from error


def _kinds(config: Any, field: str) -> dict[str, type]:
    """The configs that a field may hold, by name in lower case without `Config`, where its type is a union of configs."""
    held = get_args(get_type_hints(type(config))[field])
    return (
        {kind.__name__.removesuffix("Config").lower(): kind for kind in held} if held and all(map(dataclasses.is_dataclass, held)) else {}
    )


def _coerce(present: Any, value: Any) -> Any:
    """`value` in the type of `present`; tuples are given as lists."""
    if isinstance(present, bool) or isinstance(value, bool):
        if isinstance(present, bool) and isinstance(value, bool):
            return value
        raise TypeError(f"{value!r} does not fit")
    if isinstance(present, float) and isinstance(value, int | float):
        return float(value)
    if isinstance(present, tuple) and isinstance(value, list) and not any(dataclasses.is_dataclass(p) for p in present):
        return tuple(_coerce(present[0], v) if present else v for v in value)
    if present is None or (type(value) is type(present) and not isinstance(present, tuple)):
        return value
    raise TypeError(f"{value!r} is not a {type(present).__name__}")
