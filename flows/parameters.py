"""Types of the flows' parameters that only the configs know: a table of fields for each stage, with a schema of its own.

The Prefect server holds parameters against the schema when a run is created, and its UI makes a form of it; what no schema
can say (rules between fields) is checked when the run starts, by the same code that reads a TOML file.
"""

from __future__ import annotations

import dataclasses
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeAlias, Union, get_args, get_origin

from pydantic import AfterValidator, WithJsonSchema

from flows.configuration import configs_with, kinds_of, types_of
from schemas.errors import LakeError, check_address
from tasks.pipeline import STAGES
from tasks.stage import Stage

Schema: TypeAlias = dict[str, Any]


def stages_schema() -> Schema:
    """JSON Schema of `StageTables`: for each stage a table of its config's fields, with types and defaults.

    What it cannot say, and `flows.configuration.configure` refuses: a number out of its range, and fields that contradict
    each other.
    """
    return {
        "title": "Stages",
        "description": "What stages are told, a table of fields each; what is left out keeps its default.",
        "type": "object",
        "properties": {stage.name: _stage(stage) for stage in STAGES},
        "additionalProperties": False,
        "default": {},
    }


def checked_tables(tables: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """The same tables, if every field of theirs exists, fits its type and obeys the rules of its stage.

    Raises:
        ValueError: names what does not; pydantic makes a validation error of it.
    """
    try:
        configs_with({stage.name: stage.config() for stage in STAGES}, tables)
    except LakeError as error:
        raise ValueError(str(error)) from error
    return tables


def _stage(stage: Stage) -> Schema:
    return {**_table(stage.config()), "title": stage.name.capitalize(), "default": {}}


def _table(config: Any, kind: str | None = None, named: bool = False) -> Schema:
    """Schema of a table of a config's fields. `kind` may be in it, and must be where the config is to be `named` by it."""
    fields: Schema = {}
    for field in dataclasses.fields(config):
        schema = _field(config, field.name) if field.init else None
        if schema is not None:
            fields[field.name] = {"title": field.name, **schema}
    if kind is not None:
        fields = {"kind": {"const": kind, "default": kind}, **fields}
    return {"type": "object", "properties": fields, "additionalProperties": False, **({"required": ["kind"]} if named else {})}


def _field(config: Any, field: str) -> Schema | None:
    """Schema of what may be told for a field; None where nothing can be."""
    present, kinds = getattr(config, field), kinds_of(type(config), field)
    if kinds:
        own = next(name for name, kind in kinds.items() if type(present) is kind)
        tables = [_table(kind(), name, named=name != own) for name, kind in kinds.items()]
        return {"anyOf": [{"enum": list(kinds)}, *tables], "default": own}
    if dataclasses.is_dataclass(present):
        return {**_table(present), "default": {}}
    schema = _value(types_of(type(config))[field])
    return schema and {**schema, "default": list(present) if isinstance(present, tuple) else present}


_TYPES = {bool: "boolean", int: "integer", float: "number", str: "string", NoneType: "null"}


def _value(kind: Any) -> Schema | None:
    """Schema of a plain value's type; None for configs in a tuple, which nobody can tell."""
    if kind in _TYPES:
        return {"type": _TYPES[kind]}
    origin, held = get_origin(kind), get_args(kind)
    if origin is Literal:
        return {"enum": list(held)}
    if origin in (Union, UnionType):
        return {"anyOf": [_value(each) for each in held]}
    if origin is tuple:
        items = [_value(each) for each in held if each is not ...]
        if None in items:
            return None
        if held[-1] is ...:
            return {"type": "array", "items": items[0]}
        return {"type": "array", "prefixItems": items, "minItems": len(items), "maxItems": len(items)}
    if dataclasses.is_dataclass(kind):
        return None
    raise TypeError(f"{kind} has no schema yet")


def checked_address(address: str) -> str:
    """The same address, if it carries no credentials: parameters are kept by the server, and shown.

    Raises:
        ValueError: it does.
    """
    try:
        check_address(address)
    except LakeError as error:
        raise ValueError(str(error)) from error
    return address


Address = Annotated[
    str,
    AfterValidator(checked_address),
    WithJsonSchema({"type": "string", "pattern": r"^(?!\s*(?:[A-Za-z][A-Za-z0-9+.-]*://|[Ss]3:/*)[^/]*[@:?])(?![Ss]3:[^?]*\?)"}),
]
"""A folder or s3://bucket/prefix without credentials; the server refuses others before it writes a run down."""

StageTables = Annotated[dict[str, dict[str, Any]], AfterValidator(checked_tables), WithJsonSchema(stages_schema())]
"""A table of fields for each stage that is told anything, as in a TOML file: `{"navigation": {"max_steps": 250}}`."""
