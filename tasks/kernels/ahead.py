"""Machine code made ahead: kernels, and the types that a run calls them with.

Kernels are compiled when they are first called, by each process that calls one: the better part of a minute for all stages of a scene,
as long as nobody has compiled them on this machine. `KERNELS` names them, so that they can be compiled at once by all cores.
"""

from __future__ import annotations

import importlib
import json
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, cast

if TYPE_CHECKING:
    from numba.core.types import Type

KERNELS = Path(__file__).with_suffix(".json")
"""Kernels by the function that compiles them, each with the types of its arguments; written by `tests.contributing.kernels`."""

_ARRAY = re.compile(r"(readonly )?array\((\w+), (\d)d, ([CFA])\)")
_GENERATOR = "NumPyRandomGeneratorType"


class Signature(NamedTuple):
    """A kernel and what it is called with. maker: `module:function` that compiles it. name: Of the kernel. types: Of its arguments."""

    maker: str
    name: str
    types: tuple[str, ...]


def signatures() -> list[Signature]:
    """What a run calls, the longest signatures first: they are those of the largest kernels, which had better not be compiled last."""
    listed = json.loads(KERNELS.read_text())
    made = [Signature(maker, name, tuple(types)) for maker, names in listed.items() for name, calls in names.items() for types in calls]
    return sorted(made, key=lambda kernel: -sum(len(each) for each in kernel.types))


def compile_ahead(kernel: Signature) -> bool:
    """Compile a kernel, or load it where somebody has compiled it on this machine; whether it was compiled.

    Raises:
        ImportError, AttributeError: there is no such module, function or class any more.
    """
    place, _, maker = kernel.maker.partition(":")
    module = importlib.import_module(place)
    getattr(module, maker)()
    compiled = getattr(module, kernel.name)
    before = sum(compiled.stats.cache_misses.values())
    compiled.compile(tuple(type_of(text) for text in kernel.types))
    return bool(sum(compiled.stats.cache_misses.values()) > before)


def text_of(kind: Type) -> str:
    """A type of numba as text.

    Raises:
        ValueError: `type_of` would not understand it.
    """
    from numba.core import types

    if isinstance(kind, types.NamedTuple | types.NamedUniTuple):
        own = kind.instance_class
        return f"{own.__module__}:{own.__qualname__}({', '.join(text_of(each) for each in kind.types)})"
    text = str(kind)
    if type_of(text) != kind:
        raise ValueError(f"{text}: a kernel is called with a type that has no text")
    return text


def type_of(text: str) -> Type:
    """The type of numba that a text names.

    Raises:
        ValueError: it names none.
    """
    from numba.core import types

    if match := _ARRAY.fullmatch(text):
        readonly, item, dimensions, layout = cast("tuple[str | None, str, str, Literal['C', 'F', 'A']]", match.groups())
        return types.Array(type_of(item), int(dimensions), layout, readonly=bool(readonly))
    if text.endswith(")") and ":" in text:
        name, _, inner = text.removesuffix(")").partition("(")
        module, _, own = name.partition(":")
        named: Any = getattr(importlib.import_module(module), own)
        return _named([type_of(each) for each in _parts(inner)], named)
    if text == _GENERATOR:
        return types.npy_rng
    kind = getattr(types, "boolean" if text == "bool" else text, None)
    if not isinstance(kind, types.Number | types.Boolean):
        raise ValueError(f"{text}: no type that a kernel is called with")
    return kind


def _named(kinds: Sequence[Type], own: Any) -> Type:
    from numba.core import types

    return types.NamedUniTuple(kinds[0], len(kinds), own) if len(set(kinds)) == 1 else types.NamedTuple(tuple(kinds), own)


def _parts(text: str) -> Iterator[str]:
    """What stands between the commas of a text that are in no brackets."""
    depth, begun = 0, 0
    for at, sign in enumerate(text):
        depth += (sign == "(") - (sign == ")")
        if sign == "," and depth == 0:
            yield text[begun:at].strip()
            begun = at + 1
    yield text[begun:].strip()
