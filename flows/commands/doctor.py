"""`metascenes doctor`: is this file, this dataset, this lake sound?"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from flows.commands.options import chosen_snapshot, existing_lake, json_option, lake_option, snapshot_options

budget_option = click.option(
    "--budget", type=click.FloatRange(0.25, 1000), default=1.0, show_default=True,
    help="Give the check this many times the usual time and memory.",
)  # fmt: skip


@click.group("doctor", short_help="Check a USD, MJCF, URDF or GLB file, a Habitat dataset or the lake.")
def command() -> None:
    """Check a USD, MJCF, URDF or GLB file, a Habitat dataset or the lake. Exit code 1 says that something is wrong.

    Example: metascenes doctor usd scene.usda
    """


@command.command("usd")
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@click.option("--omniverse", is_flag=True, help="Ask NVIDIA's omniverse-asset-validator too, where it is installed.")
@budget_option
@json_option
def usd(file: Path, omniverse: bool, budget: float, as_json: bool) -> None:
    """Check anybody's USD file or .usdz: UsdValidation's rules and those for scenes with physics.

    Things with a variant set `physics` are checked in each of its variants.

    Example: metascenes doctor usd scene.usda --omniverse
    """
    from flows.bounds import findings_of
    from tasks.exports.usd.omniverse import check_omniverse
    from tasks.exports.usd.rules import check_usd

    checks = (check_usd, check_omniverse) if omniverse else (check_usd,)
    findings = [found for check in checks for found in findings_of(check, file, budget, names_others=True)]
    _tell([str(f) for f in findings if f.is_error], [str(f) for f in findings if not f.is_error], as_json)


@command.command("habitat")
@click.argument("folder", type=click.Path(path_type=Path, exists=True, file_okay=False))
@budget_option
@json_option
def habitat(folder: Path, budget: float, as_json: bool) -> None:
    """Check a Habitat scene dataset against everything that habitat-sim and habitat-lab stumble over.

    Example: metascenes doctor habitat ./replicas/habitat
    """
    from flows.bounds import findings_of
    from tasks.exports.habitat.rules import check_habitat

    findings = findings_of(check_habitat, folder, budget)
    _tell([str(f) for f in findings if f.is_error], [str(f) for f in findings if not f.is_error], as_json)


@command.command("mjcf")
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@budget_option
@json_option
def mjcf(file: Path, budget: float, as_json: bool) -> None:
    """Check anybody's MuJoCo model: what MuJoCo refuses, and what it lets pass without a word.

    Example: metascenes doctor mjcf ./replicas/mjcf/scannet_scene0000_00/scene.xml
    """
    from flows.bounds import findings_of
    from tasks.exports.mjcf.rules import check_mjcf

    findings = findings_of(check_mjcf, file, budget, names_others=True)
    _tell([str(f) for f in findings if f.is_error], [str(f) for f in findings if not f.is_error], as_json)


@command.command("urdf")
@click.argument("file", type=click.Path(path_type=Path, exists=True))
@budget_option
@json_option
def urdf(file: Path, budget: float, as_json: bool) -> None:
    """Check anybody's URDF file, or a folder of them with its poses.json.

    Example: metascenes doctor urdf ./replicas/urdf/scannet_scene0000_00
    """
    from flows.bounds import findings_of
    from tasks.exports.urdf.rules import check_urdf

    findings = findings_of(check_urdf, file, budget, names_others=True)
    _tell([str(f) for f in findings if f.is_error], [str(f) for f in findings if not f.is_error], as_json)


@command.command("glb")
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@budget_option
@json_option
def glb(file: Path, budget: float, as_json: bool) -> None:
    """Check anybody's GLB of a scene.

    Example: metascenes doctor glb ./replicas/glb/scannet_scene0000_00.glb
    """
    from flows.bounds import findings_of
    from tasks.exports.glb.rules import check_glb

    findings = findings_of(check_glb, file, budget)
    _tell([str(f) for f in findings if f.is_error], [str(f) for f in findings if not f.is_error], as_json)


@command.command("lake")
@click.option("--quick", is_flag=True, help="Look at what is there; do not read and hash all contents.")
@snapshot_options
@lake_option
@json_option
def lake(quick: bool, snapshot_id: int | None, release: str | None, address: str, as_json: bool) -> None:
    """Check the lake: versions, data files, rows, keys, references, blobs, releases, and what lies about that nobody needs.

    Errors say that something is lost or wrong. Warnings say that something is left over. With --snapshot or --release,
    only that state is checked.

    Example: metascenes doctor lake --release v1 --lake ./lake
    """
    from flows.progress import Progress
    from warehouse.inspection import inspect

    opened = existing_lake(address)
    chosen = chosen_snapshot(opened, snapshot_id, release)
    with Progress("checking", sum(1 for _ in opened.storage.walk("")) if sys.stderr.isatty() else 0) as progress:
        found = inspect(opened, chosen, release=release, quick=quick, advance=progress.advance)
    looked = f"{found.snapshots} snapshots, {found.files} data files, {found.blobs} blobs"
    if found.reclaimable_bytes and not as_json:
        print(f"`metascenes lake vacuum` would free {found.reclaimable_bytes / 1e6:.1f} MB of data files between snapshots")
    _tell([str(finding) for finding in found.errors], [str(finding) for finding in found.warnings], as_json, looked)


def _tell(errors: Sequence[str], warnings: Sequence[str], as_json: bool, what: str = "") -> None:
    if as_json:
        print(json.dumps({"errors": errors, "warnings": warnings}))
    else:
        for line in warnings:
            print(f"warning: {line}")
        for line in errors:
            print(f"wrong: {line}")
        print(f"{what + ': ' if what else ''}{len(errors)} errors, {len(warnings)} warnings")
    if errors:
        raise click.exceptions.Exit(1)
