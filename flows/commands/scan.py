"""`metascenes scan`: a furnished GLB scene as a raw scan."""

from __future__ import annotations

import re
import shutil
import sys
from pathlib import Path

import click

from schemas.wording import counted


@click.command("scan", short_help="Scan a furnished GLB scene with the virtual scanner.")
@click.argument("scene", type=click.Path(path_type=Path, dir_okay=False, exists=True))
@click.option("--out", required=True, type=click.Path(path_type=Path, file_okay=False), help="Folder that the scan's folder is made in.")
@click.option("--name", help="Name of the scan; the file's stem by default.")
@click.option("--voxel", type=click.FloatRange(0.005, 0.1), help="Voxel of the fusion [m]; coarser for a whole house.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of walk, noise and drift.")
def command(scene: Path, out: Path, name: str | None, voxel: float | None, seed: int) -> None:
    """Scan a furnished GLB scene: walk through it, cast rays, fuse what they hit, write a ScanNet-format folder.

    Nodes are named `model|category|part`. The truth is written beside the folder, as <name>.truth.json.

    Example: metascenes scan house.glb --out scans --name scene0001_00
    """
    import dataclasses

    import numpy as np

    from schemas.budget import BUDGET
    from schemas.errors import InputError
    from schemas.files import read_file
    from tasks.containers import GLB_MAGIC
    from tasks.geometry.gltf.plain import read_features
    from tasks.geometry.meshes import load_glb
    from tasks.scanner import ScannerConfig, scan_scene

    scan = name or scene.stem
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]*", scan):
        raise InputError("--name", scan, "is no name of a scan", "use letters, digits, '_', '-' and '.'")
    if (out / scan).exists():
        raise InputError(str(out / scan), "folder", "is there already", "give another --name or remove it")
    config = ScannerConfig() if voxel is None else dataclasses.replace(ScannerConfig(), voxel_m=voxel)
    making = out / f".making-{scan}"
    shutil.rmtree(making, ignore_errors=True)
    making.mkdir(parents=True)
    try:
        plain = read_features(read_file(scene, scene.name, BUDGET.scene_bytes, magic=GLB_MAGIC), scene.name)
        for note in plain.notes:
            print(note, file=sys.stderr)
        truth = scan_scene(load_glb(plain.data, scene.name), making, scan, config, np.random.default_rng(seed))
        for made in sorted(making.iterdir()):
            made.rename(out / made.name)
    finally:
        shutil.rmtree(making)
    seen = sum(obj.object_id is not None for obj in truth.objects)
    print(f"{out / scan}: {counted(truth.frame_count, 'frame')}, {seen} of {counted(len(truth.objects), 'object')} seen")
