"""The categories of micro-scenes: which words are merged into which, which can carry, which can be carried."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from schemas.errors import InputError
from schemas.files import read_file

if TYPE_CHECKING:
    from yaml.nodes import Node

UNKNOWN = "object"
"""Category of what the table knows no word for."""

SOURCES = ("paper", "inferred")
"""Where a category's name can be from."""

MOST_BYTES = 128 * 1024
"""Of a table of categories: ten times what the project's own has."""

DEEPEST = 5
"""Levels of a table of categories: the document, a category, a field, its words; and one for who lists a list among them."""

_OWN = Path(__file__).with_name("categories.yaml")
_FIELDS = ("large", "small", "source", "words")


@dataclasses.dataclass(frozen=True)
class Categories:
    """A table of categories.

    names: In alphabetical order. large: Those that can carry a micro-scene of their own. small: Those that can belong to one.
    sources: Where each name is from, by name. words: Category by word, lower case, single spaces; the names themselves are among
    them. sha256: Hash of the file.
    """

    names: tuple[str, ...]
    large: frozenset[str]
    small: frozenset[str]
    sources: Mapping[str, str]
    words: Mapping[str, str]
    sha256: str

    def merged(self, word: str) -> str:
        """The category of a word; 'object' for one that the table does not know.

        Letter case, blanks, underscores, dashes, numbers, camel case and plurals do not matter. Words that are not in the table as they
        are go by their longest ending that is: a wooden kitchen table is a kitchen table.
        """
        plain, parted = _normal(word), _normal(re.sub(r"(?<=[a-z])(?=[A-Z])|(?<=[A-Za-z])(?=[0-9])", " ", word))
        for text in (plain, parted):
            category = self._named(text)
            if category is not None:
                return category
        parts = [part for part in parted.split() if len(part) > 1 and not part.isdigit()]
        for start in range(len(parts)):
            category = self._named(" ".join(parts[start:]))
            if category is not None:
                return category
        return UNKNOWN

    def is_large(self, name: str) -> bool:
        """Whether objects of a category can carry a micro-scene of their own."""
        return name in self.large

    def is_small(self, name: str) -> bool:
        """Whether objects of a category can belong to a micro-scene."""
        return name in self.small

    def _named(self, text: str) -> str | None:
        return next((self.words[form] for form in _singulars(text) if form in self.words), None)


def read_categories(path: Path | None = None) -> Categories:
    """The project's own table of categories, or that of a file of the same layout.

    Raises:
        InputError: the file cannot be read, is larger than 128 KiB, or is no such table; names the file, and the category and field.
    """
    return _own() if path is None else _parsed(read_file(path, path.name, MOST_BYTES), path.name)


@cache
def _own() -> Categories:
    return _parsed(read_file(_OWN, _OWN.name, MOST_BYTES), _OWN.name)


def _parsed(data: bytes, name: str) -> Categories:
    words: dict[str, str] = {}
    flags: dict[str, set[str]] = {"large": set(), "small": set()}
    sources: dict[str, str] = {}
    for key, node in _table(_composed(data, name), name, ""):
        if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", key) or len(key) > 40:
            raise InputError(name, key, "is no name for a category", "use up to 40 lower case letters, digits and underscores")
        fields = dict(_table(node, name, key))
        for field in sorted(set(fields) ^ set(_FIELDS)):
            problem = "is missing" if field in _FIELDS else "is no field of a category"
            raise InputError(name, f"{key}.{field}", problem, f"it has {', '.join(_FIELDS)}")
        for field, named in flags.items():
            if _word(fields[field], name, f"{key}.{field}", ("true", "false")) == "true":
                named.add(key)
        if key not in flags["large"] | flags["small"]:
            raise InputError(name, f"{key}.small", "must be true where large is false", "a category of neither kind has no objects")
        sources[key] = _word(fields["source"], name, f"{key}.source", SOURCES)
        for word in (key, *_words(fields["words"], name, f"{key}.words")):
            normal = _normal(word)
            if not normal:
                raise InputError(name, f"{key}.words", "has an empty word", "leave it out")
            if normal in words:
                problem = f"{word!r} is a word of {words[normal]} already"
                raise InputError(name, f"{key}.words", problem, "a word has one category")
            words[normal] = key
    if UNKNOWN not in sources:
        raise InputError(name, UNKNOWN, "is missing", "it is the category of what has no word")
    if UNKNOWN not in flags["small"]:
        raise InputError(name, f"{UNKNOWN}.small", "must be true", "it is the category of what has no word")
    return Categories(
        tuple(sorted(sources)),
        frozenset(flags["large"]),
        frozenset(flags["small"]),
        MappingProxyType(sources),
        MappingProxyType(words),
        hashlib.sha256(data).hexdigest(),
    )


def _composed(data: bytes, name: str) -> Node | None:
    """The nodes of a YAML document: texts, lists and tables, of which nothing is made yet, so that a table's repeated key is seen and no
    alias multiplies anything."""
    import yaml

    class Shallow(yaml.SafeLoader):
        """Reads no deeper than a table goes."""

        depth = 0

        def compose_node(self, parent: Node | None, index: Any) -> Node | None:
            self.depth += 1
            if self.depth > DEEPEST:
                raise InputError(name, "content", "is nested too deep", "is it the right file?")
            node: Node | None = super().compose_node(parent, index)
            self.depth -= 1
            return node

    try:
        return yaml.compose(data.decode("utf-8-sig"), Loader=Shallow)
    except UnicodeDecodeError as error:
        raise InputError(name, "content", f"is no text (byte {error.start})", "save it as UTF-8") from error
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f"line {mark.line + 1}" if mark is not None else "content"
        raise InputError(name, where, f"is no YAML ({getattr(error, 'problem', None) or error})", "correct the line") from error


def _table(node: Node | None, name: str, field: str) -> list[tuple[str, Node]]:
    """Keys and values of a table."""
    from yaml.nodes import MappingNode

    if not isinstance(node, MappingNode):
        raise InputError(name, field or "content", "must be a table", "write it as the project's own categories.yaml")
    entries: dict[str, Node] = {}
    for key_node, value in node.value:
        key = _word(key_node, name, field or "content")
        if key in entries:
            raise InputError(name, f"{field}.{key}" if field else key, "is there twice", "keep one")
        entries[key] = value
    return list(entries.items())


def _words(node: Node, name: str, field: str) -> list[str]:
    """Texts of a list."""
    from yaml.nodes import SequenceNode

    if not isinstance(node, SequenceNode):
        raise InputError(name, field, "must be a list of words", "write [] for none")
    return [_word(item, name, field) for item in node.value]


def _word(node: Node, name: str, field: str, allowed: tuple[str, ...] = ()) -> str:
    """The text of a node."""
    from yaml.nodes import ScalarNode

    text = node.value if isinstance(node, ScalarNode) else None
    if text is None or (allowed and text not in allowed):
        wanted = " or ".join(allowed) if allowed else "a text"
        raise InputError(name, field, f"must be {wanted}, is {text!r:.60}" if text is not None else f"must be {wanted}", "correct it")
    return str(text)


def _normal(word: str) -> str:
    """Lower case, single spaces, no underscores or dashes."""
    return " ".join(re.sub(r"[_\-\s]+", " ", word.lower()).split())


def _singulars(text: str) -> list[str]:
    """A text, and what it can be the plural of."""
    forms = [text, text.removesuffix("s"), text.removesuffix("es")]
    if text.endswith("ies"):
        forms.append(f"{text[:-3]}y")
    if text.endswith("ves"):
        forms += [f"{text[:-3]}f", f"{text[:-3]}fe"]
    return forms
