"""The flow that finds new and changed scans by itself and asks a run for them: `flows.watch.watch`."""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from prefect import flow
from prefect.states import Failed

from flows.run.fingerprints import digest
from flows.run.parameters import Address
from flows.scans.arrivals import HERE, SETTLE_SECONDS, Arrival, Look, look, remember, request_key, watch_report
from flows.server.artifacts import MAX_ROWS, artifact_key, flow_run_name, public_address, run_log
from flows.server.deployments import lake_name
from schemas.errors import InputError
from schemas.wording import counted
from warehouse.lake import Lake

BACKFILL = "replicate/backfill-{lake}"
"""The deployment that `metascenes deploy` sets up for a lake; `{lake}` is the lake's name, where nobody gave it another."""

MAX_SCANS = 500
"""Scans that one run is asked for; the next look asks for the next ones. Prefect stores their ids with the run."""


def _name() -> str:
    from prefect.runtime import flow_run

    parameters = flow_run.parameters
    return f"watch {flow_run_name(parameters['scans'], parameters['lake'], dataset=parameters.get('dataset'))}"


@flow(name="watch", flow_run_name=_name, persist_result=False)
def watch(
    scans: Address,
    lake: Address,
    settle_seconds: float = SETTLE_SECONDS,
    deployment: str | None = BACKFILL,
    format: str = "auto",
    dataset: str | None = None,
    dry_run: bool = False,
    links_into: list[str] = [],  # noqa: B006  # a default that Prefect's form shows; it is never changed
) -> Any:
    """Find new and changed scans by content, and ask one run for them. Scans that are still being copied wait.

    Looks once and ends: schedule it every few minutes. Its result is a `flows.scans.arrivals.WatchReport`. It fails when scenes of
    its own failed, and once a day for a scan that has been incomplete for more than a day.

    Args:
        scans: Folder of scans, or s3://bucket/prefix.
        lake: Address of the lake: a folder or s3://bucket/prefix.
        settle_seconds: A scan counts when nobody has written to it for so long.
        deployment: Deployment of `replicate` that is asked, `{lake}` for the lake's name; none: this flow run computes the scans.
        format: Scan format, or 'auto'.
        dataset: Name of the dataset; by default what the format says.
        dry_run: Only look.
        links_into: Folders that links out of the folder of scans may lead into.
    """
    store = Lake.open(lake)
    latest = look(scans, store, settle_seconds, format, dataset, links_into=links_into)
    due = latest.due(is_over)[:MAX_SCANS]
    has_news = latest.is_news
    run = ""
    failures: list[str] = []
    parameters = request(scans, lake, format, dataset, due, links_into)
    if due and not dry_run:
        if deployment is not None:
            run = ask(deployment, parameters, request_key(scans, store.address, due))
            latest.asked(due, run)
        else:
            run = HERE
            latest.asked(due, run)
            remember(latest, scans, store)  # before it is begun: a scan that kills its run is soon tried only once a day
            failures = _replicate(parameters)
    if not dry_run:
        remember(latest, scans, store)
    report = watch_report(latest, due if run else (), run, failures)
    run_log(str(report))
    for line in report.overdue:
        run_log(f"incomplete for more than a day: {line}", warning=True)
    if has_news:
        _leave_table(latest, scans, store.address)
    if failures:
        return Failed(message=f"{counted(len(failures), 'scene')} failed: {failures[0]}", data=report)
    if report.overdue and not dry_run:
        message = f"{counted(len(report.overdue), 'scan')} incomplete for more than a day: {report.overdue[0]}"
        return Failed(message=message, data=report)
    return report


def request(
    scans: str, lake: str, format: str, dataset: str | None, due: Sequence[Arrival], links_into: Sequence[str] = ()
) -> dict[str, Any]:
    """Parameters of `replicate` for these scans; what a deployment states by itself is left to it."""
    scans, lake = (place if "://" in place else str(Path(place).absolute()) for place in (scans, lake))
    stated: dict[str, Any] = {"scans": scans, "lake": lake, "scenes": [arrival.scan for arrival in due]}
    stated |= {"format": format} if format != "auto" else {}
    stated |= {"links_into": [str(Path(folder).absolute()) for folder in links_into if folder]} if any(links_into) else {}
    return stated | ({"dataset": dataset} if dataset else {})


def ask(deployment: str, parameters: dict[str, Any], key: str) -> str:
    """Ask for a run of a deployment, `{lake}` in whose name is that of the parameters' lake, and give its id.

    The same key asks for the same run, however often, until that has ended.

    Raises:
        InputError: the server has no such deployment.
    """
    from prefect.deployments import run_deployment
    from prefect.exceptions import ObjectNotFound

    named = lake_name(parameters["lake"])
    deployment = deployment.replace("{lake}", named)
    try:
        while True:
            run: Any = run_deployment(deployment, parameters=parameters, timeout=0, idempotency_key=key, as_subflow=False)
            if run.state is None or not run.state.is_final():
                break
            key = digest(key, str(run.id))  # that one has ended, of a state that was so before: an older lake, content that is back
    except ObjectNotFound as error:
        remedy = f"metascenes deploy sets up replicate/backfill-{named}"
        raise InputError("--deployment", deployment, "the Prefect server does not know it", remedy) from error
    run_log(f"asked {deployment} for {counted(len(parameters['scenes']), 'scan')}: run {run.name} ({run.id})")
    return str(run.id)


def is_over(run: str) -> bool:
    """Whether a run has ended, or the server has forgotten it."""
    from prefect.client.orchestration import get_client
    from prefect.exceptions import ObjectNotFound

    if run == HERE:
        return True
    try:
        with get_client(sync_client=True) as client:
            state = client.read_flow_run(uuid.UUID(run)).state
    except (ObjectNotFound, ValueError):
        return True
    return state is not None and state.is_final()


def _replicate(parameters: dict[str, Any]) -> list[str]:
    """Compute scans as a part of this run; what failed."""
    from flows.pipeline import replicate

    state: Any = replicate(**parameters, return_state=True)
    report = state.result(raise_on_failure=False)
    if isinstance(report, BaseException):
        raise report
    return [*report.failures, *(f"{scene}: {report.stopped}" for scene in report.postponed or ["the run"] if report.stopped)]


def _leave_table(latest: Look, scans: str, lake: str) -> None:
    """The table artifact: scans that want something first."""
    from prefect.artifacts import create_table_artifact

    order = ("new", "changed", "waiting", "failed before", "known")
    shown = sorted(latest.arrivals, key=lambda arrival: (not arrival.is_overdue, order.index(arrival.state), arrival.scan))
    rows = [
        {
            "scan": arrival.scan,
            "state": arrival.state,
            "why": f"{'for more than a day: ' * arrival.is_overdue}{'; '.join(filter(None, (arrival.why, arrival.left_out)))}",
            "MB": round(arrival.size_bytes / 1e6, 1),
        }
        for arrival in shown
    ]
    cut = f" The first {MAX_ROWS} of {len(rows)}." if len(rows) > MAX_ROWS else ""
    create_table_artifact(rows[:MAX_ROWS], key=artifact_key("arrivals", lake), description=f"Scans in {public_address(scans)}.{cut}")
