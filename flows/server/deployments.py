"""Setting up what is scheduled on a Prefect server: the work pool, the deployments of `prefect.yaml`, global concurrency
limits, and notifications. Doing it again changes what is different and leaves one of each.
"""

from __future__ import annotations

import dataclasses
import json
import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flows.run.devices import GPU
from schemas.errors import InputError, LakeError, check_address

if TYPE_CHECKING:
    from prefect.client.orchestration import SyncPrefectClient

TAG = "metascenes"
"""All deployments and their runs bear it."""

VLM = "metascenes-vlm"
"""Limit of captions (so many a second). `prefect.yaml` names it, and that of the graphics card for candidates, too."""


FORMER_ENV = {"DO_NOT_TRACK": "1", "PREFECT_SERVER_ANALYTICS_ENABLED": "false"}
"""What deployments of older versions told their runs' environment, which is the worker's."""

CHOSEN = ("command", "env", "working_dir")
"""Variables of Prefect's own template of a process pool by which whoever may start a run picks what is executed on a worker."""

BASES = ("nightly", "backfill", "watch", "statistics", "release", "train", "evaluate", "drive", "compare", "export", "upkeep")
"""Deployments of a lake. The name of each ends with the lake's (`nightly-kitchens`): a server may keep several lakes. Older
versions called them so and nothing more."""

RUNS_AT_ONCE = 4
"""Limit of a new work pool: a nightly run that goes on, the next one, a backfill, and one for what is short."""


@dataclasses.dataclass(frozen=True)
class Schedule:
    """The settings that `prefect.yaml` takes from its environment. out: folder for the report and exports, on the machine of the worker.
    name: what the names of the lake's deployments end with; by default the last part of its address. nightly, watch, weekly:
    cron lines, in `timezone`. links_into: folders that links of scans may lead into, as in PATH."""

    scans: str
    lake: str
    out: str
    name: str = ""
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
        object.__setattr__(self, "name", self.name or lake_name(self.lake))
        if not re.fullmatch(r"[A-Za-z0-9][\w.-]*", self.name):
            raise InputError("--name", self.name, "is no name of deployments", "letters, digits, dots and dashes, as in kitchens")
        for name in ("scans", "lake", "out", "pool"):
            if not getattr(self, name).strip() or "{{" in getattr(self, name):
                raise InputError(f"--{name}", getattr(self, name), "cannot be used", "name it in full")
            check_address(getattr(self, name), f"--{name}")

    def check_crons(self, apart: bool = False) -> None:
        """Refuse what is no cron line. Prefect says what is one, where it is not to be imported yet in a process of its own (`apart`):
        it reads the environment once, when it is imported.

        Raises:
            InputError: names the option.
        """
        crons = {name: getattr(self, name) for name in ("nightly", "watch", "weekly")}
        refused = _refused_apart(crons) if apart else refused_cron(crons)
        if refused is not None:
            raise InputError(f"--{refused}", crons[refused], "is no cron line", "as in '0 1 * * *', every night at one")

    def environment(self) -> dict[str, str]:
        """The variables that `prefect.yaml` reads."""
        return {f"METASCENES_{field.name.upper()}": getattr(self, field.name) for field in dataclasses.fields(self)}


def refused_cron(crons: Mapping[str, str]) -> str | None:
    """The name of the first line that is none of cron's; None where all are."""
    from prefect.client.schemas.schedules import CronSchedule

    for name, line in crons.items():
        try:
            CronSchedule(cron=line)
        except ValueError:
            return name
    return None


def _refused_apart(crons: Mapping[str, str]) -> str | None:
    """The same, asked in a process of its own."""
    from flows.server.services import NO_TELEMETRY

    code = "import json, sys; from flows.server.deployments import refused_cron; print(refused_cron(json.load(sys.stdin)) or '')"
    environment = {**NO_TELEMETRY, **os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    asked = subprocess.run([sys.executable, "-c", code], input=json.dumps(crons), env=environment, capture_output=True, text=True)
    printed = asked.stdout.split()  # a library may say something before
    return (
        printed[-1] if asked.returncode == 0 and printed and printed[-1] in crons else None
    )  # what else went wrong the server's set-up will say


def lake_name(address: str) -> str:
    """The name that a lake has on a server, where nobody gave it one: the last part of its address, in small letters."""
    from flows.server.artifacts import short_name
    from tasks.words import plain_word

    name = short_name(address)
    return re.sub(r"[^a-z0-9._]+", "-", (name if name.isascii() else plain_word(name)).lower()).strip("-._") or "lake"


FILE_VARIABLES = {f"METASCENES_{field.name.upper()}" for field in dataclasses.fields(Schedule)}
"""What `prefect.yaml` reads from the environment."""


@dataclasses.dataclass(frozen=True)
class Item:
    """One item on the server. change: what became of it, 'created', 'changed', 'unchanged' or 'removed'. link: its page in
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
    here = Path(__file__).resolve().parents[1]
    for file in (here.parent / "prefect.yaml", here / "prefect.yaml"):
        if file.is_file() and "flows.pipeline.replicate" in file.read_text():
            return file
    raise LakeError(f"{here.parent / 'prefect.yaml'} is missing; install the package again")


def planned(schedule: Schedule) -> list[dict[str, Any]]:
    """The deployments of `prefect.yaml` for these surroundings, as plain tables."""
    import yaml

    environment = schedule.environment()

    def filled(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: filled(item) for name, item in value.items()}
        if isinstance(value, list):
            return [filled(item) for item in value]
        return re.sub(r"\{\{ \$(\w+) \}\}", lambda match: environment[match[1]], value) if isinstance(value, str) else value

    deployments: list[dict[str, Any]] = filled(yaml.safe_load(deployment_file().read_text())["deployments"])
    return deployments


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

    from flows.server.process import check_server

    schedule.check_crons()
    check_server(_api())  # without an address Prefect would start a server for as long as this takes
    with get_client(sync_client=True) as client:
        before = _deployments(client)
        _check_lake(schedule, before)
        items = [_pool(client, schedule.pool, runs_at_once), _limit(client, GPU, gpu_slots), _limit(client, VLM, vlm_per_second, True)]
        _deploy(schedule)
        after = _deployments(client)
        former = _replace_former(client, schedule, before, after)
    for name in _names(schedule, after):
        same = before.get(name, {}).get("facts") == after[name]["facts"]
        change = "created" if name not in before else "unchanged" if same else "changed"
        items.append(Item("deployment", name, change, link(f"deployments/deployment/{after[name]['id']}")))
    return items + former


def link(page: str) -> str:
    """A page of the server's UI."""
    from prefect.settings import get_current_settings

    return f"{get_current_settings().ui_url}/{page}"


def _names(schedule: Schedule, deployed: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """`flow/deployment` of everything in `prefect.yaml`, in its order."""
    return [
        name
        for entry in planned(schedule)
        for name, facts in deployed.items()
        if name.endswith(f"/{entry['name']}") and facts["facts"]["entrypoint"] == entry["entrypoint"]
    ]


def _check_lake(schedule: Schedule, deployed: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse a name under which the server keeps another lake: its runs would go on into this one."""
    for name, facts in deployed.items():
        other = _lake_of(facts)
        if _is_named(schedule, name) and other and other != schedule.lake.rstrip("/"):
            raise InputError("--name", schedule.name, f"is the name of {other} on this server", f"give {schedule.lake} another")


def _is_named(schedule: Schedule, name: str) -> bool:
    """Whether a deployment, `flow/name`, bears the name of this lake; `nightly-my-lake` does not bear that of `lake`."""
    return name.partition("/")[2] in {f"{base}-{schedule.name}" for base in BASES}


def _lake_of(deployment: Mapping[str, Any]) -> str:
    return str(deployment["facts"]["parameters"].get("lake", "")).rstrip("/")


def _replace_former(
    client: SyncPrefectClient, schedule: Schedule, before: Mapping[str, Any], after: Mapping[str, Mapping[str, Any]]
) -> list[Item]:
    """Remove the deployments of this lake that bear no lake's name: both would run it. What somebody had paused stays paused."""
    gone = []
    for name, facts in after.items():
        base = name.partition("/")[2]
        successor = f"{name}-{schedule.name}"
        is_former = base in BASES and successor in after and facts["facts"]["entrypoint"] == after[successor]["facts"]["entrypoint"]
        if not is_former or _lake_of(facts) != schedule.lake.rstrip("/"):
            continue
        resting = {slug for slug, _, active in facts["facts"]["schedules"] if not active}
        if resting and successor not in before:
            for each in client.read_deployment(after[successor]["id"]).schedules:
                if each.slug in resting:
                    client.update_deployment_schedule(after[successor]["id"], each.id, active=False)
        for automation in client.read_resource_related_automations(f"prefect.deployment.{facts['id']}"):
            if automation.name.startswith(f"{TAG}-"):
                client.delete_automation(automation.id)
        client.delete_deployment(facts["id"])
        gone.append(Item("deployment", name, "removed", "", f"now {successor}"))
    return gone


def foreign(schedule: Schedule) -> dict[str, list[str]]:
    """Other deployments of ours on the server, `flow/name`, by the address of their lake."""
    from prefect.client.orchestration import get_client

    foreign: dict[str, list[str]] = {}
    with get_client(sync_client=True) as client:
        for name, facts in _deployments(client).items():
            if not _is_named(schedule, name) and _lake_of(facts):
                foreign.setdefault(_lake_of(facts), []).append(name)
    return foreign


def _deploy(schedule: Schedule) -> None:
    """What `prefect deploy --all` does, by itself: one truth."""
    done = subprocess.run(
        [sys.executable, "-m", "prefect", "--no-prompt", "deploy", "--all", "--prefect-file", str(deployment_file())],
        env={**os.environ, **schedule.environment(), "PREFECT_API_URL": _api()}, capture_output=True, text=True, check=False,
        stdin=subprocess.DEVNULL,
    )  # fmt: skip
    if done.returncode:
        lines = [line.strip(" │╭╮╰╯─") for line in (done.stderr + done.stdout).splitlines()]
        raise LakeError(f"prefect deploy: {next((line for line in reversed(lines) if line), f'exit code {done.returncode}')}")


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

    answers = client.read_deployments(deployment_filter=DeploymentFilter(tags=DeploymentFilterTags(all_=[TAG])))
    deployed = {}
    for answer in answers:
        flow = client.read_flow(answer.flow_id)
        schedules = [(each.slug, each.schedule.model_dump_json(), each.active) for each in answer.schedules]
        automations = [
            each.model_dump(mode="json", exclude={"id"})
            for each in client.read_resource_related_automations(f"prefect.deployment.{answer.id}")
        ]
        deployed[f"{flow.name}/{answer.name}"] = {
            "id": answer.id,
            "facts": {
                "entrypoint": answer.entrypoint, "parameters": answer.parameters, "tags": sorted(answer.tags),
                "schema": answer.parameter_openapi_schema,
                "description": answer.description, "pool": answer.work_pool_name, "variables": answer.job_variables, "schedules": schedules,
                "limit": answer.global_concurrency_limit.limit if answer.global_concurrency_limit else None, "automations": automations,
                "options": answer.concurrency_options.model_dump() if answer.concurrency_options else None,
            },
        }  # fmt: skip
    return deployed


def _pool(client: SyncPrefectClient, name: str, runs_at_once: int | None) -> Item:
    """A work pool of processes that lets nobody pick what is executed, unless there is a pool of that name already.

    One of processes that is there is closed, too; one of another type stays as it is. 0 runs at once: no limit.
    """
    from prefect.client.schemas.actions import WorkPoolCreate, WorkPoolUpdate
    from prefect.exceptions import ObjectNotFound
    from prefect.workers.process import ProcessWorker

    page = link(f"work-pools/work-pool/{name}")
    try:
        present = client.read_work_pool(name)
    except ObjectNotFound:
        limit = (RUNS_AT_ONCE if runs_at_once is None else runs_at_once) or None
        template = closed(ProcessWorker.get_default_base_job_template())
        client.create_work_pool(WorkPoolCreate(name=name, type="process", base_job_template=template, concurrency_limit=limit))
        return Item("work pool", name, "created", page, _pool_text(limit))
    limit = present.concurrency_limit if runs_at_once is None else runs_at_once or None
    template = closed(present.base_job_template) if present.type == "process" else present.base_job_template
    if limit == present.concurrency_limit and template == present.base_job_template:
        return Item("work pool", name, "unchanged", page, _pool_text(limit))
    client.update_work_pool(name, WorkPoolUpdate(concurrency_limit=limit, base_job_template=template))
    return Item("work pool", name, "changed", page, _pool_text(limit))


def closed(template: Mapping[str, Any]) -> dict[str, Any]:
    """A base job template of a process pool in which whoever starts a run cannot say what is executed: command and folder are
    the template's, the environment is the worker's. The server refuses variables that are not in it."""
    configuration, offered = dict(template.get("job_configuration", {})), dict(template.get("variables", {}))
    properties = dict(offered.get("properties", {}))
    for name in CHOSEN:
        default = properties.pop(name, {}).get("default")
        if isinstance(configuration.get(name), str) and "{{" in configuration[name]:
            configuration[name] = default
    configuration.pop("env", None)  # Prefect's worker adds what a run says to whatever stands here
    former = {name: {"const": value} for name, value in FORMER_ENV.items()}
    properties["env"] = {"type": "object", "properties": former, "additionalProperties": False, "description": "Without effect."}
    offered |= {"properties": properties, "additionalProperties": False}
    if "required" in offered:
        offered["required"] = [name for name in offered["required"] if name in properties]
    return {**template, "job_configuration": configuration, "variables": offered}


def _pool_text(limit: int | None) -> str:
    return "unlimited" if limit is None else f"{limit} at once"


def _limit(client: SyncPrefectClient, name: str, value: float | None, is_rate: bool = False) -> Item:
    """A global concurrency limit of so many slots, or of so many a second; 0 switches it off, None leaves it."""
    import math

    from prefect.client.schemas.actions import GlobalConcurrencyLimitCreate, GlobalConcurrencyLimitUpdate
    from prefect.exceptions import ObjectNotFound

    wanted: dict[str, Any] = {} if value is None else {"active": value > 0}
    if value:
        wanted |= {"limit": max(1, math.ceil(value)), "slot_decay_per_second": value if is_rate else 0.0}
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


def _limit_text(limit: Mapping[str, Any]) -> str:
    if not limit["active"]:
        return "off"
    return f"{limit['slot_decay_per_second']:g} a second" if limit["slot_decay_per_second"] else f"{limit['limit']} at once"
