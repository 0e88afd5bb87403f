"""Machine code is that of the code as it is now."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from tasks.kernels import compile_kernels
from tests.conftest import REPOSITORY

CALLEE = """
def plus(x):
    return x + {what}

class Toy:
    pass
"""
CALLER = """
from tasks import callee
from tasks.kernels import compile_kernels

def twice(x):
    return plus(x) + plus(x)

def run():
    known = compile_kernels(callee.plus)
    return compile_kernels(twice, known=known)["twice"](10)
"""


@pytest.mark.whole
def test_a_function_that_calls_a_changed_one_of_another_module_is_compiled_anew(tmp_path: Path) -> None:
    room = tmp_path / "tasks"
    room.mkdir()
    (room / "__init__.py").touch()
    shutil.copytree(REPOSITORY / "tasks" / "kernels", room / "kernels", ignore=shutil.ignore_patterns("__pycache__"))
    (room / "caller.py").write_text(CALLER)

    def twice(what: int) -> tuple[int, set[str]]:
        (room / "callee.py").write_text(CALLEE.format(what=what) + "# for compile_kernels\n")
        code = "from tasks.caller import run; print(run())"
        around = {name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "PYTHONPATH")}
        command = [sys.executable, "-B", "-c", code]  # bytecode of a file that changed within a second would count as that of now
        done = subprocess.run(command, cwd=tmp_path, env=around, capture_output=True, text=True, check=True)
        return int(done.stdout), {path.name for path in (room / "__pycache__").glob("kernels-*")}

    first, kept = twice(1)
    assert (first, len(kept)) == (22, 1)
    (index,) = room.rglob("*twice*.nbi")
    before = index.stat().st_mtime_ns
    assert twice(1) == (22, kept)
    assert index.stat().st_mtime_ns == before, "what is unchanged is not compiled again"
    changed, now = twice(5)
    assert changed == 30
    assert len(now) == 1
    assert now != kept, "machine code of former states goes"


def test_functions_are_compiled_once_whoever_names_them_again(tmp_path: Path) -> None:
    """Threads that ask at once name functions before, while and after another has replaced them."""
    file = tmp_path / "toy.py"
    file.write_text("def plus(x):\n    return x + 1\n\ndef twice(x):\n    return plus(x) + plus(x)\n")
    spec = importlib.util.spec_from_file_location("toy", file)
    assert spec is not None
    assert spec.loader is not None
    toy = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(toy)
    plain = (toy.plus, toy.twice)
    with ThreadPoolExecutor(4) as pool:
        made = list(pool.map(lambda _: compile_kernels(*plain), range(8)))
    made += [compile_kernels(toy.plus, toy.twice), compile_kernels(plain[0], toy.twice)]
    assert all(kernels["twice"] is toy.twice and kernels["plus"] is toy.plus for kernels in made)
    assert toy.twice(10) == 22


SHAPES = """
import sys
import numpy as np
from toy import total
from tasks.kernels import compile_kernels

kernel = compile_kernels(total)["total"]
for dimensions in map(int, sys.argv[1:]):
    assert kernel(np.full((2,) * dimensions, 3)) == 3 * 2**dimensions + dimensions, dimensions
print(sum(kernel.stats.cache_misses.values()))
"""


@pytest.mark.slow
@pytest.mark.whole
def test_processes_that_compile_one_function_at_once_keep_each_others_code(tmp_path: Path) -> None:
    """Each for arrays of other dimensions, all saved in one folder; who comes after them compiles nothing and gets the right code."""
    (tmp_path / "toy.py").write_text("def total(values):\n    return values.sum() + values.ndim\n")
    around = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "code"), "PYTHONPATH": f"{REPOSITORY}:{tmp_path}"}
    dimensions = [str(n) for n in range(1, 9)]

    def begun(*asked: str) -> subprocess.Popen[str]:
        return subprocess.Popen([sys.executable, "-c", SHAPES, *asked], env=around, stdout=subprocess.PIPE, text=True)

    at_once = [begun(*dimensions[i:], *dimensions[:i]) for i in range(0, 8, 2)]
    assert [process.communicate()[0].strip().isdigit() for process in at_once] == [True] * 4
    assert [process.returncode for process in at_once] == [0] * 4
    after = begun(*dimensions)
    assert after.communicate()[0].strip() == "0"
    assert after.returncode == 0
