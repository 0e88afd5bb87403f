"""The page of settings in the documentation: every key with its type, default, limits and reason, from the configs themselves."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

from flows.run.parameters import Schema, stages_schema

_HEAD = """# Settings

Every stage has a table of fields. Written by `make pages` from the configs; the reasons are those of the code.

```
metascenes run ... --set navigation.max_steps=250 --set optimization.method=paper
metascenes run ... --config settings.toml
```

```toml
seed = 7                      # of all random choices; 0 by default
library = "models"            # library of the lake that candidates are taken from, else a folder; none by default

[navigation]
max_steps = 250

[optimization.method]         # one of several: `kind` names it
kind = "paper"
step_m = 0.1

[[candidates.slots]]          # a list takes the place of the whole default
provider = { kind = "scan_crop", mode = "pieces" }

[[candidates.slots]]
provider = { kind = "library", k = 1 }
fallback = { variant = 5 }    # where there is no library, or it has nothing
```

What is told last wins: defaults, the file of `--config`, the parameter `stages` of a Prefect run (the same tables, as a form in
its UI), then each `--set`, whose value is written as in TOML; what is no TOML is a text. `optimization.method=paper` is short for
a table with nothing but `kind = "paper"`; a table without `kind` is about the one that is there. A field, stage or kind that does
not exist is refused with those that do; so is a value of another type (no text is a number), beyond its limits, not finite, or
that contradicts another. Whole numbers have up to 18 digits.

Values are part of a stage's fingerprint: where they change, the stage is computed again, and what depends on it.
"""

_WORDS = {"boolean": "true or false", "integer": "whole number", "number": "number", "string": "text", "null": "none", "object": "table"}
_LIMITS = {
    "exclusiveMinimum": "above {}", "minimum": "at least {}", "exclusiveMaximum": "below {}", "maximum": "at most {}",
    "minItems": "{} at least", "maxItems": "{} at most",
}  # fmt: skip


def configuration_page() -> str:
    """The page, Markdown."""
    stages = stages_schema()["properties"]
    return "\n".join([_HEAD, *(line for name, stage in stages.items() for line in _section(f"## `{name}`", name, stage))])


def _section(heading: str, path: str, table: Schema) -> Iterator[str]:
    """A table of fields, then the tables in it."""
    yield from (heading, "", *(text[:1].upper() + text[1:] + "\n" for text in table["description"].split("\n\n")))
    fields = {f"{path}.{name}": field for name, field in table["properties"].items() if name != "kind"}
    rows = [_row(key, field) for key, field in fields.items() if field.get("type") != "object"]
    if rows:
        yield from ("| key | type | default | limits | reason |", "|---|---|---|---|---|", *rows, "")
    for key, field in fields.items():
        if field.get("type") == "object":
            yield from _section(f"### `{key}`", key, field)
        for kind in _kinds(field):
            yield from _section(f"### `{key}` of kind `{kind['properties']['kind']['const']}`", key, kind)
        if _has_tables(field):
            yield from ("By default:", "", "```toml", f"{key.rpartition('.')[2]} = [")
            yield from (f"  {_toml(item)}," for item in field["default"])
            yield from ("]", "```", "")
            yield from _section(f"### each of `{key}`", f"{key}[]", field["items"])


def _kinds(field: Schema) -> list[Schema]:
    """The tables one of which a field holds."""
    words, *tables = field.get("anyOf", [{}])
    return [table for table in tables if "properties" in table] if "enum" in words else []


def _has_tables(field: Schema) -> bool:
    return "properties" in field.get("items", {})


def _row(key: str, field: Schema) -> str:
    default = f"`{_toml(field['default'])}`" if "default" in field and not _has_tables(field) else ""
    reason = field.get("description", "").replace("|", "\\|")
    return f"| `{key}` | {_type(field)} | {default} | {_limits(field)} | {reason} |"


def _type(schema: Schema) -> str:
    """A type in words."""
    if _kinds(schema):
        return f"kind, or table of one: {_type(schema['anyOf'][0])}"
    if "anyOf" in schema:
        return " or ".join(map(_type, schema["anyOf"]))
    if "enum" in schema:
        return ", ".join(f"`{word}`" for word in schema["enum"])
    if schema["type"] == "array":
        item = schema["items"] if "items" in schema else schema["prefixItems"][0]
        return f"list of {_type(item)}" + ("" if "enum" in item else "s")
    kind = schema.get("properties", {}).get("kind")
    return _WORDS[schema["type"]] + (f" of kind `{kind['const']}`" if kind else "")


def _limits(schema: Schema) -> str:
    """Limits in words, those of a list's items one after another."""
    if "prefixItems" in schema:
        items = [_limits(item) for item in schema["prefixItems"]]
        return f"{len(items)}" + (f": {'; '.join(items)}" if any(items) else "")
    return ", ".join(text.format(schema[name]) for name, text in _LIMITS.items() if name in schema)


def _toml(value: Any) -> str:
    """A value as TOML has it; what is none stays out of tables."""
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{name} = {_toml(held)}' for name, held in value.items() if held is not None)} }}"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return "none" if value is None else json.dumps(value)
