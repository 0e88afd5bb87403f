"""What of an export may be shipped: scenes and objects whose licenses are allowed, and scenes made again without the others."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from schemas.capture import Instance
from schemas.exports import ExportCheck, ExportFile
from schemas.lineage.licenses import UNKNOWN, of_asset, scan_of, stated
from schemas.navigation import Episode
from schemas.optimization import Placement, Support
from schemas.parsing import json_value
from schemas.text import markdown_cell
from schemas.wording import counted
from warehouse.lake import Lake
from warehouse.questions.views import asked_by
from warehouse.release.attribution import attribution_of_rows
from warehouse.release.licenses import Allowed, with_licenses_of_scans
from warehouse.tables.snapshot import Reader


@dataclasses.dataclass(frozen=True, order=True)
class LeftOut:
    """A scene, or an object of one, that may not be shipped, and why; `license` is the one that holds for it."""

    scene_id: str
    instance_id: str | None
    what: str
    license: str
    reason: str


@dataclasses.dataclass(frozen=True)
class Shipment:
    """What may be shipped: of which scenes everything, of which only some objects; and what may not.

    `kept` has the objects that stay, for every scene of which some do not. `episodes` counts those without a target.
    """

    scenes: tuple[str, ...]
    kept: Mapping[str, frozenset[str]]
    left_out: tuple[LeftOut, ...]
    episodes: int

    def as_json(self) -> dict[str, Any]:
        """What was left out, as JSON values."""
        rows = [dataclasses.asdict(entry) for entry in self.left_out]
        return {
            "scenes": [row for row in rows if row["instance_id"] is None],
            "objects": [row for row in rows if row["instance_id"] is not None],
            "episodes": self.episodes,
        }

    def page(self, allowed: Allowed) -> str:
        """`LEFT_OUT.md`."""
        scenes = [entry for entry in self.left_out if entry.instance_id is None]
        objects = [entry for entry in self.left_out if entry.instance_id is not None]
        lines = ["# What was left out", "", f"Allowed licenses: {', '.join(allowed.names)}.", ""]
        lines += [f"{counted(len(scenes), 'scene')}, {counted(len(objects), 'object')} in "
                  f"{counted(len(self.kept), 'other scene')}, and {counted(self.episodes, 'navigation episode')} "
                  "whose target is one of these objects.", ""]  # fmt: skip
        if self.kept:
            lines += ["Scenes without some of their objects were made again from the rest and checked again. What stood on or in an object",
                      "that was left out is left out too: it would hang in the air. The navmesh is the one of the whole scene: where such",
                      "an object stood stays closed, so every path on it is free, and episodes keep their distances.", ""]  # fmt: skip
        for head, rows in (("Scenes", scenes), ("Objects", objects)):
            if rows:
                lines += [f"## {head}", "", "| which | what | license | why |", "|---|---|---|---|"]
                for row in rows:
                    which = row.scene_id if row.instance_id is None else f"{row.scene_id}/{row.instance_id}"
                    lines.append("| " + " | ".join(markdown_cell(text) for text in (which, row.what, row.license, row.reason)) + " |")
                lines.append("")
        return "\n".join(lines)


def shipment(reader: Reader, scenes: Sequence[str], allowed: Allowed) -> Shipment:
    """What of some scenes may be shipped under the allowed licenses."""
    scans = scan_licenses(reader)
    left_out = [
        LeftOut(scene, None, f"scan of {dataset}", stated(license_), "the license of its scan is not allowed")
        for scene in scenes
        for dataset, license_ in [scans.get(scene, (UNKNOWN, None))]
        if not allowed.permits(license_)
    ]
    refused = {entry.scene_id for entry in left_out}
    open_scenes = [scene for scene in scenes if scene not in refused]
    barred = _barred_objects(reader, set(open_scenes), scans, allowed)
    kept, episodes = {}, 0
    for scene in open_scenes:
        if scene not in barred:
            continue
        gone, placed = _with_what_they_carry(reader, scene, barred[scene])
        left_out += gone
        names = {entry.instance_id for entry in gone}
        if names == placed:
            left_out.append(LeftOut(scene, None, "replica", "", "none of its objects may be shipped"))
            refused.add(scene)
        else:
            kept[scene] = frozenset(placed - names)
            episodes += sum(row.instance_id in names for row in reader.rows(Episode, scene))
    shipped = tuple(scene for scene in open_scenes if scene not in refused)
    return Shipment(shipped, kept, tuple(sorted(left_out, key=lambda entry: (entry.scene_id, entry.instance_id or ""))), episodes)


def scan_licenses(reader: Reader) -> dict[str, tuple[str, str | None]]:
    """Dataset and license by scene."""
    with reader.connect(names=frozenset()) as connection:
        rows = connection.execute("SELECT scene_id, dataset, license FROM scenes").fetchall()
    return {scene: (dataset, license_) for scene, dataset, license_ in rows}


def attribution_page(reader: Reader, sent: Shipment) -> str:
    """`ATTRIBUTION.md` of what is shipped."""
    scans = scan_licenses(reader)
    placed = []
    with reader.connect(names=frozenset()) as connection:
        rows = connection.execute(
            "SELECT scene_id, instance_id, asset_id, assets.license, assets.author, assets.source, assets.provider"
            " FROM placements JOIN assets USING (asset_id)"
        )
        shipped = set(sent.scenes)
        while batch := rows.fetchmany(10_000):
            placed += [
                (scene, asset, license_, author, source, provider)
                for scene, instance, asset, license_, author, source, provider in batch
                if scene in shipped and (scene not in sent.kept or instance in sent.kept[scene])
            ]
    # Assets that were cut from another scan have its license, but it is no scan of this export.
    sources = {scan_of(source) for _, _, _, _, source, _ in placed}
    licenses = {scene: scans[scene][1] for scene in {*sent.scenes, *sources} if scene in scans}
    held = [
        (scene, asset, of_asset(license_, source, licenses), author, source, provider)
        for scene, asset, license_, author, source, provider in placed
    ]
    return attribution_of_rows({scene: scans[scene] for scene in sent.scenes}, held).page("Attribution")


def remake_scenes(
    lake: Lake,
    reader: Reader,
    scenes: Mapping[str, frozenset[str] | None],
    formats: Sequence[str],
    folder: Path,
    workers: int,
    advance: Callable[[str], None],
) -> tuple[list[ExportFile], list[ExportCheck]]:
    """Make scenes again; their rows. `scenes`: the objects that each keeps, None for all. Files lie in `folder`, named as blobs are."""
    arguments = [(lake.address, reader.snapshot_id, scene, scenes[scene], tuple(formats), folder) for scene in sorted(scenes)]
    files: list[ExportFile] = []
    checks: list[ExportCheck] = []
    if workers <= 1 or len(arguments) <= 1:
        for argument in arguments:
            made = remake_scene(*argument)
            files, checks = files + made[0], checks + made[1]
            advance(argument[2])
        return files, checks
    from flows.run.pool import WorkerPool

    with WorkerPool(min(workers, len(arguments))) as pool, ThreadPoolExecutor(min(workers, len(arguments))) as threads:
        for argument, made in zip(arguments, threads.map(lambda given: pool.call(remake_scene, *given), arguments), strict=True):
            files, checks = files + made[0], checks + made[1]
            advance(argument[2])
    return files, checks


def remake_scene(
    address: str, snapshot_id: int, scene_id: str, kept: frozenset[str] | None, formats: tuple[str, ...], folder: Path
) -> tuple[list[ExportFile], list[ExportCheck]]:
    """Export a scene of a snapshot with some of its objects, None for all, as the lake's own export was configured. Runs in a worker.

    Raises:
        LakeError: rows or blobs that the export needs cannot be read.
    """
    from flows.run.fingerprints import ModuleCaches
    from schemas.candidates import Asset
    from schemas.tables import TABLES
    from tasks import exports
    from tasks.stage import Context

    lake = Lake.open(address)
    reader = lake.snapshot(snapshot_id)
    rows: dict[str, list[Any]] = {
        table: reader.rows(TABLES[table].record, scene_id) for table in exports.STAGE.reads if table != "assets"
    }  # fmt: skip
    if kept is not None:
        rows["placements"] = [row for row in rows["placements"] if row.instance_id in kept]
        rows["episodes"] = [row for row in rows["episodes"] if row.instance_id in kept]
    assets = reader.rows_by_key(Asset, sorted({row.asset_id for row in rows["placements"]}))
    rows["assets"] = with_licenses_of_scans(assets, lambda: reader, scene_id)
    config, seed = _export_settings(reader, scene_id)
    config = dataclasses.replace(config, formats=tuple(name for name in config.formats if name in formats))
    context = Context(scene_id=scene_id, stage="exports", seed=seed, blobs=lake.blobs, caches=ModuleCaches())
    outcome = exports.run(**rows, context=context, config=config)
    made: list[ExportFile] = outcome.rows["export_files"]
    for row in made:
        (folder / row.file_blob).write_bytes(outcome.blobs[row.file_blob])
    return made, outcome.rows["export_checks"]


def _export_settings(reader: Reader, scene_id: str) -> tuple[Any, int]:
    """Config and seed of the export that a snapshot has of a scene."""
    from tasks.exports import ExportsConfig

    sql = "SELECT config, reasons FROM current_runs WHERE stage = 'exports' AND scene_id = ?"
    with reader.connect(names=asked_by(sql)) as connection:
        rows = connection.execute(sql, [scene_id]).fetchall()
    if not rows:  # the rows are there, so their run was before runs were kept
        return ExportsConfig(), 0
    seeds = [reason.partition("=")[2] for reason in rows[0][1] if reason.startswith("seed=")]
    return _restored(ExportsConfig(), json_value(rows[0][0])), int(seeds[0]) if seeds else 0


def _restored(default: Any, value: Any) -> Any:
    """A config from its canonical JSON; fields that it does not state keep their default."""
    if dataclasses.is_dataclass(default) and not isinstance(default, type) and isinstance(value, dict):
        names = {field.name for field in dataclasses.fields(default)} & value.keys()
        return dataclasses.replace(default, **{name: _restored(getattr(default, name), value[name]) for name in sorted(names)})
    return tuple(_restored(None, item) for item in value) if isinstance(value, list) else value


def _barred_objects(
    reader: Reader, scenes: set[str], scans: Mapping[str, tuple[str, str | None]], allowed: Allowed
) -> dict[str, dict[str, tuple[str, str]]]:
    """Objects whose asset may not be shipped, by scene: license and source by instance."""
    licenses = {scene: license_ for scene, (_, license_) in scans.items()}
    barred: dict[str, dict[str, tuple[str, str]]] = {}
    with reader.connect(names=frozenset()) as connection:
        rows = connection.execute(
            "SELECT scene_id, instance_id, assets.license, assets.source FROM placements LEFT JOIN assets USING (asset_id)"
        )
        verdicts: dict[tuple[str | None, str | None], tuple[bool, str]] = {}
        while batch := rows.fetchmany(10_000):
            for scene, instance, license_, source in batch:
                if (license_, source) not in verdicts:
                    holds = of_asset(license_ or "", source or "", licenses)
                    verdicts[license_, source] = (allowed.permits(holds), holds)
                permitted, holds = verdicts[license_, source]
                if not permitted and scene in scenes:
                    barred.setdefault(scene, {})[instance] = (holds, source or UNKNOWN)
    return barred


def _with_what_they_carry(reader: Reader, scene: str, barred: Mapping[str, tuple[str, str]]) -> tuple[list[LeftOut], set[str]]:
    """The barred objects of a scene with all that stands on or in them, and all objects that are placed there."""
    categories = {row.instance_id: row.category for row in reader.rows(Instance, scene)}
    placed = {row.instance_id for row in reader.rows(Placement, scene)}
    carried: dict[str, list[str]] = {}
    for row in reader.rows(Support, scene):
        if row.parent_id is not None:
            carried.setdefault(row.parent_id, []).append(row.instance_id)
    removed = {
        name: LeftOut(scene, name, categories.get(name, UNKNOWN), holds, f"the license of its asset is not allowed ({source})")
        for name, (holds, source) in barred.items()
    }
    waiting = sorted(removed)
    while waiting:
        parent = waiting.pop(0)
        for child in sorted(carried.get(parent, ())):
            if child in placed and child not in removed:
                removed[child] = LeftOut(scene, child, categories.get(child, UNKNOWN), "", f"stood on or in {parent}, which is left out")
                waiting.append(child)
    return list(removed.values()), placed


def left_out_lines(sent: Shipment) -> list[str]:
    """What was left out, a line for each license and reason, for a terminal."""
    scenes = [entry for entry in sent.left_out if entry.instance_id is None]
    objects = Counter(entry.license or "carried by one that is left out" for entry in sent.left_out if entry.instance_id is not None)
    lines = [f"left out: scene {entry.scene_id}: {entry.reason} ({entry.license or 'see its objects'})" for entry in scenes]
    lines += [f"left out: {counted(count, 'object')}: {license_}" for license_, count in sorted(objects.items())]
    return [*lines, f"left out: {counted(sent.episodes, 'episode')} without a target"] if sent.episodes else lines
