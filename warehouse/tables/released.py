"""What is released: the records in `releases/<name>/release.json`, which are the truth about releases."""

from __future__ import annotations

import dataclasses
from datetime import datetime
from typing import Any

from schemas.errors import InputError, RecordError
from schemas.parsing import json_value
from schemas.record import check
from schemas.runs import Release
from warehouse.storage.files import Storage

FOLDER = "releases"
RECORD = "release.json"


def folder_of(name: str) -> str:
    """`releases/<name>`, relative to the lake: the folder of a release."""
    return f"{FOLDER}/{name}"


def released(storage: Storage) -> list[Release]:
    """All releases, by name. A folder without its `release.json` is none: whoever made it was interrupted.

    Raises:
        InputError: a `release.json` cannot be read.
    """
    records = []
    for name in storage.folders(FOLDER):
        try:
            data = storage.read(f"{folder_of(name)}/{RECORD}")
        except FileNotFoundError:
            continue
        file = f"{storage.address}/{folder_of(name)}/{RECORD}"
        release = parse_release(file, data)
        if release.name != name:
            raise InputError(file, "name", f"is {release.name!r} in the folder of {name!r}", "give the folder its name back")
        records.append(release)
    return sorted(records, key=lambda release: release.name)


def record_fields(release: Release) -> dict[str, Any]:
    """A release as the fields of its `release.json`."""
    return dataclasses.asdict(release) | {"created_at": release.created_at.isoformat()}


def parse_release(file: str, data: bytes) -> Release:
    """The release that a `release.json` states; `file` is its name for errors.

    Raises:
        InputError: it cannot be read.
    """
    try:
        fields = {"erased_at": [], **json_value(data)}
        release = Release(
            **{field.name: fields[field.name] for field in dataclasses.fields(Release)}
            | {"created_at": datetime.fromisoformat(fields["created_at"])}
            | {name: tuple(fields[name]) for name in ("row_counts", "erased_at")}
        )
        check([release], Release)
    except (ValueError, KeyError, TypeError, RecordError) as error:
        raise InputError(file, "", f"cannot be read ({type(error).__name__}: {error})", "restore the file or remove the folder") from error
    return release
