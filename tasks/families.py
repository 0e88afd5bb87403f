"""Open families: objects that each lie in a module of their own and are found by their names (see `schemas.families`)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Protocol, TypeVar


class Named(Protocol):
    """What has a name."""

    @property
    def name(self) -> str:
        """The name that rows hold and that people give."""
        ...


M = TypeVar("M", bound=Named)


def members(package: str, names: Iterable[str], kind: type[M]) -> tuple[M, ...]:
    """The members of a family: of every name the object `<NAME>` in the module `<package>.<name>`, in the order of the names.

    Fingerprints of code follow a call as they follow import statements. For that, the package is given as a literal, and the
    names as what a module of `schemas.families` calls them.

    Raises:
        TypeError: a module has no such object of that kind and name.
    """
    objects = []
    for name in names:
        module = import_module(f"{package}.{name}")
        member = getattr(module, name.upper(), None)
        if not isinstance(member, kind) or member.name != name:
            raise TypeError(f"{module.__name__}: {name.upper()} must be the {kind.__name__} {name!r}")
        objects.append(member)
    return tuple(objects)


def member(family: Sequence[M], name: str) -> M:
    """The member of that name.

    Raises:
        KeyError: there is none.
    """
    for each in family:
        if each.name == name:
            return each
    raise KeyError(name)


def part(package: str, name: str, module: str) -> ModuleType | None:
    """A module of a member's own package, imported now; None where it has none.

    What lies there only some ask for: the stage of the family does not import it, so that its rows do not depend on it.
    """
    full = f"{package}.{name}.{module}"
    try:
        is_there = find_spec(full) is not None
    except ModuleNotFoundError:  # the member is a single module
        return None
    return import_module(full) if is_there else None
