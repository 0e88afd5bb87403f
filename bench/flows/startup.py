"""What a run spends before the first stage: imports, the Prefect server, the first call of a warm worker."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

from bench.flows.runs import surroundings
from flows.run.pool import WorkerPool

_IMPORT = "import time; clock = time.perf_counter(); import {module}; print(time.perf_counter() - clock)"
_SERVER = """
import time
from flows.server.process import prefect_server
clock = time.perf_counter()
with prefect_server():
    print(time.perf_counter() - clock)
"""


def startup_seconds(home: Path) -> dict[str, float]:
    """Seconds of each part, by name. Each is measured in a new process; the second server finds its database made."""
    return {
        "import Prefect and the flow": _asked(_IMPORT.format(module="flows.pipeline"), home),
        "Prefect server, first start on a machine": _asked(_SERVER, home),
        "Prefect server, later": _asked(_SERVER, home),
        "warm pool, first answer of a worker": _pool_seconds(),
    }


def _pool_seconds() -> float:
    """Until a worker of a new pool has answered once."""
    clock = time.perf_counter()
    with WorkerPool(1) as pool:
        pool.call(abs, -1)
        return time.perf_counter() - clock


def _asked(code: str, home: Path) -> float:
    done = subprocess.run([sys.executable, "-c", code], env=surroundings(home), capture_output=True, text=True, check=True)
    return float(done.stdout.strip().splitlines()[-1])
