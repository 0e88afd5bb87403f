"""`metascenes lake`: keep the lake small and whole, measure it, copy it, and make it forget."""

from __future__ import annotations

import dataclasses
import functools
import json
import operator
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import existing_lake, json_option, lake_option
from flows.progress import Progress
from schemas.wording import counted, meant, noun

if TYPE_CHECKING:
    from flows.server.erasure import PrefectErasure
    from warehouse.upkeep.erasure import Erasure, Traces
    from warehouse.upkeep.sizes import Size

dry_run_option = click.option("--dry-run", is_flag=True, help="Say what would be done; change nothing.")


@click.group("lake", short_help="Compact, vacuum, measure, back up, restore the lake, or erase a scene from it.")
def command() -> None:
    """Keep the lake small and whole, measure it, copy it, and make it forget.

    Example: metascenes lake vacuum --days 30 --dry-run --lake ./lake
    """


@command.command("compact")
@click.option("--table", "tables", multiple=True, metavar="TABLE", help="Only this table; may be repeated.")
@dry_run_option
@lake_option
@json_option
def compact(tables: tuple[str, ...], dry_run: bool, address: str, as_json: bool) -> None:
    """Put the tables' small files together, sorted by key. Rows stay what they are; a new snapshot says `compaction`.

    Files of older snapshots stay until `metascenes lake vacuum` removes them.

    Example: metascenes lake compact --table instances --lake ./lake
    """
    from schemas.tables import TABLES
    from warehouse.upkeep.compaction import compact as run

    lake = existing_lake(address)
    with Progress("compacting", len(tables) or len(TABLES)) as progress:
        done = run(lake, tables, dry_run=dry_run, advance=progress.advance)
    if as_json:
        print(json.dumps(dataclasses.asdict(done)))
        return
    for table in done.tables:
        sizes = f"{_megabytes(table.bytes_rewritten)}{'' if dry_run else f' to {_megabytes(table.bytes_after)}'}"
        print(
            f"{table.table:<22} {table.files_rewritten} of "
            f"{counted(table.files_before, 'file')} rewritten, {table.files_after} after, {sizes}"
        )
    if not done.tables:
        print("nothing to put together")
    else:
        print("would be done" if dry_run else f"snapshot {done.snapshot_id}")


@command.command("vacuum")
@click.option("--days", type=click.FloatRange(min=0), default=7.0, show_default=True, help="Keep snapshots that were replaced since.")
@dry_run_option
@lake_option
@json_option
def vacuum(days: float, dry_run: bool, address: str, as_json: bool) -> None:
    """Remove old snapshots that are not released, and the data files, logs and blobs that nothing else names.

    The last snapshot and every release stay. Blobs that were put within the last day stay, too.

    Example: metascenes lake vacuum --days 30 --dry-run --lake ./lake
    """
    from warehouse.upkeep.vacuum import vacuum as run

    done = run(existing_lake(address), days=days, dry_run=dry_run)
    if as_json:
        print(json.dumps(dataclasses.asdict(done) | {"bytes": done.bytes}))
        return
    snapshots = f"{counted(len(done.snapshots), 'snapshot')}{f' ({_numbers(done.snapshots)})' if done.snapshots else ''}"
    print(
        f"{snapshots}, {counted(done.files, 'data file')}, {counted(done.blobs, 'blob')} "
        f"{'would go' if dry_run else 'removed'}: {_megabytes(done.bytes)}"
    )
    if done.young_blobs:
        print(_young(done.young_blobs))


@command.command("size")
@lake_option
@json_option
def size(address: str, as_json: bool) -> None:
    """Say how large the lake is, by table, by the columns that name its blobs, and by what else lies in it; every file counts once.

    `live` is what the newest snapshot is made of, `older` what only older snapshots name, `unnamed` what no snapshot does: vacuum removes
    these where they are old enough. With --json: snapshot_id, total, and tables, blobs and folders with name, rows, files and bytes of each
    kind.

    Example: metascenes lake size --lake ./lake
    """
    from warehouse.upkeep.sizes import measure

    measured = measure(existing_lake(address))
    if as_json:
        kinds = {"tables": measured.tables, "blobs": measured.blobs, "folders": measured.folders}
        sizes = {name: [_flat(part) for part in parts] for name, parts in kinds.items()}
        print(json.dumps({"snapshot_id": measured.snapshot_id, "total": _flat(measured.total()), **sizes}))
        return
    groups = (("table", measured.tables), ("blobs named by", measured.blobs), ("beside them", measured.folders))
    for title, parts in groups:
        print(f"{title:<32} {'rows':>12} {'files':>9} {'all':>12} {'live':>12} {'older':>12} {'unnamed':>12}")
        for part in (*parts, dataclasses.replace(measured.total(parts), name="together")):
            rows = "" if title != "table" or part.rows is None else f"{part.rows}"
            sizes_of = " ".join(f"{_in_words(held.bytes):>12}" for held in (part.all, part.live, part.older, part.unnamed))
            print(f"{part.name:<32} {rows:>12} {part.all.files:>9} {sizes_of}")
        print()
    whole = measured.total()
    print(f"{_in_words(whole.all.bytes)} in {counted(whole.all.files, 'file')} at snapshot {measured.snapshot_id}")


def _flat(size: Size) -> dict[str, Any]:
    """A size as one JSON object."""
    shown: dict[str, Any] = {"name": size.name, "rows": size.rows, "files": size.all.files, "bytes": size.all.bytes}
    for kind in ("live", "older", "unnamed", "log"):
        shown |= {f"{kind}_files": getattr(size, kind).files, f"{kind}_bytes": getattr(size, kind).bytes}
    return shown


@command.command("backup")
@click.argument("target")
@lake_option
@json_option
def backup(target: str, address: str, as_json: bool) -> None:
    """Copy all snapshots and releases to a folder or s3://bucket/prefix; the next time only what is new.

    Others may go on writing. A backup is itself a lake: `metascenes doctor lake --lake TARGET` checks it.

    Example: metascenes lake backup /mnt/backups/lake --lake ./lake
    """
    from warehouse.upkeep.backup import backup as run

    lake = existing_lake(address)
    with Progress("copying", sum(1 for _ in lake.storage.walk("")) if sys.stderr.isatty() else 0) as progress:
        done = run(lake, target, advance=progress.advance)
    _tell_copied(f"snapshot {done.snapshot_id} in {target}", done, as_json)


@command.command("restore")
@click.argument("source")
@lake_option
@json_option
def restore(source: str, address: str, as_json: bool) -> None:
    """Make a lake at a new, empty address out of a backup. Every file is held against its hash.

    Example: metascenes lake restore /mnt/backups/lake --lake ./restored
    """
    from warehouse.upkeep.backup import restore as run

    with Progress("copying", 1) as progress:
        done = run(source, address, advance=progress.advance)
    _tell_copied(f"snapshot {done.snapshot_id} in {address}", done, as_json)


@command.command("erase")
@click.argument("scene")
@click.option("--yes", is_flag=True, help="Do not ask.")
@dry_run_option
@lake_option
@json_option
def erase(scene: str, yes: bool, dry_run: bool, address: str, as_json: bool) -> None:
    """Erase a scene from all tables, blobs, snapshots, releases, drafts, Prefect and this machine's caches, and search for what is left.

    Only releases and the last snapshot stay, without the scene. There is no way back but a backup from before. Prefect's
    local database and the project's temporary folders are searched as well; of a server elsewhere the command says how to
    remove the records. Exit code 1 says that something of the scene was found, or that blobs which no row names are too
    young to be removed: a vacuum of the same day may have left them of this scene. The same command again goes on where
    this one was stopped. Scenes that `metascenes synthesize` made of it show what it showed, and are erased before it.

    Example: metascenes lake erase scannet/scene0001_00 --dry-run --lake ./lake
    """
    from flows.scans.erasure import erase_from_caches, search_temporary
    from flows.server.erasure import PrefectErasure, erase_from_prefect, search_prefect
    from flows.view.annotating.drafts import erase_drafts
    from schemas.machine.scratch import sweep_temporary_folders
    from warehouse.upkeep.erasure import erase as run
    from warehouse.upkeep.erasure.dependents import FurnishedAnewError, furnished_anew
    from warehouse.upkeep.erasure.plan import read_plan

    cached: list[int] = []
    drafts: list[int] = []
    prefect: list[PrefectErasure] = []
    erased_traces: list[Traces] = []

    def forget(traces: Traces, hashes: frozenset[str]) -> None:
        with_hashes = dataclasses.replace(traces, hashes=hashes)
        erased_traces.append(with_hashes)
        cached.append(erase_from_caches(traces, hashes) + len(sweep_temporary_folders()))
        drafts.append(erase_drafts(lake, traces))
        prefect.append(erase_from_prefect(with_hashes))

    lake = existing_lake(address)
    also = furnished_anew(lake, scene)
    asked = f"Erase {', '.join([scene, *also])} from {lake.address} for good?"
    if not (yes or dry_run) and not (sys.stdin.isatty() and click.confirm(asked, err=True)):
        raise click.UsageError(f"{scene} is erased for good: give --yes to say that you mean it, or --dry-run to see what would go")
    with Progress("erasing", sum(1 for _ in lake.storage.walk("")) if sys.stderr.isatty() else 0) as progress:
        begun = read_plan(lake.storage)  # of this scene: what was made of it is gone, or comes into no snapshot any more
        waiting = [] if dry_run or (begun is not None and begun.scene_id == scene) else [*also]
        while True:
            try:
                while waiting:
                    run(lake, waiting[0], advance=progress.advance, elsewhere=forget)
                    waiting.pop(0)
                done = run(lake, scene, dry_run=dry_run, advance=progress.advance, elsewhere=forget)
                break
            except FurnishedAnewError as late:  # a command that is at work has added some meanwhile
                also = (*also, *(name for name in late.scenes if name not in also))
                waiting = [*late.scenes, *(name for name in waiting if name not in late.scenes)]
    if dry_run:
        drafts.append(erase_drafts(lake, done.traces, dry_run=True))
        prefect.append(erase_from_prefect(done.traces, dry_run=True))
    elif done.proof is not None:
        traces = functools.reduce(operator.or_, erased_traces)
        done = dataclasses.replace(done, proof=done.proof | search_prefect(traces) | search_temporary(traces))
    known = lake.snapshot().matching("scenes", {}, ["scene_id"]).column("scene_id").to_pylist()
    outside = Outside(sum(cached), sum(drafts), PrefectErasure.total(prefect))
    _tell_erased(done, also, outside, dry_run, as_json, known)
    if done.proof is not None and (done.proof.hits or done.young_blobs):
        raise click.exceptions.Exit(1)


@dataclasses.dataclass(frozen=True)
class Outside:
    """Counts removed outside of the lake's tables: files and entries of caches, drafts of annotators, records of Prefect."""

    cached: int
    drafts: int
    prefect: PrefectErasure


def _tell_erased(done: Erasure, also: tuple[str, ...], outside: Outside, dry_run: bool, as_json: bool, known: Sequence[str]) -> None:
    prefect, drafts = outside.prefect, outside.drafts
    if as_json:
        shown: dict[str, Any] = {
            "scene_id": done.scene_id, "dry_run": dry_run, "rows": dict(done.rows), "staged_runs": done.staged_runs, "blobs": done.blobs,
            "snapshots": list(done.snapshots), "releases": list(done.releases), "young_blobs": done.young_blobs,
            "cached_files": outside.cached, "drafts": drafts, "prefect": dataclasses.asdict(prefect), "models": list(done.models),
            "also": list(also),
            "proof": None if done.proof is None else dataclasses.asdict(done.proof),
        }  # fmt: skip
        print(json.dumps(shown))
        return
    verb = "would go" if dry_run else "erased"
    for name in also:
        print(f"{name:<22} all of it {verb}: it was made of {done.scene_id}")
    for table, count in done.rows.items():
        print(f"{table:<22} {counted(count, 'row')} {verb}")
    if not (sum(done.rows.values()) or done.staged_runs or done.blobs or done.releases or drafts):
        print("; ".join(filter(None, (f"nothing in the lake names {done.scene_id}", meant(done.scene_id, known).strip()))))
    print(
        f"{counted(done.staged_runs, 'staged run')} and {counted(done.blobs, 'blob')} {verb}, "
        f"and {counted(outside.cached, 'file or entry', 'files and entries')} of this machine's caches"
    )
    if prefect.deleted or prefect.redacted or prefect.files:
        redacted = f", names in {counted(prefect.redacted, 'row')} redacted" if prefect.redacted else ""
        print(
            f"{counted(prefect.deleted, 'row')} of Prefect's database and {counted(prefect.files, 'file')} of its home {verb}"
            f"{redacted}: "
            f"{prefect.database or 'no database here'}"
        )
    if drafts:
        print(f"{counted(drafts, 'draft')} of annotators {verb}")
    if done.snapshots:
        print(
            f"{counted(len(done.snapshots), 'snapshot is', 'snapshots are')} "
            f"{'to be ' if dry_run else ''}dropped: {_numbers(done.snapshots)}"
        )
    if done.releases:
        print(f"releases {'to be ' if dry_run else ''}written anew: {', '.join(done.releases)}")
    if done.models:
        names = ", ".join(model_id[:12] for model_id in done.models)
        print(f"trained while it was there, and not unlearned: models {names}; `metascenes models withdraw`, and train anew")
    if done.young_blobs:
        whose = f"{_young(done.young_blobs)}, of whatever scene"
        print(f"not proven: {whose}; give the same command again in a day")
    if done.proof is not None:
        proof = done.proof
        print(
            f"searched {counted(proof.files, 'file')}, {_megabytes(proof.bytes)}, "
            f"{counted(proof.rows, 'row')}: {counted(len(proof.hits), 'hit')}"
        )
        for hit in proof.hits:
            print(f"{hit.path}: {hit.place}: {counted(hit.count, 'time')}{', ' if hit.traces else ''}{', '.join(hit.traces)}")
    print("Not reached: scans, folders that were exported, backups (make the next one), other machines' caches and browsers.")
    for line in prefect.remains:
        print(line)


def _tell_copied(what: str, done: Any, as_json: bool) -> None:
    if as_json:
        print(json.dumps(dataclasses.asdict(done)))
        return
    copied = f"{done.copied_files} copied ({_megabytes(done.copied_bytes)})"
    print(f"{what}: {counted(done.files, 'file')} ({_megabytes(done.bytes)}), {copied}, {done.removed_files} removed")


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB"


def _young(blobs: int) -> str:
    younger = noun(blobs, "blob that no row names is younger", "blobs that no row names are younger")
    return f"{blobs} {younger} than a day and {noun(blobs, 'stays', 'stay')}"


def _in_words(size: int) -> str:
    """A size in the unit that fits."""
    if size < 1e6:
        return f"{size} B" if size < 1000 else f"{size / 1e3:.1f} kB"
    return _megabytes(size) if size < 1e9 else f"{size / 1e9:.1f} GB"


def _numbers(numbers: tuple[int, ...]) -> str:
    shown = ", ".join(map(str, numbers[:10]))
    return shown if len(numbers) <= 10 else f"{shown}, ..."
