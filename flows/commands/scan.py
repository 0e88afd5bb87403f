"""`metascenes scan`: a furnished GLB scene as a raw scan."""

from __future__ import annotations

from pathlib import Path

import click


@click.command("scan", short_help="Scan a furnished GLB scene with the virtual scanner.")
@click.argument("scene", type=click.Path(path_type=Path, dir_okay=False, exists=True))
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder that the scan's folder is made in.")
@click.option("--name", help="Name of the scan; the file's stem by default.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of walk, noise and drift.")
def command(scene: Path, out: Path, name: str | None, seed: int) -> None:
    """Scan a furnished GLB scene: walk through it, cast rays, fuse what they hit, write a ScanNet-format folder.

    Nodes are named `model|category|part`. The truth is written beside the folder, as <name>.truth.json.

    Example: metascenes scan house.glb --out scans --name scene0001_00
    """
    import numpy as np

    from schemas.errors import InputError
    from tasks.meshes import load_glb
    from tasks.scanner import ScannerConfig, scan_scene

    scan = name or scene.stem
    if (out / scan).exists():
        raise InputError(str(out / scan), "folder", "is there already", "give another --name or remove it")
    parts = load_glb(scene.read_bytes(), scene.name)
    making = out / f".making-{scan}"
    making.mkdir(parents=True)
    scan_scene(parts, making, scan, ScannerConfig(), np.random.default_rng(seed))
    for made in sorted(making.iterdir()):
        made.rename(out / made.name)
    making.rmdir()
    print(out / scan)
