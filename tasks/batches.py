"""Batch files: JSON that people and programs hand in, held against a published schema, refused with one line that says where."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Iterable, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, NoReturn

from schemas.errors import InputError
from schemas.files import read_file
from schemas.parsing import TooMuch, json_value


def read_limited(file: Path, name: str, most_bytes: int) -> bytes:
    """Content of a file that people call `name`.

    Raises:
        InputError: it cannot be read, is no regular file, or is larger than `most_bytes`.
    """
    try:
        if file.stat().st_size > most_bytes:
            raise InputError(name, "", f"is larger than {most_bytes >> 20} MB", "split the batch into files")
    except OSError as error:
        raise InputError(name, "", f"cannot be read ({error.strerror})", "check the path and its permissions") from error
    return read_file(file, name, most_bytes)


def parse_json(raw: bytes, name: str, first_line: int = 1) -> Any:
    """The JSON value in UTF-8 bytes. `first_line` is the line of the file that they begin on.

    Raises:
        InputError: they are not UTF-8, not JSON, nested too deeply, more than the budget's memory holds, hold NaN or infinity, or
            give a key twice.
    """
    try:
        text = raw.decode("utf-8-sig")
        return json_value(text, parse_constant=_no_constant, object_pairs_hook=_no_repeated_key)
    except UnicodeDecodeError as error:
        raise InputError(name, f"byte {error.start}", "is not UTF-8", "save the file as UTF-8") from error
    except json.JSONDecodeError as error:
        place = f"line {error.lineno + first_line - 1} column {error.colno}"
        raise InputError(name, place, f"is not JSON ({error.msg})", "correct the file") from error
    except TooMuch as error:
        raise InputError(name, "", str(error), "split the batch into files") from error
    except ValueError as error:
        problem = "holds a number of thousands of digits" if "limit" in str(error) and "digits" in str(error) else str(error)
        raise InputError(name, "", problem, "correct the file") from error


def _no_constant(text: str) -> NoReturn:
    raise ValueError(f"holds the number {text}, which JSON does not have")


def _no_repeated_key(pairs: Sequence[tuple[str, Any]]) -> dict[str, Any]:
    result = dict(pairs)
    if len(result) != len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"gives {next(k for k in keys if keys.count(k) > 1)!r} twice in one object")
    return result


_LOOKED_AT = 1000
"""Problems among which the first is looked for: in a file of millions that are all wrong, one is as good as another."""


def _same_place(path: str) -> str:
    return path


class BatchSchema:
    """A published JSON Schema file, as a check whose refusals people understand."""

    def __init__(self, file: Path) -> None:
        self._file = file

    @cached_property
    def _validator(self) -> Any:
        import jsonschema

        return jsonschema.Draft202012Validator(json.loads(self._file.read_text(encoding="utf-8")))

    def check(self, document: Any, name: str, place: Callable[[str], str] = _same_place) -> None:
        """Hold a document against the schema. `place` turns a JSON path into the place that people know it by.

        Raises:
            InputError: the first problem in the order of the file.
        """
        problems = sorted(
            itertools.islice(self._validator.iter_errors(document), _LOOKED_AT),
            key=lambda e: ([(isinstance(p, int), str(p).zfill(9)) for p in e.absolute_path], e.validator),
        )
        if problems:
            first = problems[0]
            raise InputError(name, place(_json_path(first.absolute_path)) or "document", _problem(first), _remedy(first))


def _json_path(parts: Iterable[str | int]) -> str:
    """Path in the notation `annotations[3].transform.scale`."""
    text = ""
    for part in parts:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else part
    return text


def _problem(error: Any) -> str:
    """What a person did wrong, in place of the validator's words."""
    value, rule = error.instance, error.validator_value
    shown = json.dumps(value, ensure_ascii=False)
    shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
    match error.validator:
        case "required":
            return f"lacks {next(field for field in rule if field not in value)!r}"
        case "additionalProperties":
            known = error.schema.get("properties", {})
            return f"has an unknown field {next(field for field in value if field not in known)!r}"
        case "type":
            return f"must be {' or '.join(_TYPES[t] for t in ([rule] if isinstance(rule, str) else rule))}, is {shown}"
        case "minItems" | "maxItems":
            return f"must have {rule} values, has {len(value)}"
        case "minimum":
            return f"must be at least {rule}, is {shown}"
        case "maximum":
            return f"must be at most {rule}, is {shown}"
        case "minLength":
            return "must not be empty"
        case "maxLength":
            return f"must have at most {rule} characters, has {len(value)}"
        case _:
            return f"is not allowed: {shown}"


_TYPES = {
    "object": "an object", "array": "a list", "string": "text", "number": "a number", "integer": "a whole number",
    "boolean": "true or false", "null": "null",
}  # fmt: skip


def _remedy(error: Any) -> str:
    description = error.schema.get("description", "")
    if error.validator in ("required", "additionalProperties"):
        return f"allowed are {', '.join(error.schema.get('properties', {}))}"
    return f"give {description}" if description else ""
