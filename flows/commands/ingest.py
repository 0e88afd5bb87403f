"""`metascenes import`: finished datasets of others, as tables of the lake. (No module can be called `import`.)"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import end_with_failures, grouped, json_option, lake_option, workers_option
from schemas.wording import counted

if TYPE_CHECKING:
    from flows.inputs.ingestion import DatasetImport
    from tasks.ingestion.scene import Kind

_import_options = grouped(
    json_option,
    click.option("--dry-run", is_flag=True, help="Say what would be imported; write nothing."),
    click.option("--retry-failed", is_flag=True, help="Read scenes again that failed before on the same files."),
    click.option("--seed", type=int, default=0, show_default=True, help="Seed of the points that are drawn on objects."),
    workers_option,
    lake_option,
    click.option("--dataset", required=True, metavar="NAME", help="Name of the dataset in the lake; scenes are <name>/<scan>."),
    click.argument("folder", metavar="PATH", type=click.Path(path_type=Path)),
)
"""What imports of all layouts take."""


@click.group("import", short_help="Import finished datasets: Habitat scene datasets, the MetaScenes release.")
def command() -> None:
    """Import finished datasets of others, so that the same questions can be asked of them.

    Example: metascenes import habitat ./hssd-hab --dataset hssd --lake ./lake
    """


@command.command("habitat", short_help="Import a Habitat scene dataset.")
@_import_options
@click.option("--config", metavar="NAME", help="Scene dataset config, where the folder has several.")
def import_habitat(
    folder: Path, dataset: str, address: str, workers: int, seed: int, retry_failed: bool, dry_run: bool, as_json: bool, config: str | None
) -> None:
    """Import a Habitat scene dataset: its scene instances, objects, categories, navmeshes.

    PATH is a *.scene_dataset_config.json, its folder, or a folder above. Where there are several configs, choose one with --config.
    Importing a dataset again takes in what changed, and nothing else.

    Example: metascenes import habitat ./hssd-hab --config hssd-hab-uncluttered --dataset hssd --lake ./lake
    """
    _run("habitat", folder, dataset, address, None, config, workers, seed, retry_failed, dry_run, as_json)


@command.command("metascenes", short_help="Import the released MetaScenes layout.")
@_import_options
@click.option("--labels", type=click.Path(path_type=Path, file_okay=False, exists=True),
              help="Folder with <scan>.json, the names of each scan's instances; the release has none.")  # fmt: skip
def import_metascenes(
    folder: Path, dataset: str, address: str, workers: int, seed: int, retry_failed: bool, dry_run: bool, as_json: bool, labels: Path | None
) -> None:
    """Import the released MetaScenes layout: Annotation_scenes, Physical_simu, Layout.

    PATH is the folder that holds Annotation_scenes. Importing it again takes in what changed, and nothing else.

    Example: metascenes import metascenes ./MetaScenes --dataset metascenes --labels ./instance_id_to_name --lake ./lake
    """
    _run("metascenes", folder, dataset, address, labels, None, workers, seed, retry_failed, dry_run, as_json)


def _run(
    kind: Kind, folder: Path, dataset: str, address: str, labels: Path | None, config: str | None, workers: int, seed: int,
    retry_failed: bool, dry_run: bool, as_json: bool,
) -> None:  # fmt: skip
    from flows.inputs.ingestion import import_dataset
    from warehouse.lake import Lake

    result = import_dataset(
        Lake.open(address),
        kind,
        folder,
        dataset,
        labels=labels,
        config=config,
        seed=seed,
        workers=workers,
        dry_run=dry_run,
        retry_failed=retry_failed,
    )
    print(json.dumps(_as_json(result, dry_run)) if as_json else _as_text(result, dry_run))
    end_with_failures({} if as_json else {scene.scene_id: scene.error for scene in result.failed}, bool(result.failed))


def _as_json(result: DatasetImport, dry_run: bool) -> dict[str, Any]:
    scenes = [
        {name: getattr(scene, name) for name in ("scene_id", "action", "why", "objects", "notes", "error")} for scene in result.scenes
    ]
    return {"dataset": result.dataset, "format": result.kind, "dry_run": dry_run, "scenes": scenes, "failed": len(result.failed)}


def _as_text(result: DatasetImport, dry_run: bool) -> str:
    """A line of what was done; for a dry run also a line for each scene."""
    fresh = [scene for scene in result.scenes if scene.action == "import" and scene.error is None]
    kept = [scene for scene in result.scenes if scene.action == "reuse"]
    lines = [f"{scene.scene_id:<40} {scene.action:<7} {scene.why}" for scene in result.scenes] if dry_run else []
    notes = sum(len(scene.notes) for scene in result.scenes)
    verb = "would be imported" if dry_run else "imported"
    parts = [f"{counted(len(fresh), 'scene')} {verb}", f"{len(kept)} unchanged", f"{len(result.failed)} failed"]
    if fresh and not dry_run:
        parts[0] += f" ({counted(sum(scene.objects for scene in fresh), 'object')})"
    if notes:
        parts.append(f"{counted(notes, 'note')} (in stage_runs.degradations)")
    return "\n".join([*lines, f"{result.dataset}: {', '.join(parts)}"])
