"""`metascenes annotate`: what people chose, and what reviewers say of it, into the lake."""

from __future__ import annotations

import json
from pathlib import Path

import click

from flows.commands.options import existing_lake, json_option, lake_option


@click.group("annotate", short_help="Import what annotators chose, and what reviewers say of it.")
def command() -> None:
    """Import what annotators chose, and what reviewers say of it.

    Example: metascenes annotate import batch.json --lake ./lake
    """


@command.command("import")
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--dry-run", is_flag=True, help="Check the batch against the lake; write nothing.")
@lake_option
@json_option
def import_batch(file: Path, dry_run: bool, address: str, as_json: bool) -> None:
    """Import a batch of annotations; all of it or nothing. The next run redoes what depends on it.

    Example: metascenes annotate import batch.json --lake ./lake
    """
    from flows.inputs.annotation import import_annotations

    result = import_annotations(existing_lake(address), file, dry_run)
    if as_json:
        print(json.dumps(result))
        return
    if result["already"]:
        print(f"batch {result['batch_id']} is in the lake already, with the same answers; nothing to do")
        return
    verb = "would be imported" if dry_run else "imported"
    whose = f"{result['annotations']} answers of {result['annotators']} annotators on {result['scenes']} scenes"
    print(f"batch {result['batch_id']}: {whose} {verb}")


@command.command("review")
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--dry-run", is_flag=True, help="Check the reviews against the lake; write nothing.")
@lake_option
@json_option
def import_review(file: Path, dry_run: bool, address: str, as_json: bool) -> None:
    """Import reviews of an annotation batch that is in the lake; all of the file or nothing.

    The view quality_history shows them. Where the last review of a batch returned it, none of its answers counts any more:
    the next run makes its scenes again without them. They are given again in a new batch.

    Example: metascenes annotate review review.json --lake ./lake
    """
    from flows.inputs.annotation import import_reviews

    result = import_reviews(existing_lake(address), file, dry_run)
    if as_json:
        print(json.dumps(result))
        return
    if result["already"] == result["reviews"]:
        print(f"the reviews of batch {result['batch_id']} are in the lake already; nothing to do")
        return
    verb = "would be imported" if dry_run else "imported"
    verdict = f"{result['wrong']} of {result['sampled']} sampled answers wrong, {result['returned']} returned"
    known = f", {result['already']} known already" if result["already"] else ""
    print(f"batch {result['batch_id']}: {result['reviews']} review{'' if result['reviews'] == 1 else 's'}{known} {verb}: {verdict}")
