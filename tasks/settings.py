"""What configs are made of: frozen dataclasses whose values are held against types and limits, in code as in a file."""

from __future__ import annotations

import dataclasses
import itertools
import linecache
import re
import sys
from collections.abc import Iterable, Mapping
from typing import Annotated, Any, ClassVar, Union, get_args

from pydantic import BeforeValidator, ConfigDict, Field, GetCoreSchemaHandler, GetJsonSchemaHandler, TypeAdapter, ValidationError
from pydantic_core import ArgsKwargs, CoreSchema, PydanticCustomError, core_schema

from schemas.text import cut
from schemas.wording import meant

LARGEST = 10**18
"""Of whole numbers that settings take; more does not fit into 64 bits."""


def shown(value: Any) -> str:
    """A value as an error repeats it."""
    try:
        return f"{value:g}" if isinstance(value, float) else cut(repr(value))
    except (ValueError, RecursionError):  # numbers of thousands of digits, and tables in tables, have no text
        return f"this {type(value).__name__}"


def _whole(value: Any) -> Any:
    """The same value, as a whole number where it is one: JSON does not tell 2.0 from 2."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if type(value) is int and abs(value) > LARGEST:
        raise PydanticCustomError("too_large", "is too large")
    return value


WHOLE = BeforeValidator(_whole)
"""Of whole numbers that have limits of their own."""

Whole = Annotated[int, WHOLE]
Natural = Annotated[int, Field(ge=0), WHOLE]
Count = Annotated[int, Field(ge=1), WHOLE]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]

LISTED = Field(strict=False, fail_fast=True)
"""Of tuples: JSON and TOML have lists."""

Texts = Annotated[tuple[str, ...], LISTED]


@dataclasses.dataclass(frozen=True)
class Config:
    """Base of configs. Refuses values of other types, beyond their limits or infinite: no text is a number, no truth is one.

    `kind`: how a class that stands in a union is named.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
    kind: ClassVar[str] = ""

    def __post_init__(self) -> None:
        values = {name: getattr(self, name) for name in fields_of(type(self))}
        try:
            adapter(type(self)).validator.validate_python(ArgsKwargs((), values), self_instance=self)
        except ValidationError as error:
            path, problem, _ = first_of(error)
            raise ValueError(f"{'.'.join(path)}: {problem}") from error

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        schema = handler(source)
        own: Any = handler.resolve_ref_schema(schema)
        while own["type"] != "dataclass":  # within rules between fields
            own = own["schema"]
        table = core_schema.no_info_before_validator_function(cls._table, own["schema"])
        own.update(schema=table, strict=False, post_init=False)  # tables are taken for configs, and checked once
        return schema

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        made = handler(schema)
        table = handler.resolve_ref_schema(made)
        why = reasons(cls)
        for name in fields_of(cls):
            field = table["properties"][name]
            field |= {"title": name, "description": paragraphs(field.get("description"), why.get(name))}
        if cls.kind:
            table["properties"] = {"kind": {"const": cls.kind, "default": cls.kind}, **table["properties"]}
        return made

    @classmethod
    def _table(cls, given: Any) -> Any:
        """Values by field, where a table is given, or a word that stands for one."""
        if cls.kind and isinstance(given, str) and given == cls.kind:
            return {}
        if not isinstance(given, Mapping):
            return given
        if cls.kind and given.get("kind", cls.kind) != cls.kind:
            raise PydanticCustomError("no_kind", "", {"remedy": f"it is {cls.kind}"})
        fields = fields_of(cls)
        for name in given:
            if name not in fields and not (cls.kind and name == "kind"):
                remedy = nearest(str(name), fields, "it has")
                raise PydanticCustomError("no_field", "", {"owner": cls.__name__, "name": cut(str(name)), "remedy": remedy})
        return {name: given[name] for name in given if name in fields}


def fields_of(config: type[Config]) -> list[str]:
    """Names of the fields that a config can be told."""
    return [field.name for field in dataclasses.fields(config) if field.init]


def plain(value: Any) -> Any:
    """The value of a field as files have it: a config as a table, a tuple as a list."""
    if isinstance(value, Config):
        return ({"kind": value.kind} if value.kind else {}) | {name: plain(getattr(value, name)) for name in fields_of(type(value))}
    return [plain(item) for item in value] if isinstance(value, tuple) else value


class ByKind:
    """Annotation of a union of configs: a word names one, alone or as `kind` of a table."""

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        choices = {f"kind={config.kind}": handler.generate_schema(config) for config in get_args(source)}
        context: dict[str, str | int | float] = {"remedy": f"it is one of {', '.join(config.kind for config in get_args(source))}"}
        return core_schema.tagged_union_schema(
            choices, _tag, custom_error_type="no_kind", custom_error_message="", custom_error_context=context
        )

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        made = handler(schema)
        kinds = [tag.removeprefix("kind=") for tag in schema["choices"]]
        return {"anyOf": [{"enum": kinds}, *({**table, "required": ["kind"]} for table in made["oneOf"])]}


class ByWord:
    """Annotation of a config of one kind, whose word alone stands for it: its JSON schema says so."""

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        made = handler(schema)
        kind = handler.resolve_ref_schema(made)["properties"]["kind"]["const"]
        return {"anyOf": [{"enum": [kind]}, made]}


def union_of(configs: Iterable[type[Config]]) -> Any:
    """Type of a field that holds a config of any of some classes, each with a `kind` of its own."""
    every = tuple(configs)
    if len(every) == 1:
        return Annotated[every[0], ByWord()]
    return Annotated[Union[every], ByKind()]  # noqa: UP007


def _tag(value: Any) -> str:
    """Which of a union's configs a value is or names."""
    kind = value.get("kind") if isinstance(value, Mapping) else getattr(value, "kind", value)
    return f"kind={kind}" if isinstance(kind, str) else ""


_ADAPTERS: dict[type, TypeAdapter[Any]] = {}


def adapter(config: type) -> TypeAdapter[Any]:
    """What makes configs of a class of tables."""
    if config not in _ADAPTERS:
        _ADAPTERS[config] = TypeAdapter(config)
    return _ADAPTERS[config]


def nearest(word: str, known: Iterable[str], head: str) -> str:
    """The remedy for an unknown word: the known one that is nearest, and all known ones."""
    names = list(known)
    return f"{meant(word, names)}{head} {', '.join(names)}"


_PROBLEMS = {
    "greater_than": "must be above {gt:g}, is {value}", "greater_than_equal": "must be at least {ge:g}, is {value}",
    "less_than": "must be below {lt:g}, is {value}", "less_than_equal": "must be at most {le:g}, is {value}",
    "float_type": "must be a finite number, is {value}", "finite_number": "must be a finite number, is {value}",
    "int_type": "must be a whole number, is {value}", "too_large": "{value} is too large", "bool_type": "must be true or false, is {value}",
    "string_type": "must be a text, is {value}", "literal_error": "must be {expected}, is {value}",
    "too_short": "must be a list of at least {min_length}, is {value}", "too_long": "must be a list of at most {max_length}, is {value}",
    "tuple_type": "must be a list, is {value}", "dataclass_type": "must be a table of fields, is {value}", "missing": "is missing",
    "no_field": "{owner} has no field {name}", "no_kind": "must name a kind, is {value}", "value_error": "{error}",
}  # fmt: skip


def first_of(error: ValidationError) -> tuple[list[str], str, str]:
    """The first error: the path of the field, the problem, and the remedy where the problem does not say it."""
    first = error.errors(include_url=False)[0]
    context = {"value": shown(first["input"]), **first.get("ctx", {})}
    context["expected"] = str(context.get("expected")).replace("'", "")
    problem = _PROBLEMS.get(first["type"], "cannot be {value}").format(**context)
    place = [part for part in first["loc"] if not str(part).startswith("kind=")]
    if first["type"] == "no_field":
        place.append(context["name"])
    elif first["type"] == "value_error":  # a rule between fields begins with the name of one
        name, _, problem = problem.partition(": ")
        place.append(name)
    path = [str(part) for part in itertools.takewhile(lambda part: isinstance(part, str), place)]
    rest = [f"item {part + 1}" if isinstance(part, int) else part for part in place[len(path) :]]
    return path, ": ".join([*rest, problem]), context.get("remedy", "")


def paragraphs(*texts: str | None) -> str:
    """Texts as paragraphs of one; None and what is empty left out."""
    return "\n\n".join(filter(None, texts))


def reasons(config: type) -> dict[str, str]:
    """Why each default of a config is what it is: the comment behind it."""
    comments: dict[str, str] = {}
    for owner in reversed(config.__mro__):
        if dataclasses.is_dataclass(owner):
            source = "".join(linecache.getlines(getattr(sys.modules[owner.__module__], "__file__", None) or ""))
            body = re.search(rf"^class {owner.__name__}\b.*?(?=^\S|\Z)", source, re.MULTILINE | re.DOTALL)
            comments |= re.findall(r"^    (\w+): .*  # (.+)$", body[0] if body else "", re.MULTILINE)
    return comments
