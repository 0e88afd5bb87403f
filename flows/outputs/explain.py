"""Explanations: what an object, a scene, an asset or a file was made from. Does not import Prefect."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from flows.run.bounds import OutOfBounds, bounded
from flows.run.fingerprints import annotations_digest, canonical, digest
from schemas.budget import BUDGET
from schemas.candidates import Asset
from schemas.capture import Instance, Scene
from schemas.errors import InputError
from schemas.exports import ExportFile
from schemas.files import read_file
from schemas.lineage import Lineage, Place, RunFacts
from schemas.parsing import json_value
from schemas.training import LearnedModel
from tasks.exports.format import ExportFormat
from tasks.exports.formats import FORMATS
from tasks.lineage.places import places, places_of
from warehouse.lake import Lake
from warehouse.lineage.files import blob_owners, walk_asset, walk_blob, walk_export, walk_exported
from warehouse.lineage.models import walk_model
from warehouse.lineage.nodes import exported_places
from warehouse.lineage.objects import walk_object
from warehouse.lineage.scenes import walk_scene
from warehouse.lineage.targets import Target, find_target, split_object
from warehouse.lineage.walk import Walk
from warehouse.tables.reviews import standing_answers


def explain(lake: Lake, asked: str, snapshot_id: int | None = None) -> Lineage:
    """What `asked` was made from, as a snapshot has it, the newest by default.

    `asked` is an object (`<scene>/<instance>`), a scene, an asset's hash, a blob's name, the path of an exported file, or
    `<path>:<name>` of an object in one, in USD its prim path. A file that is there is held against what the lake has of it.

    Raises:
        InputError: it is nothing of the kind, or not in the lake; or there is no such snapshot.
    """
    reader = lake.snapshot(snapshot_id)
    if reader.snapshot is None:
        raise InputError(lake.address, "explain", "the lake has no snapshot yet", "run something first")
    target = find_target(reader, lake.address, asked)
    walk = Walk(reader, lake.blobs, places)
    return _finished(walk, _walk(walk, lake, target, _local_file(asked)))


def explain_objects(lake: Lake, scene_id: str, instance_ids: Iterable[str], snapshot_id: int | None = None) -> dict[str, Lineage]:
    """What `explain` says of several objects of a scene, by instance; rows are read once.

    Raises:
        InputError: the snapshot has no such instance, or there is no such snapshot.
    """
    reader = lake.snapshot(snapshot_id)
    known: dict[tuple[str, str], Any] = {}

    def read(kind: str, path: str, data: bytes) -> Any:
        if (kind, path) not in known:
            known[kind, path] = places(kind, path, data)
        return known[kind, path]

    walk, explained = None, {}
    for instance_id in instance_ids:
        walk = Walk(reader, lake.blobs, read, walk)
        target = Target("instance", scene_id=scene_id, instance_id=instance_id)
        explained[instance_id] = _finished(walk, _walk(walk, lake, target, None))
    return explained


def _finished(walk: Walk, root: str) -> Lineage:
    """The lineage of a walk, with what does not hold of annotations and configs."""
    _check_annotations(walk)
    lineage = walk.lineage(root)
    for run in lineage.runs.values():
        text = run.config if isinstance(run.config, str) else json.dumps(run.config, sort_keys=True, separators=(",", ":"))
        if run.config_hash is not None and run.config_hash != digest(text):
            walk.problem(
                "differs", run.id, f"the config of {run.id} has hash {digest(text)[:12]}, and its fingerprint {run.config_hash[:12]}"
            )
    return walk.lineage(root)


def settings_of(run: RunFacts) -> tuple[str, ...] | None:
    """What a run was told otherwise than by default, as ``field=value (default value)``; None when this version has no such config."""
    usual = _usual(run.stage)
    if usual is None or not isinstance(run.config, dict) or run.config.get("type") != usual[0]:
        return None
    recorded = dict(_flat(run.config))
    changed = [name for name in {**recorded, **usual[1]} if recorded.get(name) != usual[1].get(name)]
    return tuple(f"{name}={recorded.get(name, 'none')} (default {usual[1].get(name, 'none')})" for name in changed)


@cache
def _usual(stage: str) -> tuple[Any, dict[str, str]] | None:
    """Type and leaves of a stage's default config; None where this version has no such stage."""
    from flows.run.configuration import configure

    config = configure().stages.get(stage)
    default = json_value(json.dumps(canonical(config))) if config is not None else None
    return (default.get("type"), dict(_flat(default))) if default is not None else None


def _flat(value: Any, name: str = "") -> Iterator[tuple[str, str]]:
    """The leaves of a JSON value by their paths."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _flat(item, f"{name}.{key}" if name else key)
    elif isinstance(value, list) and any(isinstance(item, dict | list) for item in value):
        for index, item in enumerate(value):
            yield from _flat(item, f"{name}[{index}]")
    else:
        yield name, json.dumps(value)


def _local_file(asked: str) -> Path | None:
    """The file that a path names, where it is there."""
    for text in (asked, split_object(asked)[0]):
        try:
            if Path(text).is_file():
                return Path(text)
        except (OSError, ValueError):  # no name that this system can have
            continue
    return None


def _walk(walk: Walk, lake: Lake, target: Target, local: Path | None) -> str:
    """Walk from a target; the id of its node."""
    where, snapshot = lake.address, walk.reader.snapshot_id
    if target.kind == "instance":
        instance = walk.row(Instance, target.scene_id, instance_id=target.instance_id)
        if instance is None:
            known = [row.instance_id for row in walk.rows(Instance, target.scene_id) if not row.is_structure]
            remedy = f"it has {', '.join(known[:8])}{', ...' if len(known) > 8 else ''}" if known else "it has none"
            raise InputError(where, target.scene_id, f"snapshot {snapshot} has no instance {target.instance_id} of it", remedy)
        return walk_object(walk, instance)
    if target.kind == "scene":
        return walk_scene(walk, walk.rows(Scene, target.scene_id)[0])
    if target.kind == "asset":
        assets = walk.reader.rows_by_key(Asset, [target.key])
        if not assets:
            raise InputError(where, "assets", f"snapshot {snapshot} has no asset {target.key}", 'see `metascenes sql "FROM assets"`')
        return walk_asset(walk, assets[0])
    if target.kind == "model":
        return walk_model(walk, walk.reader.rows_by_key(LearnedModel, [target.key])[0])
    if target.kind == "blob":
        owners = blob_owners(walk, target.key)
        if not owners:
            raise InputError(where, "blobs", f"no row of snapshot {snapshot} names {target.key}", "check the name")
        return walk_blob(walk, target.key, owners)
    file = target.files[0]
    content = _content(lake, file, local) if local is not None else None
    if target.obj is None:
        return walk_export(walk, file, [row.scene_id for row in target.files[1:]], content)
    return walk_exported(walk, file, _object(walk, file, target.obj, local), content)


def _content(lake: Lake, file: ExportFile, local: Path) -> str:
    """How a file on disk compares with the lake's."""
    data = read_file(local, str(local), BUDGET.scene_bytes)
    if file.file_blob.startswith(hashlib.sha256(data).hexdigest()):
        return "as in the lake"
    format_ = _format(file)
    if format_ is not None and format_.with_release is not None and file.role == "scene" and file.file_blob in lake.blobs:
        stated = None
        with contextlib.suppress(OutOfBounds):  # it is nothing that an export wrote
            stated = bounded(places_of(format_).stated_release, data, seconds=BUDGET.seconds, memory_bytes=BUDGET.child_bytes)
        if stated is not None and format_.with_release(lake.blobs[file.file_blob], *stated) == data:
            return f"as in the lake, and says that it is of release {stated[1]}"
    return "differs"


def _format(file: ExportFile) -> ExportFormat | None:
    """The format of an exported file; None where this version does not have it."""
    return next((format_ for format_ in FORMATS if format_.name == file.format), None)


def _object(walk: Walk, file: ExportFile, name: str, local: Path | None) -> Place:
    """The object of an exported scene that a name lies in: where names are paths, what lies below an object belongs to it.

    Raises:
        InputError: the file holds no such object.
    """
    format_ = _format(file)
    places: Sequence[Place] = exported_places(walk, file) if file.role == "scene" else ()
    is_nested = format_ is not None and format_.is_nested
    inside = [place for place in places if name == place.name or (is_nested and name.startswith(f"{place.name}/"))]
    if not inside:
        known = ", ".join(place.name for place in places[:3])
        remedy = f"it has {known}{', ...' if len(places) > 3 else ''}" if places else "only scene files hold objects"
        raise InputError(f"{file.format}/{file.path}", name, "is nothing that this export places", remedy)
    if format_ is not None and local is not None and name != inside[0].name:
        try:
            is_there = bounded(places_of(format_).has_part, local, name, seconds=BUDGET.seconds, memory_bytes=BUDGET.child_bytes)
        except OutOfBounds as error:
            raise InputError(str(local), "content", f"cannot be read: {error}", "is it the right file?") from error
        if not is_there:
            raise InputError(str(local), name, "there is no such prim", f"the object is {inside[0].name}")
    return inside[0]


def _check_annotations(walk: Walk) -> None:
    """A layout was made from the annotations that the snapshot has now."""
    for run in walk.lineage("").runs.values():
        if "annotations" in run.inputs:
            now = annotations_digest(standing_answers(walk.reader, run.scene_id).to_pylist())
            if now != run.inputs["annotations"]:
                walk.problem("stale", run.id, f"{run.stage} of {run.scene_id} read other annotations than there are now")
