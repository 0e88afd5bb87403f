"""Setting up what is scheduled on a Prefect server: the work pool, the deployments of `prefect.yaml`, global concurrency
limits, and notifications. Doing it again changes what is different and leaves one of each.
"""

from __future__ import annotations

import dataclasses
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from schemas.errors import InputError, LakeError, check_address

if TYPE_CHECKING:
    from prefect.client.orchestration import SyncPrefectClient

TAG = "metascenes"
"""All deployments and their runs bear it."""

GPU, VLM = "metascenes-gpu", "metascenes-vlm"
"""Limits of candidates (so many at once) and captions (so many a second). `prefect.yaml` names them, too."""


RUNS_AT_ONCE = 4
"""Limit of a new work pool: a nightly run that goes on, the next one, a backfill, and one for what is short."""


@dataclasses.dataclass(frozen=True)
class Schedule:
    """What `prefect.yaml` asks of its surroundings. out: folder for the report and exports, on the machine of the worker.
    nightly, watch, weekly: cron lines, in `timezone`. links_into: folders that links of scans may lead into, as in PATH."""

    scans: str
    lake: str
    out: str
    pool: str = "metascenes"
    timezone: str = "UTC"
    nightly: str = "0 1 * * *"
    watch: str = "*/5 * * * *"
    weekly: str = "0 12 * * SUN"
    links_into: str = ""

    def __post_init__(self) -> None:
        from zoneinfo import ZoneInfo

        try:
            ZoneInfo(self.timezone)
        except (OSError, ValueError) as error:  # ZoneInfoNotFoundError is a KeyError
            raise InputError(self.timezone, "--timezone", str(error), "name one as in Europe/Berlin") from error
        except KeyError as error:
            raise InputError(self.timezone, "--timezone", "is not known", "name one as in Europe/Berlin") from error
        for name in ("scans", "lake", "out", "pool"):
            if not getattr(self, name).strip() or "{{" in getattr(self, name):
                raise InputError(f"--{name}", getattr(self, name), "cannot be used", "name it in full")
            check_address(getattr(self, name), f"--{name}")

    def check_crons(self) -> None:
        """Refuse what is no cron line."""
        from prefect.client.schemas.schedules import CronSchedule

        for name in ("nightly", "watch", "weekly"):
            try:
                CronSchedule(cron=getattr(self, name), timezone=self.timezone)
            except ValueError as error:
                raise InputError(f"--{name}", getattr(self, name), "is no cron line", "as in '0 1 * * *', every night at one") from error

    def environment(self) -> dict[str, str]:
        """The variables that `prefect.yaml` reads."""
        return {f"METASCENES_{field.name.upper()}": getattr(self, field.name) for field in dataclasses.fields(self)}


FILE_VARIABLES = {f"METASCENES_{field.name.upper()}" for field in dataclasses.fields(Schedule)}
"""What `prefect.yaml` reads from the environment."""


@dataclasses.dataclass(frozen=True)
class Item:
    """One thing on the server. change: what became of it, 'created', 'changed', 'unchanged' or 'removed'. link: its page in
    the UI. detail: how it is set, where that is one word or two."""

    kind: str
    name: str
    change: str
    link: str = ""
    detail: str = ""


def deployment_file() -> Path:
    """`prefect.yaml`: of the checkout, or as it was installed.

    Raises:
        LakeError: it is missing; a part of the package was removed.
    """
    here = Path(__file__).resolve().parent
    for file in (here.parent / "prefect.yaml", here / "prefect.yaml"):
        if file.is_file() and "flows.pipeline.replicate" in file.read_text():
            return file
    raise LakeError(f"{here.parent / 'prefect.yaml'} is missing; install the package again")


def planned(schedule: Schedule) -> list[dict[str, Any]]:
    """The deployments of `prefect.yaml` for these surroundings, as plain tables."""
    import yaml

    told = schedule.environment()

    def filled(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: filled(one) for name, one in value.items()}
        if isinstance(value, list):
            return [filled(one) for one in value]
        return re.sub(r"\{\{ \$(\w+) \}\}", lambda match: told[match[1]], value) if isinstance(value, str) else value

    found: list[dict[str, Any]] = filled(yaml.safe_load(deployment_file().read_text())["deployments"])
    return found


def set_up(
    schedule: Schedule, gpu_slots: int | None = None, vlm_per_second: float | None = None, runs_at_once: int | None = None
) -> list[Item]:
    """Set up work pool, limits and deployments on the server that PREFECT_API_URL names.

    A limit that is not told stays as it is, and 0 switches it off. A new work pool has RUNS_AT_ONCE until it is told; the
    other limits are off until then.

    Raises:
        InputError: no server is named, or a cron line is none.
        LakeError: the server does not answer, or Prefect refused; with its words.
    """
    from prefect.client.orchestration import get_client

    from flows.limits import is_away
    from flows.server import without_secrets

    schedule.check_crons()
    api = _api()  # else Prefect would start a server for as long as this takes
    with get_client(sync_client=True) as client:
        try:
            client.hello()
        except Exception as error:
            if not is_away(error):
                raise
            raise LakeError(f"{without_secrets(api)}: no Prefect server answers; check PREFECT_API_URL") from error
        items = [_pool(client, schedule.pool, runs_at_once), _limit(client, GPU, gpu_slots), _limit(client, VLM, vlm_per_second, True)]
        before = _deployments(client)
        _deploy(schedule)
        after = _deployments(client)
    for name in _names(schedule, after):
        same = before.get(name, {}).get("facts") == after[name]["facts"]
        change = "created" if name not in before else "unchanged" if same else "changed"
        items.append(Item("deployment", name, change, link(f"deployments/deployment/{after[name]['id']}")))
    return items


def link(page: str) -> str:
    """A page of the server's UI."""
    from prefect.settings import get_current_settings

    return f"{get_current_settings().ui_url}/{page}"


def _names(schedule: Schedule, deployed: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """`flow/deployment` of everything in `prefect.yaml`, in its order."""
    return [
        name
        for entry in planned(schedule)
        for name, one in deployed.items()
        if name.endswith(f"/{entry['name']}") and one["facts"]["entrypoint"] == entry["entrypoint"]
    ]


def _deploy(schedule: Schedule) -> None:
    """What `prefect deploy --all` does, by itself: one truth."""
    done = subprocess.run(
        [sys.executable, "-m", "prefect", "--no-prompt", "deploy", "--all", "--prefect-file", str(deployment_file())],
        env={**os.environ, **schedule.environment(), "PREFECT_API_URL": _api()}, capture_output=True, text=True, check=False,
        stdin=subprocess.DEVNULL,
    )  # fmt: skip
    if done.returncode:
        said = [line.strip(" │╭╮╰╯─") for line in (done.stderr + done.stdout).splitlines()]
        raise LakeError(f"prefect deploy: {next((line for line in reversed(said) if line), f'exit code {done.returncode}')}")


def _api() -> str:
    """The server's address, as the environment or Prefect's profile has it."""
    from prefect.settings import get_current_settings

    named = get_current_settings().api.url
    if not named:
        raise InputError("PREFECT_API_URL", "", "names no server", "set it, or start one with `metascenes deploy --local`")
    return named


def _deployments(client: SyncPrefectClient) -> dict[str, dict[str, Any]]:
    """Deployments with our tag by `flow/name`: id, and what a deployment of them would set."""
    from prefect.client.schemas.filters import DeploymentFilter, DeploymentFilterTags

    found = client.read_deployments(deployment_filter=DeploymentFilter(tags=DeploymentFilterTags(all_=[TAG])))
    deployed = {}
    for one in found:
        flow = client.read_flow(one.flow_id)
        schedules = [(each.slug, each.schedule.model_dump_json(), each.active) for each in one.schedules]
        automations = [
            each.model_dump(mode="json", exclude={"id"})
            for each in client.read_resource_related_automations(f"prefect.deployment.{one.id}")
        ]
        deployed[f"{flow.name}/{one.name}"] = {
            "id": one.id,
            "facts": {
                "entrypoint": one.entrypoint, "parameters": one.parameters, "tags": sorted(one.tags),
                "schema": one.parameter_openapi_schema,
                "description": one.description, "pool": one.work_pool_name, "variables": one.job_variables, "schedules": schedules,
                "limit": one.global_concurrency_limit.limit if one.global_concurrency_limit else None, "automations": automations,
                "options": one.concurrency_options.model_dump() if one.concurrency_options else None,
            },
        }  # fmt: skip
    return deployed


def _pool(client: SyncPrefectClient, name: str, runs_at_once: int | None) -> Item:
    """A work pool of processes, unless there is a pool of that name already, of whatever type; 0 runs at once: no limit."""
    from prefect.client.schemas.actions import WorkPoolCreate, WorkPoolUpdate
    from prefect.exceptions import ObjectNotFound
    from prefect.workers.process import ProcessWorker

    page = link(f"work-pools/work-pool/{name}")
    try:
        present = client.read_work_pool(name).concurrency_limit
    except ObjectNotFound:
        limit = (RUNS_AT_ONCE if runs_at_once is None else runs_at_once) or None
        template = ProcessWorker.get_default_base_job_template()
        client.create_work_pool(WorkPoolCreate(name=name, type="process", base_job_template=template, concurrency_limit=limit))
        return Item("work pool", name, "created", page, _pool_text(limit))
    limit = present if runs_at_once is None else runs_at_once or None
    if limit == present:
        return Item("work pool", name, "unchanged", page, _pool_text(limit))
    client.update_work_pool(name, WorkPoolUpdate(concurrency_limit=limit))
    return Item("work pool", name, "changed", page, _pool_text(limit))


def _pool_text(limit: int | None) -> str:
    return "unlimited" if limit is None else f"{limit} at once"


def _limit(client: SyncPrefectClient, name: str, told: float | None, is_rate: bool = False) -> Item:
    """A global concurrency limit of so many slots, or of so many a second; 0 switches it off, None leaves it."""
    import math

    from prefect.client.schemas.actions import GlobalConcurrencyLimitCreate, GlobalConcurrencyLimitUpdate
    from prefect.exceptions import ObjectNotFound

    wanted: dict[str, Any] = {} if told is None else {"active": told > 0}
    if told:
        wanted |= {"limit": max(1, math.ceil(told)), "slot_decay_per_second": told if is_rate else 0.0}
    try:
        present = client.read_global_concurrency_limit_by_name(name)
    except ObjectNotFound:
        new = {"limit": 1, "active": False, "slot_decay_per_second": float(is_rate), **wanted}
        made = client.create_global_concurrency_limit(GlobalConcurrencyLimitCreate(name=name, **new))
        return Item("limit", name, "created", link(f"concurrency-limits/concurrency-limit/{made}"), _limit_text(new))
    page = link(f"concurrency-limits/concurrency-limit/{present.id}")
    now = {"limit": present.limit, "active": present.active, "slot_decay_per_second": present.slot_decay_per_second}
    then = now | wanted
    if then == now:
        return Item("limit", name, "unchanged", page, _limit_text(now))
    client.update_global_concurrency_limit(name, GlobalConcurrencyLimitUpdate(**wanted))
    return Item("limit", name, "changed", page, _limit_text(then))


def _limit_text(told: Mapping[str, Any]) -> str:
    if not told["active"]:
        return "off"
    return f"{told['slot_decay_per_second']:g} a second" if told["slot_decay_per_second"] else f"{told['limit']} at once"
