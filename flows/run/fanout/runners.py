"""Prefect's task runners, by the names that people give them."""

from __future__ import annotations

import logging
import os
from typing import Any, Literal, get_args

from schemas.errors import InputError

Runner = Literal["pool", "processes", "dask", "ray"]
RUNNERS: tuple[str, ...] = get_args(Runner)


def task_runner(name: str, workers: int, dask_address: str | None = None) -> Any:
    """A task runner that is not started yet.

    `pool`: threads of this process, which wait for one process pool. `processes`: Prefect's own. `dask`: a cluster on this
    machine, which takes orders from this process alone, or the one at `dask_address`. `ray`: Ray on this machine, or as RAY_ADDRESS says.

    Raises:
        InputError: there is no such runner, or its package is not installed.
    """
    from prefect.task_runners import ThreadPoolTaskRunner

    if dask_address is not None and name != "dask":
        raise InputError("--dask-address", "runner", f"is given with --runner {name}", "add --runner dask")
    if name == "pool":
        return ThreadPoolTaskRunner(max_workers=workers + 1)  # one more: the next scene is ready when a worker is
    if name == "processes":
        return _processes(workers)
    if name == "dask":
        return _dask(workers, dask_address)
    if name == "ray":
        return _ray(workers)
    raise InputError("--runner", "runner", f"{name!r} is not known", f"use {', '.join(RUNNERS)}")


def _processes(workers: int) -> Any:
    from prefect.task_runners import ProcessPoolTaskRunner

    class Processes(ProcessPoolTaskRunner):
        """Prefect's, which waits for the scenes under way even when the run is to end at once."""

        def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
            if kind is not None:
                for process in list((getattr(self._executor, "_processes", None) or {}).values()):
                    process.kill()
            super().__exit__(kind, error, trace)

    return Processes(max_workers=workers)


def _dask(workers: int, address: str | None) -> Any:
    try:
        from prefect_dask import DaskTaskRunner
    except ImportError as error:
        raise InputError("--runner", "dask", "needs the package prefect-dask", "pip install 'metascenes[dask]'") from error
    if address is not None:
        return DaskTaskRunner(address=address)
    import dask

    logging.getLogger("distributed").setLevel(logging.WARNING)
    # A task whose worker died comes back to the coordinator, which knows what of it is finished; Dask would do all of it again.
    dask.config.set({"distributed.scheduler.allowed-failures": 0})
    dask.config.set({"distributed.scheduler.http.routes": [], "distributed.worker.http.routes": []})  # no pages for everybody
    cluster = {
        "n_workers": workers,
        "threads_per_worker": 1,
        "host": "127.0.0.1",
        "security": True,  # certificates made for it: a scheduler does what everybody who reaches its port says
        "dashboard_address": "127.0.0.1:0",
        "silence_logs": "WARNING",
    }
    return DaskTaskRunner(cluster_kwargs=cluster)


def _ray(workers: int) -> Any:
    try:
        from prefect_ray import RayTaskRunner
    except ImportError as error:
        raise InputError("--runner", "ray", "needs the package prefect-ray", "pip install 'metascenes[ray]'") from error
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # no telemetry
    return RayTaskRunner(init_kwargs={"num_cpus": workers, "include_dashboard": False})
