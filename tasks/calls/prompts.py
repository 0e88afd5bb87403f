"""Prompts as text files: bundled next to the code, or supplied by a user."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.text import cut

VERSION_LETTERS = 12
"""Letters of the hash of a prompt's text: enough to tell its versions apart."""

_PLACEHOLDER = re.compile(r"\{(\w+)\}")


@dataclasses.dataclass(frozen=True)
class Prompt:
    """A prompt as people read it. name: name of its file. text: its words, with `{fields}` to fill in."""

    name: str
    text: str

    @property
    def version(self) -> str:
        """Hash of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()[:VERSION_LETTERS]

    def filled(self, values: Mapping[str, str]) -> str:
        """Fill in values by field. Other braces stay, so that a prompt can show JSON as it is."""
        return _PLACEHOLDER.sub(lambda match: values[match[1]], self.text)


def bundled_prompt(file: Path) -> Prompt:
    """Prompt in a text file of the package."""
    return Prompt(file.stem, file.read_text(encoding="utf-8"))


def user_prompt(path: str, setting: str, fields: Sequence[str]) -> Prompt:
    """Prompt in a user's text file.

    Args:
        path: path of the file, UTF-8.
        setting: name of the setting that names the file, for errors.
        fields: names that may stand in braces; the first one must.

    Raises:
        InputError: the file cannot be read, lacks the first field, or has an unknown name in braces.
    """
    try:
        text = read_file(Path(path), path, BUDGET.text_bytes).decode("utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise InputError(path, setting, "is not UTF-8 text", "save it as UTF-8") from error
    named = set(_PLACEHOLDER.findall(text))
    known = ", ".join(f"{{{field}}}" for field in fields)
    if unknown := sorted(named - set(fields)):
        raise InputError(path, setting, f"has {{{cut(unknown[0])}}}, which is not a field", f"write one of {known}")
    if fields[0] not in named:
        raise InputError(path, setting, f"lacks {{{fields[0]}}}", f"write it where its value belongs; fields: {known}")
    return Prompt(Path(path).stem, text)


def chosen_prompt(path: str, bundled: Path, setting: str, fields: Sequence[str], version: str = "") -> Prompt:
    """User's prompt at `path`, or the bundled one if `path` is empty.

    Args:
        path: path of the user's text file, "" for none.
        bundled: text file of the package.
        setting: name of the setting that names the user's file, for errors.
        fields: names that may stand in braces; the first one must.
        version: version that the run was planned with, "" to accept any.

    Raises:
        InputError: the user's file cannot be used, or has changed since the run was planned.
    """
    prompt = user_prompt(path, setting, fields) if path else bundled_prompt(bundled)
    if version and prompt.version != version:
        raise InputError(path or bundled.name, setting, "has changed since the run was planned", "start the run again")
    return prompt
