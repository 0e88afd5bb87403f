"""The kernels that runs call, written down anew after a change of one: `python -m tests.contributing.kernels`.

Rooms of the demo are scanned here and go through all stages, agents act in them, and one is captured as frames alone; each call from
Python is written down.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

from numba.core.dispatcher import Dispatcher

from bench.stages import run_stages
from flows.inputs.evaluation import run_policy
from flows.run.configuration import configure
from schemas.families.policies import POLICIES
from tasks.kernels import compile_kernels
from tasks.kernels.ahead import KERNELS, text_of
from tasks.pipeline import SCENE_STAGES
from tasks.scanner.demo import demo_scan
from warehouse.lake import Lake

ROOMS = 3
"""Rooms that are scanned, those of `make demo`."""

Calls = dict[str, dict[str, set[tuple[str, ...]]]]


@contextlib.contextmanager
def recorded() -> Iterator[Calls]:
    """Kernels that this process calls meanwhile, by what compiles them and by name, with the types of their arguments."""
    calls: Calls = {}
    known = Dispatcher._compile_for_args

    def compiling(self: Dispatcher, *arguments: Any, **named: Any) -> Any:
        assert not named, f"{self.py_func.__name__}: kernels are called by position"
        types = tuple(text_of(self.typeof_pyval(argument)) for argument in arguments)
        calls.setdefault(_maker(self), {}).setdefault(self.py_func.__name__, set()).add(types)
        return known(self, *arguments)

    with mock.patch.object(Dispatcher, "_compile_for_args", compiling):
        yield calls


def listed(calls: Calls) -> str:
    """The text of `KERNELS`."""
    found = {maker: {name: sorted(types) for name, types in sorted(names.items())} for maker, names in sorted(calls.items())}
    return json.dumps(found, indent=1) + "\n"


def frames_alone(scan: Path, folder: Path) -> Path:
    """A folder with what a scan recorded, without the mesh and the labels that somebody made of it."""
    shutil.copytree(scan, folder / scan.name)
    for made in (*folder.glob("*/*.ply"), *folder.glob("*/*.json")):
        made.unlink()
    return folder


def _maker(kernel: Dispatcher) -> str:
    module = importlib.import_module(kernel.py_func.__module__)
    makers = [name for name, value in vars(module).items() if _makes(value) and value.__module__ == module.__name__]
    assert len(makers) == 1, f"{module.__name__}: one function compiles the kernels of a module"
    return f"{module.__name__}:{makers[0]}"


def _makes(value: Callable[..., Any]) -> bool:
    return compile_kernels.__name__ in getattr(getattr(getattr(value, "__wrapped__", None), "__code__", None), "co_names", ())


def main() -> None:
    with tempfile.TemporaryDirectory() as made, recorded() as calls:
        os.environ["METASCENES_CACHE"] = f"{made}/cache"  # what is remembered of a room is not computed
        scans = [demo_scan(Path(made) / f"scans{index}", index, 0) for index in range(ROOMS)]
        stages = [stage.name for stage in SCENE_STAGES]
        todo = [(scan.parent, stages) for scan in scans] + [(frames_alone(scans[0], Path(made) / "frames"), stages[:1])]
        lake = Lake.open(str(Path(made) / "lake"))
        for folder, names in todo:
            staged = run_stages(lake, folder, names, 1)
            assert staged.error is None, f"{folder.name}: {staged.stage}: {staged.error}"
            print(f"{folder.name}: {sum(staged.seconds.values()):.0f} s", flush=True)
        lake.commit()
        for policy in POLICIES:
            assert not run_policy(lake, policy, configure()).failed
    KERNELS.write_text(listed(calls))
    print(f"{sum(len(types) for names in calls.values() for types in names.values())} calls in {KERNELS.name}")


if __name__ == "__main__":
    main()
