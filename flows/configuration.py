"""What a run is told: where the lake is, which scans, the seed, and every stage's config."""

from __future__ import annotations

import dataclasses
import difflib
import math
import tomllib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from tasks.pipeline import STAGES


@dataclasses.dataclass(frozen=True)
class Configuration:
    """Settings of a run besides its scans."""

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
    told: dict[str, Any] = {}
    origin = TABLES if tables else "defaults"
    if file is not None:
        origin = file.name
        try:
            told = tomllib.loads(read_file(file, str(file), BUDGET.settings_bytes).decode("utf-8-sig"))
        except ValueError as error:
            raise InputError(file.name, "content", str(error), "give a TOML file with one table per stage") from error
        except RecursionError as error:
            raise InputError(file.name, "content", "is nested too deep", "give a TOML file with one table per stage") from error
    named_seed, named_library = told.pop("seed", 0), told.pop("library", None)
    if type(named_seed) is not int or not isinstance(named_library, str | None):
        raise InputError(origin, "seed, library", "must be a whole number and a path", "mend the file")
    seed = seed if seed is not None else named_seed
    if abs(seed) > LARGEST:
        raise InputError(origin, "seed", "is too large", "give a number of up to 18 digits")
    library = library or (Path(named_library) if named_library else None)
    if library is not None and not library.is_dir():
        raise InputError(str(library), "library", "is not a folder", "name a folder of GLB files")
    configs = configs_with(configs_with({stage.name: stage.config() for stage in STAGES}, told, origin), tables or {})
    for setting in settings:
        path, sign, text = setting.partition("=")
        stage, *fields = path.strip().split(".", MOST_LEVELS)
        if not sign or not fields:
            raise InputError(
                "--set", _cut(setting), "is not stage.field=value", f"as in navigation.max_steps=250; stages are {', '.join(configs)}"
            )
        if stage not in configs:
            raise InputError("--set", _cut(path), f"there is no stage {_cut(stage)}", _nearest(stage, configs, "stages are"))
        configs[stage] = _with(configs[stage], fields, _value(text, path), "--set", path)
    _check_agreement(configs, "--set" if origin == "defaults" else origin)
    return Configuration(configs, library, seed)


LARGEST = 10**18
"""Of whole numbers that settings take; more does not fit into 64 bits."""

MOST_LEVELS = 16
"""Names in the path of a setting; configs are a third as deep."""

TABLES = "stages"
"""How errors name the tables that came as the parameter of a run."""


def configs_with(configs: Mapping[str, Any], tables: Mapping[str, Any], origin: str = TABLES) -> dict[str, Any]:
    """Stages' configs with what tables say, a table of fields for each stage that is told anything.

    The fields of a table are set together, so that their order does not matter.

    Raises:
        InputError: names a stage or field that does not exist, or a value that breaks its type or its config's own rules.
    """
    made = dict(configs)
    for name, table in tables.items():
        if name not in configs or not isinstance(table, Mapping):
            remedy = _nearest(name, configs, "stages are") if name not in configs else "give a table of fields"
            raise InputError(origin, _cut(name), "is no stage" if name not in configs else "is no table", remedy)
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
        raise InputError("--set", _cut(path), f"{_cut(text)} {problem}", "give a shorter value") from error


def _with(config: Any, fields: Sequence[str], value: Any, origin: str, path: str) -> Any:
    """`config` with one field, named by its path, set to `value`."""
    field, *rest = fields
    if not rest:
        return _with_table(config, {field: value}, origin, path.rpartition(".")[0])
    _check_known(config, field, origin, path)
    present = getattr(config, field)
    if not dataclasses.is_dataclass(present):
        raise InputError(origin, _cut(path), f"{_cut(field)} has no fields of its own", "shorten the path")
    return dataclasses.replace(config, **{field: _with(present, rest, value, origin, path)})


def _with_table(config: Any, table: Mapping[str, Any], origin: str, path: str) -> Any:
    """`config` with a table's fields, each checked against its type, all set at once."""
    told = {field: _told(config, field, value, origin, f"{path}.{field}") for field, value in table.items()}
    try:
        return dataclasses.replace(config, **told)
    except (TypeError, ValueError) as error:
        defaults = ", ".join(f"{field} {getattr(config, field)!r}" for field in told)
        raise InputError(origin, f"{path}.{next(iter(told))}" if len(told) == 1 else path, str(error), f"it was {defaults}") from error


def _told(config: Any, field: str, value: Any, origin: str, path: str) -> Any:
    """What a field is to hold.

    Where several configs may stand in a field, a word names one (`method = "paper"`), alone or as `kind` of a table.
    """
    _check_known(config, field, origin, path)
    present, kinds = getattr(config, field), kinds_of(type(config), field)
    if kinds and (isinstance(value, str) or (isinstance(value, Mapping) and "kind" in value)):
        kind, value = (value, {}) if isinstance(value, str) else (value["kind"], {k: v for k, v in value.items() if k != "kind"})
        if not isinstance(kind, str) or kind not in kinds:
            raise InputError(origin, path, f"there is no {_shown(kind)}", f"it is one of {', '.join(kinds)}")
        present = kinds[kind]()
    if isinstance(value, Mapping) and dataclasses.is_dataclass(present):
        return _with_table(present, value, origin, path)
    try:
        return _coerce(types_of(type(config))[field], value)
    except TypeError as error:
        raise InputError(origin, path, str(error), f"the default is {present!r}") from error


def _check_known(config: Any, field: str, origin: str, path: str) -> None:
    known = [f.name for f in dataclasses.fields(config) if f.init]
    if field not in known:
        raise InputError(origin, _cut(path), f"{type(config).__name__} has no field {_cut(field)}", _nearest(field, known, "it has"))


def _nearest(word: str, known: Iterable[str], head: str) -> str:
    """What to do about a word that is not known: the one that was meant, and all that there are."""
    names = list(known)
    close = difflib.get_close_matches(word[:LONGEST], names, n=1)
    return (f"did you mean {close[0]}? " if close else "") + f"{head} {', '.join(names)}"


LONGEST = 60
"""Characters of a value or a name that an error repeats."""


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 3]}..."


def _shown(value: Any) -> str:
    """A value as an error repeats it."""
    try:
        return _cut(repr(value))
    except (ValueError, RecursionError):  # numbers of thousands of digits, and tables in tables, have no text
        return f"this {type(value).__name__}"


def types_of(config: Any) -> dict[str, Any]:
    """The types of a config's fields."""
    return get_type_hints(config)


def kinds_of(config: Any, field: str) -> dict[str, type]:
    """The configs that a field may hold, by name in lower case without `Config`, where its type is a union of configs."""
    held = get_args(types_of(config)[field])
    return (
        {kind.__name__.removesuffix("Config").lower(): kind for kind in held} if held and all(map(dataclasses.is_dataclass, held)) else {}
    )


def _coerce(kind: Any, value: Any) -> Any:
    """`value` in a field's type: whole numbers are numbers, too, tuples are given as lists.

    Raises:
        TypeError: it does not fit.
    """
    match get_origin(kind) or kind:
        case _ if kind in (bool, str, NoneType) and type(value) is kind:
            return value
        case _ if kind in (int, float) and type(value) is int and abs(value) > LARGEST:
            raise TypeError(f"{_shown(value)} is too large")
        case _ if kind is int and type(value) in (int, float) and math.isfinite(value) and value == int(value):
            return _coerce(int, int(value)) if type(value) is float else value  # JSON does not tell 2.0 from 2
        case _ if kind is float and type(value) in (int, float) and math.isfinite(value):
            return float(value)
        case origin if origin is Literal and any(type(value) is type(word) and value == word for word in get_args(kind)):
            return value
        case origin if origin in (Union, UnionType):
            for held in get_args(kind):
                try:
                    return _coerce(held, value)
                except TypeError:
                    continue
        case origin if origin is tuple and isinstance(value, list | tuple):
            return _coerced_items(get_args(kind), value)
    raise TypeError(f"{_shown(value)} is not {_described(kind)}")


def _coerced_items(kinds: tuple[Any, ...], values: Sequence[Any]) -> tuple[Any, ...]:
    if len(kinds) == 2 and kinds[1] is ...:
        return tuple(_coerce(kinds[0], value) for value in values)
    if len(kinds) != len(values):
        raise TypeError(f"{len(values)} values given, there are {len(kinds)}")
    return tuple(_coerce(kind, value) for kind, value in zip(kinds, values, strict=True))


_WORDS = {bool: "true or false", int: "a whole number", float: "a finite number", str: "a text", NoneType: "null"}


def _described(kind: Any) -> str:
    """A type in words."""
    if kind in _WORDS:
        return _WORDS[kind]
    if get_origin(kind) is Literal:
        return f"one of {', '.join(map(str, get_args(kind)))}"
    if get_origin(kind) in (Union, UnionType):
        return " or ".join(_described(held) for held in get_args(kind))
    return "a list of what belongs here" if get_origin(kind) is tuple else "a table"
