"""A process that claims scenes, for tests that let several of them meet or die. `python -m tests.warehouse.sharing.claim_load ...`.

hold LAKE LIFE MACHINE SCENE ...   claim scenes and tell of a run, say so, say on every line of input what is held and lost
work LAKE FOLDER SEED SECONDS      claim scenes at random, lock each one's file in FOLDER meanwhile, print every breach
"""

from __future__ import annotations

import fcntl
import json
import os
import random
import sys
import time
from pathlib import Path

from warehouse.lake import Lake
from warehouse.sharing import writer
from warehouse.sharing.claims import Claims
from warehouse.sharing.presence import Presence

SCENES = [f"demo/scene{number:04d}_00" for number in range(4)]


def hold(lake: Lake, life: float, machine: str, scenes: list[str]) -> None:
    """Hold scenes until the input ends. With `machine`, as a process of another machine, of which nobody here can tell."""
    if machine:
        writer._machine = lambda: machine  # type: ignore[assignment]
    lake.claims()  # makes the lake
    with Claims(lake.storage, life) as claims, Presence(lake.storage, {"scenes": len(scenes)}, life=life) as presence:
        print(json.dumps({"claimed": [claims.claim(scene) for scene in scenes], "token": presence.run.token}), flush=True)
        for _ in sys.stdin:
            print(json.dumps({"held": sorted(claims.held()), "lost": sorted(claims.lost())}), flush=True)


def work(lake: Lake, folder: Path, seed: int, seconds: float) -> None:
    """The kernel frees a file's lock when its process dies, before others can see that it is dead."""
    draw = random.Random(seed)
    until = time.monotonic() + seconds
    held = 0
    with lake.claims() as claims:
        while time.monotonic() < until:
            scene = draw.choice(SCENES)
            if not claims.claim(scene):
                continue
            descriptor = os.open(folder / scene.replace("/", "_"), os.O_RDWR | os.O_CREAT)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                held += 1
                time.sleep(draw.random() * 0.01)
            except BlockingIOError:
                print(f"breach: {scene}", flush=True)
            finally:
                os.close(descriptor)
            claims.release(scene)
    print(f"held: {held}", flush=True)


if __name__ == "__main__":
    command, address, *rest = sys.argv[1:]
    if command == "hold":
        hold(Lake.open(address), float(rest[0]), rest[1], rest[2:])
    elif command == "work":
        work(Lake.open(address), Path(rest[0]), int(rest[1]), float(rest[2]))
