"""Which scene a scan is: the one that the lake made of the same content, whatever the scan is called here.

A name is somebody's choice: another `--dataset`, or none, a folder that was renamed, a copy. A scan of which the lake has rows
under its own name is that scene, also when its content has changed. Any other is looked for by content.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

from flows.run.fingerprints import FileHashes, digest
from schemas.runs import StageRun
from tasks.capture.formats import format_of
from tasks.capture.scan import Scan
from warehouse.lake import Lake
from warehouse.tables.history import StageState


class Content(NamedTuple):
    """What a scan holds, as hashes of paths and contents of its files.

    `named`: With the paths as they are, which is what fingerprints take. `nameless`: With `*` for the scan's own name in them,
    so that a file that was renamed with its scan is the same.
    """

    named: str
    nameless: str

    @property
    def parts(self) -> tuple[str, str]:
        """As `stage_runs.reasons` keeps them; what an earlier version wrote has only the first."""
        return f"scan={self.named}", f"content={self.nameless}"


def content_of(scan: Scan, files: Iterable[Path], hashes: FileHashes) -> Content:
    """The content of a scan by the files that its reader reads; those are read whose hashes are not remembered.

    Raises:
        OSError: a file cannot be read.
        InputError: it is none that is read.
    """
    entries = hashes.entries(scan.folder, files)
    nameless = sorted((nameless_path(path, scan), value) for path, value in entries)
    return Content(*(digest(*(f"{path}={value}" for path, value in part)) for part in (entries, nameless)))


def same_scenes(lake: Lake, scans: Mapping[str, Content], captures: Mapping[str, StageState | None]) -> dict[str, str]:
    """Scans that are scenes of another name: scene id by the id that a scan's own name gives.

    `scans` are all that are given together, by these ids, and `captures` the states of the capture on the scenes of their
    names. A scene of the lake counts while its rows, or its newest failure, are of the content; not when it is given itself
    with another one, which is computed under its name. Of copies that are given together and that the lake does not know, the
    first by id is the scene.
    """
    strangers = {scene: content for scene, content in scans.items() if not _has_rows(captures.get(scene))}
    if not strangers:
        return {}
    names: dict[str, str] = {}
    held = _held(lake, {part for content in strangers.values() for part in content.parts})
    for scene, content in sorted(strangers.items()):
        known = [key for part in content.parts for key in held.get(part, ()) if _is_free(key[1], content, scans)]
        if known:
            names[scene] = min(known, key=lambda key: (key[0], key[1] != scene, key[1]))[1]
    first: dict[str, str] = {}
    for scene in sorted(scans, key=lambda key: (key in strangers, key)):
        if scene not in names:
            # A copied folder has another name, and the files in it may still have the scan's.
            same = next((first[part] for part in scans[scene] if part in first), scene)
            first |= dict.fromkeys(scans[scene], same)
    for scene in strangers.keys() - names.keys():
        names[scene] = first[strangers[scene].nameless]
    return {scene: same for scene, same in sorted(names.items()) if same != scene}


def scan_as(scan: Scan, scene_id: str, dataset: str = "", name: str = "") -> Scan:
    """A scan under the name of a scene; `dataset` and `name` are as the scene's own row has them, where there is one."""
    renamed = dataclasses.replace(scan, dataset=dataset, scan=name, word="")
    if renamed.scene_id == scene_id:
        return renamed
    dataset, _, word = scene_id.partition("/")
    return dataclasses.replace(scan, dataset=dataset, scan=name or word, word=word)


def recorded_content(run: StageRun) -> str:
    """Hash of the scan's content, `Content.named`, that a run of the capture recorded; '' where there is none."""
    return next((part.removeprefix("scan=") for part in run.reasons if part.startswith("scan=")), "")


def sentence(scan: str, scene: str) -> str:
    """What is said of a scan that is a scene of another name."""
    return f"{scan} is {scene}: the same scan under another name"


def _has_rows(state: StageState | None) -> bool:
    return state is not None and state.done is not None


def _held(lake: Lake, parts: Collection[str]) -> dict[str, list[tuple[int, str]]]:
    """Scenes by what their captures recorded, of `parts`: 0 with those that have rows of it, 1 with those that failed on it."""
    held: dict[str, list[tuple[int, str]]] = {}
    for scene, state in lake.recorded("capture", parts).items():
        failed = state.last if state.done is None and state.last.outcome == "failed" else None
        run = state.done or failed
        for part in run.reasons if run is not None else ():
            if part in parts:
                held.setdefault(part, []).append((0 if state.done is not None else 1, scene))
    return held


def _is_free(scene: str, content: Content, scans: Mapping[str, Content]) -> bool:
    """Whether a scene of the lake is not given itself with another content."""
    return scene not in scans or scans[scene].nameless == content.nameless


def nameless_path(path: str, scan: Scan) -> str:
    """A path of a scan's file with `*` for the scan's own name; a scan that is one file has whatever name that has."""
    for suffix in format_of(scan).suffixes:
        if path.lower().endswith(suffix):
            return f"*{suffix}"
    return "/".join(f"*{part.removeprefix(scan.scan)}" if part.startswith(scan.scan) else part for part in path.split("/"))
