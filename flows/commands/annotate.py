"""`metascenes annotate`: what people are asked, what they choose, and what reviewers say of it."""

from __future__ import annotations

import getpass
import json
from pathlib import Path
from typing import Any

import click

from flows.commands.options import existing_lake, json_option, lake_option, listening_options, seed_option, settings_options
from schemas.annotation import PICKS
from schemas.text import one_line
from schemas.wording import counted, noun


@click.group("annotate", short_help="Ask people, take in what they chose, and have it reviewed.")
def command() -> None:
    """Ask people, take in what they chose, and have it reviewed.

    A batch is created here or was made elsewhere; its answers reach scenes once a reviewed sample of them was accepted.

    Example: metascenes annotate create --batch batch-1 --annotator ada --annotator bob --out work --lake ./lake
    """


@command.command("create")
@click.option("--batch", "batch_id", required=True, metavar="NAME", help="Name of the batch, new to the lake.")
@click.option("--annotator", "annotators", multiple=True, metavar="NAME", help="Who is asked; may be repeated.")
@click.option("--overlap", type=click.IntRange(min=1), default=1, show_default=True, help="Annotators that each object is given to.")
@click.option(
    "--pick", type=click.Choice(PICKS), default="all", show_default=True,
    help="All objects with candidates, those nobody answered for, or the most doubtful ones first.",
)  # fmt: skip
@click.option("--count", type=click.IntRange(min=1), help="Objects at most.")
@click.option("--scene", "scenes", multiple=True, metavar="SCENE", help="Only objects of this scene; may be repeated.")
@click.option("--out", required=True, type=click.Path(path_type=Path), help="Folder to make, with all that it takes to answer.")
@click.option("--again", is_flag=True, help="Write the folder of a batch anew that is in the lake already.")
@click.option("--dry-run", is_flag=True, help="Say what would be asked; write nothing.")
@settings_options
@seed_option
@lake_option
@json_option
def create(
    batch_id: str, annotators: tuple[str, ...], overlap: int, pick: str, count: int | None, scenes: tuple[str, ...], out: Path, again: bool,
    dry_run: bool, config_file: Path | None, settings: tuple[str, ...], seed: int | None, address: str, as_json: bool,
) -> None:  # fmt: skip
    """Pick objects, assign them to annotators, and write a folder that any tool can work on.

    The same seed gives the same assignment; loads differ by one object at most. The folder has work.json (after work.schema.json),
    GLBs and thumbnails of the candidates, what the scan has of each object, and a file for the answers of each annotator.

    Example: metascenes annotate create --batch batch-1 --annotator ada --annotator bob --overlap 2 --pick doubtful --out work --lake ./lake
    """
    from flows.inputs.annotation import BatchPlan, create_batch
    from flows.run.configuration import configure

    plan = BatchPlan(batch_id, annotators, overlap, pick, scenes, count)
    configuration = configure(config_file, settings, seed=seed)
    result = create_batch(existing_lake(address), plan, out, again=again, dry_run=dry_run, configuration=configuration)
    loads = ", ".join(f"{name} {load}" for name, load in result["assignments"].items())
    verb = "would be asked" if dry_run else f"are in {out}"
    _print(
        result, as_json, f"batch {batch_id}: {counted(result['objects'], 'object')} of {counted(result['scenes'], 'scene')} {verb}; {loads}"
    )
    if not dry_run and not as_json:
        print(f"next: annotators fill in {out}/answers/*.json, then: metascenes annotate import {out}/answers.json")


@command.command("import")
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@click.option(
    "--format", "batch_format", type=click.Choice(["answers", "label-studio", "cvat", "scan2cad"]), default="answers", show_default=True,
    help="Answers after batch.schema.json, a JSON export of Label Studio, CVAT's annotations.xml, or Scan2CAD's full_annotations.json.",
)  # fmt: skip
@click.option(
    "--annotator", "annotators", multiple=True, metavar="[ACCOUNT=]NAME",
    help="Who answered, for label-studio and cvat: NAME where the export names nobody, ACCOUNT=NAME for others; may be repeated.",
)  # fmt: skip
@click.option("--batch", "batch_id", default="scan2cad", show_default=True, metavar="NAME", help="Name of the batch, for scan2cad.")
@click.option("--dry-run", is_flag=True, help="Check the batch against the lake; write nothing.")
@settings_options
@lake_option
@json_option
def import_batch(
    file: Path, batch_format: str, annotators: tuple[str, ...], batch_id: str, dry_run: bool, config_file: Path | None,
    settings: tuple[str, ...], address: str, as_json: bool,
) -> None:  # fmt: skip
    """Import a batch of annotations; all of the file or nothing.

    What the lake has already is left alone, later answers correct earlier ones, and history is kept. Answers reach scenes once the
    batch was accepted; of a batch that was made elsewhere at once, with --set annotation.unreviewed_imports_count=true.

    Example: metascenes annotate import batch.json --lake ./lake
    """
    from flows.inputs.annotation import import_alignments, import_annotations, import_export
    from flows.run.configuration import configure

    is_exported = batch_format in ("label-studio", "cvat")
    if annotators and not is_exported:
        raise click.UsageError("--annotator is for --format label-studio and cvat: other files say who answered")
    lake, configuration = existing_lake(address), configure(config_file, settings)
    if is_exported:
        result = import_export(lake, file, batch_format, annotators, dry_run, configuration)
    elif batch_format == "scan2cad":
        result = import_alignments(lake, file, batch_id, dry_run=dry_run, configuration=configuration)
    else:
        result = import_annotations(lake, file, dry_run, configuration)
    batch_id = result["batch_id"]
    for line in () if as_json else result.get("left_out", ()):
        click.echo(f"note: left out {one_line(line)}", err=True)
    if result["already"]:
        line = f"batch {batch_id} is in the lake already, with the same answers; nothing to do"
    else:
        verb = "would be imported" if dry_run else "imported"
        whose = f"{counted(result['annotations'], 'answer')} of {counted(result['annotators'], 'annotator')} "
        whose += f"on {counted(result['scenes'], 'scene')}"
        parts = [f"{result[name]} {name}" for name in ("new", "corrected", "withdrawn") if result[name]]
        line = f"batch {batch_id}: {whose} {verb}" + (f" ({', '.join(parts)})" if parts else "")
    _print(result, as_json, line)
    if not dry_run and not as_json:
        _print_next(lake, batch_id)


@command.command("submit")
@click.argument("batch_id", metavar="BATCH")
@click.option("--by", default=getpass.getuser, show_default="user of this machine", metavar="NAME", help="Who hands it in.")
@click.option("--partial", is_flag=True, help="Hand in what there is, though some assigned answers are missing.")
@lake_option
@json_option
def submit_batch(batch_id: str, by: str, partial: bool, address: str, as_json: bool) -> None:
    """Hand in a batch that was created: its answers stay as they are until it is returned.

    Example: metascenes annotate submit batch-1 --by ada --lake ./lake
    """
    from flows.inputs.annotation import submit

    lake = existing_lake(address)
    result = submit(lake, batch_id, by, partial)
    _print(result, as_json, f"batch {batch_id}: {counted(result['answers'], 'answer')} handed in, round {result['round']}")
    if not as_json:
        _print_next(lake, batch_id)


@command.command("sample")
@click.argument("batch_id", metavar="BATCH")
@click.option("--reviewer", metavar="NAME", help="Write a form for this reviewer, with the answers that are not their own.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="New file for the form; sample.json by default.")
@lake_option
@json_option
def sample(batch_id: str, reviewer: str | None, out: Path | None, address: str, as_json: bool) -> None:
    """Draw the answers that are reviewed: a seeded tenth, and at least fifty, if there are as many.

    A sample that was drawn already is shown again. With --reviewer, a form is written to be filled in: passes is true or false, and
    what fails has a remark.

    Example: metascenes annotate sample batch-1 --reviewer rita --out rita.json --lake ./lake
    """
    from flows.inputs.annotation import batch_list, draw_sample, open_reviews
    from schemas.errors import InputError

    lake, file = existing_lake(address), out or Path("sample.json")
    if reviewer is not None and file.exists():
        remedy = f"hand it in with `metascenes annotate review {file}`, or name a file that is not"
        raise InputError(str(file), "--out", "is there already, with verdicts maybe", remedy)
    (before,) = batch_list(lake, batch_id)
    result = before if before["state"] == "in_review" else draw_sample(lake, batch_id)
    _print(result, as_json, f"batch {batch_id}: {result.get('why', str(result['sampled']) + ' answers are being reviewed')}")
    if reviewer is not None:
        rows = open_reviews(lake, batch_id, reviewer)
        names = ("scene_id", "instance_id", "annotator")
        verdicts = [{name: row[name] for name in names} | _own_verdict(row["verdict"], reviewer) for row in rows]
        form = {"batch_id": batch_id, "reviewer": reviewer, "verdicts": verdicts}
        file.write_text(json.dumps(form, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        if not as_json:
            print(f"{file}: {counted(len(rows), 'answer')} to judge; then: metascenes annotate review {file}")


@command.command("review")
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@click.option("--dry-run", is_flag=True, help="Check reviews made elsewhere against the lake; write nothing.")
@lake_option
@json_option
def import_review(file: Path, dry_run: bool, address: str, as_json: bool) -> None:
    """Take in verdicts on sampled answers, or a review of a batch that was made elsewhere; all of the file or nothing.

    When all of the sample is judged, the batch is accepted if more than 98 % passed, else all of it goes back with the remarks
    (`annotation.pass_share`). Where a batch was returned, none of its answers counts any more: the next run makes its scenes again
    without them. The views annotation_batch_states and quality_history show it.

    Example: metascenes annotate review review.json --lake ./lake
    """
    from flows.inputs.annotation import conclude, import_reviews, save_verdicts
    from schemas.errors import InputError
    from tasks.annotation.verdicts import load_review_file

    lake = existing_lake(address)
    document = load_review_file(file)
    if isinstance(document, dict) and "verdicts" in document:
        if dry_run:
            raise InputError(file.name, "verdicts", "cannot be tried: --dry-run is for reviews made elsewhere", "leave it out")
        result = save_verdicts(lake, document, file.name)
        if result["judged"] == result["sampled"]:
            result |= conclude(lake, result["batch_id"])
            line = (
                f"{result['passed']} of {counted(result['sampled'], 'reviewed answer')} {noun(result['passed'], 'passes', 'pass')}; "
                f"of all {result['answers']} between "
                f"{result['pass_low']:.1%} and {result['pass_high']:.1%} do: {result['verdict']}"
            )
        else:
            line = f"{result['judged']} of {counted(result['sampled'], 'answer')} judged, "
            line += f"{result['failed']} of them {noun(result['failed'], 'does', 'do')} not pass"
        _print(result, as_json, f"batch {result['batch_id']}: {line}")
        if not as_json:
            _print_next(lake, result["batch_id"])
        return
    result = import_reviews(lake, file, dry_run)
    if result["already"] == result["reviews"]:
        line = f"the reviews of batch {result['batch_id']} are in the lake already; nothing to do"
    else:
        verb = "would be imported" if dry_run else "imported"
        verdict = f"{result['wrong']} of {counted(result['sampled'], 'sampled answer')} wrong, {result['returned']} returned"
        known = f", {result['already']} known already" if result["already"] else ""
        count = f"{result['reviews']} review{'' if result['reviews'] == 1 else 's'}"
        line = f"batch {result['batch_id']}: {count}{known} {verb}: {verdict}"
    _print(result, as_json, line)


@command.command("serve")
@click.argument("batch_id", metavar="BATCH")
@click.option("--reviewer", "reviewers", multiple=True, metavar="NAME", help="Who judges answers of others; may be repeated.")
@click.option(
    "--drafts", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE", show_default="in the folder of the lake",
    help="File of what is begun and not saved, with the tokens beside it.",
)  # fmt: skip
@listening_options
@lake_option
@json_option
def serve_batch(
    batch_id: str, reviewers: tuple[str, ...], drafts: Path | None, host: str, port: int, address: str, as_json: bool
) -> None:  # fmt: skip
    """Serve a batch that was created to its annotators, and to reviewers, in their browsers.

    Prints an address with a token for each of them, which lets in whoever has it, as that person, and serves until it is interrupted.
    Started again, it gives the same addresses, while the port is free.

    Example: metascenes annotate serve batch-1 --reviewer rita --lake ./lake
    """
    from flows.view.annotating.hosting import serve_annotation
    from flows.view.bundle import client_file

    client_file("annotate.html")  # before anything is read: it may not have been built

    def announce(people: dict[str, dict[str, Any]]) -> None:
        if as_json:
            click.echo(json.dumps({"addresses": people}))
            return
        width = max(map(len, people))
        for name, entry in people.items():
            address = entry["address"] or f"withdrawn; `metascenes annotate tokens {batch_id} --renew {name}` makes a new address"
            click.echo(f"{name:<{width}}  {address}  ({' and '.join(entry['roles'])})")
        click.echo("each token lets in whoever has it, as that person; Ctrl-C ends")

    serve_annotation(existing_lake(address), batch_id, reviewers, drafts, host, port, announce)


@command.command("tokens")
@click.argument("batch_id", metavar="BATCH")
@click.option("--withdraw", "withdrawn", multiple=True, metavar="NAME", help="Let this person in no more; may be repeated.")
@click.option("--renew", "renewed", multiple=True, metavar="NAME", help="Give this person a new address, the only one; may be repeated.")
@click.option("--addresses", is_flag=True, help="Print addresses with their tokens.")
@click.option("--dry-run", is_flag=True, help="Print the people as they would be; change nothing.")
@click.option(
    "--drafts", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE", show_default="in the folder of the lake",
    help="File of drafts that was given to `serve`.",
)  # fmt: skip
@lake_option
@json_option
def list_tokens(
    batch_id: str, withdrawn: tuple[str, ...], renewed: tuple[str, ...], addresses: bool, dry_run: bool, drafts: Path | None, address: str,
    as_json: bool,
) -> None:  # fmt: skip
    """List the people who have a token of a served batch; withdraw tokens, or renew them.

    A running server notices: the next request of a person whose token was withdrawn or renewed is refused. Who was withdrawn stays
    so until renewed, also when the server starts again.

    Example: metascenes annotate tokens batch-1 --withdraw bob --lake ./lake
    """
    from flows.inputs.annotation import batch_list
    from flows.view.annotating.hosting import drafts_file, key_file
    from warehouse.tables.gate import person

    if {person(name) for name in withdrawn} & {person(name) for name in renewed}:
        raise click.UsageError("--withdraw and --renew name the same person: give one of them")
    lake = existing_lake(address)
    batch_list(lake, batch_id)  # the batch is in the lake
    file = key_file(drafts or drafts_file(lake, batch_id))
    keys = file.change(withdrawn, renewed, dry_run) if withdrawn or renewed else file.read()
    new = {person(name) for name in renewed}
    rows = []
    for name, key in sorted(keys.people.items()):
        is_shown = not dry_run and (addresses or person(name) in new)
        row: dict[str, Any] = {
            "person": name,
            "roles": list(key.roles),
            "state": "withdrawn" if key.token is None else "exposed" if keys.is_exposed else "valid",
            "since": key.since or None,
        }
        rows.append(row | ({"address": keys.address(name)} if is_shown else {}))
    if keys.is_exposed:
        click.echo(file.exposure(), err=True)
    if as_json:
        print(json.dumps({"batch_id": batch_id, "people": rows}))
        return
    width = max((len(row["person"]) for row in rows), default=0)
    for row in rows:
        words = [f"{row['person']:<{width}}", row["state"], f"since {row['since'] or 'an earlier version'}"]
        words += [" and ".join(row["roles"])] if row["roles"] else []
        print("  ".join([*words, *([row["address"]] if row.get("address") else [])]))
    if not rows and not keys.is_exposed:
        print(f"no tokens yet; next: metascenes annotate serve {batch_id}")


@command.command("list")
@click.argument("batch_id", metavar="[BATCH]", required=False)
@lake_option
@json_option
def list_batches(batch_id: str | None, address: str, as_json: bool) -> None:
    """How batches stand: state, answers by annotator, what is reviewed, and what comes next.

    Example: metascenes annotate list --lake ./lake
    """
    from flows.inputs.annotation import batch_list

    rows = batch_list(existing_lake(address), batch_id)
    if as_json:
        print(json.dumps({"batches": rows}))
        return
    for row in rows:
        people = ", ".join(
            f"{name} {count['answered']}" + (f" of {count['assigned']}" if count["assigned"] else "")
            for name, count in row["by_annotator"].items()
        )
        print(f"{row['batch_id']}  {row['state'].replace('_', ' ')}, round {row['round']}  {people}")
        print(f"  next: {row['next']}")


def _own_verdict(saved: dict[str, Any] | None, reviewer: str) -> dict[str, Any]:
    """What a form says of an answer: what this reviewer saved of it, else blanks; nobody signs what another reviewer judged."""
    if saved is None or saved["reviewer"].strip().lower() != reviewer.strip().lower():
        return {"passes": None, "remark": None, "reviewed_at": ""}
    return {name: saved[name] for name in ("passes", "remark", "reviewed_at")}


def _print(result: dict[str, Any], as_json: bool, line: str) -> None:
    print(json.dumps(result) if as_json else line)


def _print_next(lake: Any, batch_id: str) -> None:
    from flows.inputs.annotation import batch_list

    for row in batch_list(lake, batch_id):
        print(f"{row['state'].replace('_', ' ')}; next: {row['next']}")
