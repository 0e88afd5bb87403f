"""Types of the flows' parameters that only the configs know: a table of fields for each stage, with a schema of its own.

The Prefect server holds parameters against the schema when a run is created, and its UI makes a form of it; what no schema
can say (rules between fields) is checked when the run starts, by the same code that reads a TOML file.
"""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from contextvars import ContextVar
from typing import Annotated, Any, TypeAlias

from pydantic import AfterValidator, GetJsonSchemaHandler, WithJsonSchema
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core.core_schema import CoreSchema, WithDefaultSchema

from flows.run.configuration import configs_with
from schemas.errors import LakeError, check_address
from tasks.pipeline import STAGES
from tasks.settings import Config, adapter, paragraphs, plain

Schema: TypeAlias = dict[str, Any]

_is_declared: ContextVar[bool] = ContextVar("_is_declared", default=False)
"""True while a flow is declared: Prefect asks for a schema then that only deployments need, and asks again for those."""


def stages_flow(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """Declare a Prefect flow that takes `StageTables`, without their schema, which costs a second and more.

    `prefect.flow` takes the same options. `Flow.parameters` has no fields of stages; a deployment has them.
    """
    from prefect import flow

    def declare(function: Callable[..., Any]) -> Any:
        mark = _is_declared.set(True)
        try:
            return flow(**options)(function)
        finally:
            _is_declared.reset(mark)

    return declare


class _StagesSchema:
    """JSON Schema of `StageTables`, for an annotation."""

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> Schema:
        return {"type": "object"} if _is_declared.get() else copy.deepcopy(stages_schema())


@functools.cache
def stages_schema() -> Schema:
    """JSON Schema of `StageTables`: for each stage a table of its config's fields, with types, limits, defaults and their reasons.

    What it cannot say, and `flows.run.configuration.configure` refuses: fields that contradict each other.
    """
    return {
        "title": "Stages",
        "description": "What stages are told, a table of fields each; what is left out keeps its default.",
        "type": "object",
        "properties": {stage.name: _table(stage.config) | {"title": stage.name.capitalize(), "default": {}} for stage in STAGES},
        "additionalProperties": False,
        "default": {},
    }


class Form(GenerateJsonSchema):
    """Schemas with fields in the order of the configs, and defaults as people tell them: of a table nothing, of one of several
    configs its kind, with what differs from that kind's own defaults.
    """

    def sort(self, value: Schema, parent_key: str | None = None) -> Schema:
        """The schema as it is."""
        return value

    def default_schema(self, schema: WithDefaultSchema) -> Schema:
        """Schema of a field that has a default."""
        made = self.generate_inner(schema["schema"])
        default = schema["default"] if "default" in schema else schema["default_factory"]()  # type: ignore[call-arg]
        if not isinstance(default, Config):
            return {**made, "default": plain(default)}
        if "anyOf" not in made:
            return {**made, "default": {}}
        words, *tables = made["anyOf"]
        tables[words["enum"].index(default.kind)].pop("required", None)  # a table that names no kind is of the one that is there
        usual = plain(type(default)())
        changed = {name: value for name, value in plain(default).items() if value != usual[name]}
        return {**made, "default": {"kind": default.kind, **changed} if changed else default.kind}


def _table(config: type) -> Schema:
    """Schema of a table of a config's fields, without references."""
    schema = adapter(config).json_schema(schema_generator=Form)
    definitions = schema.pop("$defs", {})

    def inlined(part: Any) -> Any:
        if isinstance(part, list):
            return [inlined(item) for item in part]
        if not isinstance(part, dict):
            return part
        if "$ref" in part:
            named = definitions[part["$ref"].rpartition("/")[2]]
            part = {**named, **part, "description": paragraphs(named.get("description"), part.get("description"))}
        return {name: inlined(value) for name, value in part.items() if name != "$ref"}

    return inlined(schema)


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

StageTables = Annotated[dict[str, dict[str, Any]], AfterValidator(checked_tables), _StagesSchema()]
"""A table of fields for each stage that is told anything, as in a TOML file: `{"navigation": {"max_steps": 250}}`."""
