"""`metascenes deploy`: schedules on a Prefect server."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import shlex
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from flows.commands.options import json_option, lake_option, links_option

if TYPE_CHECKING:
    from flows.server.deployments import Item, Schedule

NOTIFY = "METASCENES_NOTIFY_URL"


@click.command("deploy", short_help="Schedule runs on a Prefect server, or start one with a worker.")
@click.option("--scans", envvar="METASCENES_SCANS", required=True, metavar="ADDRESS", help="Folder of scans, or s3://bucket/prefix.")
@links_option
@lake_option
@click.option("--name", envvar="METASCENES_NAME", metavar="NAME", help="The lake's name on the server; by default its folder's.")
@click.option("--out", envvar="METASCENES_OUT", metavar="FOLDER", help="Folder for report and exports; by default ./metascenes.")
@click.option("--timezone", envvar="METASCENES_TIMEZONE", default="UTC", show_default=True, help="Time zone, as in Europe/Berlin.")
@click.option("--nightly", envvar="METASCENES_NIGHTLY", default="0 1 * * *", show_default=True, metavar="CRON", help="Nightly run.")
@click.option("--watch", envvar="METASCENES_WATCH", default="*/5 * * * *", show_default=True, metavar="CRON", help="Look for new scans.")
@click.option("--weekly", envvar="METASCENES_WEEKLY", default="0 12 * * SUN", show_default=True, metavar="CRON", help="Weekly upkeep.")
@click.option(
    "--pool", envvar="METASCENES_POOL", default="metascenes", show_default=True, metavar="NAME", help="Work pool; made if missing."
)
@click.option("--gpu-slots", type=click.IntRange(0), metavar="N", help="Scenes that make candidates at once; 0: no limit.")
@click.option("--vlm-per-second", type=click.FloatRange(0), metavar="N", help="Scenes that begin captions each second; 0: no limit.")
@click.option("--runs-at-once", type=click.IntRange(0), metavar="N", help="Runs in the work pool at once; 0: no limit; a new pool has 4.")
@click.option("--notify-env", metavar="NAME", help=f"Environment variable with the webhook that failures are sent to; {NOTIFY} if set.")
@click.option("--no-notify", is_flag=True, help="Remove the notification of failures.")
@click.option("--local", is_flag=True, help="Start a server and a worker here, until Ctrl-C.")
@click.option("--host", default="127.0.0.1", show_default=True, help="With --local: address that the server listens on.")
@click.option("--port", type=click.IntRange(1, 65535), default=4200, show_default=True, help="With --local: its port.")
@click.option("--dry-run", is_flag=True, help="Say what would be set up; change nothing, start nothing.")
@json_option
def command(
    scans: str, links_into: tuple[str, ...], address: str, name: str | None, out: str | None, timezone: str, nightly: str, watch: str,
    weekly: str, pool: str, gpu_slots: int | None, vlm_per_second: float | None, runs_at_once: int | None, notify_env: str | None,
    no_notify: bool, local: bool, host: str, port: int, dry_run: bool, as_json: bool,
) -> None:  # fmt: skip
    """Set up a nightly run, backfill, watch, statistics, release, export and upkeep on the server that PREFECT_API_URL names.

    Doing it again changes what is different. With --local, a server and a worker are started for as long as the command
    runs, and end with it. The server listens on this machine alone, unless --host names another address, and wants a token,
    which lies in a file that only you read.

    A server may keep several lakes: the names of a lake's deployments end with its own.

    Failures are sent to a webhook (Slack's, or anything that takes a POST). Its address is a secret, so that it is read from
    an environment variable, and kept in a block of the server.

    Example: metascenes deploy --scans /data/scans --lake /data/lake --timezone Europe/Berlin --nightly "30 1 * * *"
    """
    from flows.server.deployments import Schedule

    if no_notify and notify_env:
        raise click.UsageError("--no-notify and --notify-env contradict each other")
    schedule = Schedule(
        _whole(scans),
        _whole(address),
        _whole(out or "metascenes"),
        name=name or "",
        pool=pool,
        timezone=timezone,
        nightly=nightly,
        watch=watch,
        weekly=weekly,
        links_into=os.pathsep.join(_whole(folder) for folder in links_into),
    )
    notify_env = notify_env or (NOTIFY if os.environ.get(NOTIFY) and not no_notify else None)
    if dry_run:
        _tell_plan(schedule, notify_env, as_json)
        return
    limits = {"gpu_slots": gpu_slots, "vlm_per_second": vlm_per_second, "runs_at_once": runs_at_once}
    if not local:
        items, also = _set_up(schedule, limits, notify_env, no_notify)
        _tell(items, as_json)
        _tell_others(also, schedule)
        return
    from flows.server.access import CLIENT_TOKEN, SERVER_TOKEN, kept_token, token_file
    from flows.server.services import first_to_end, server, worker

    schedule.check_crons(apart=True)  # before a server starts, whose address Prefect is to find in the environment
    print("starting a Prefect server", file=sys.stderr)
    server_token = os.environ.get(SERVER_TOKEN)
    token = server_token or kept_token(port)
    with server(token, host, port) as (api, served):
        os.environ |= {"PREFECT_API_URL": api, CLIENT_TOKEN: token}
        items, also = _set_up(schedule, limits, notify_env, no_notify)
        with worker(pool, api) as working:
            _tell(items, as_json)
            _tell_others(also, schedule)
            shown = f'"${SERVER_TOKEN}"' if server_token else f'"$(cat {shlex.quote(str(token_file(port)))})"'
            trigger = f"prefect deployment run replicate/nightly-{schedule.name} --param settle_seconds=0"
            print(f"UI       {api.removesuffix('/api')}, which asks for the token: echo {shown}", file=sys.stderr)
            print(f"run now  PREFECT_API_URL={api} {CLIENT_TOKEN}={shown} {trigger}", file=sys.stderr)
            print("end      Ctrl-C", file=sys.stderr, flush=True)
            ended = first_to_end({"Prefect server": served, "worker": working})
            print(f"metascenes: the {ended} ended; give the command again", file=sys.stderr, flush=True)
    raise click.exceptions.Exit(1)


def _tell_others(also: Mapping[str, list[str]], schedule: Schedule) -> None:
    """Other lakes that the server keeps, so that nobody wonders who computes."""
    for lake, names in sorted(also.items()):
        of = "this lake, too" if lake == schedule.lake.rstrip("/") else lake
        print(f"also     {', '.join(sorted(names))}: {of}; `prefect deployment delete` removes one", file=sys.stderr)


def _whole(address: str) -> str:
    """An address that means the same to a worker, which runs in another folder."""
    return address if "://" in address else str(Path(address).resolve())


def _set_up(
    schedule: Schedule, limits: Mapping[str, Any], notify_env: str | None, no_notify: bool
) -> tuple[list[Item], dict[str, list[str]]]:
    """Set all of it up; what became of it, and the other lakes that are there."""
    from flows.server.services import NO_TELEMETRY

    for name, value in NO_TELEMETRY.items():
        os.environ.setdefault(name, value)
    loud = os.environ.get("PREFECT_LOGGING_LEVEL")
    os.environ.setdefault("PREFECT_LOGGING_LEVEL", "ERROR")  # read when Prefect is imported; a worker keeps its own
    import prefect.main  # noqa: F401

    from flows.server.deployments import foreign, set_up
    from flows.server.notifications import find_lost_runs, notify, silence
    from flows.server.process import is_of_server, why_not
    from schemas.errors import LakeError

    if loud is None:
        del os.environ["PREFECT_LOGGING_LEVEL"]
    with _token_shown() as api:
        try:
            items = [*set_up(schedule, **limits), find_lost_runs()]
            if notify_env:
                items += notify(notify_env)
            if no_notify:
                items += silence()
            return items, foreign(schedule)
        except Exception as error:
            if is_of_server(error) and not isinstance(error, LakeError):
                raise LakeError(why_not(api, error)) from error
            raise


@contextlib.contextmanager
def _token_shown() -> Iterator[str]:
    """Prefect's settings with the token that is kept for its server, whoever names that; gives the server's address.

    The environment may name it, and so may Prefect's profile, which is known only once Prefect has read its settings.
    """
    from prefect.settings import PREFECT_API_AUTH_STRING, get_current_settings, temporary_settings

    from flows.server.access import CLIENT_TOKEN, take_token

    api = get_current_settings().api
    if api.url and not api.auth_string:
        take_token(api.url)
    token = os.environ.get(CLIENT_TOKEN)
    with temporary_settings({PREFECT_API_AUTH_STRING: token} if token else {}):
        yield api.url or "PREFECT_API_URL"


def _tell(items: list[Item], as_json: bool) -> None:
    if as_json:
        print(json.dumps({"items": [dataclasses.asdict(item) for item in items]}), flush=True)
        return
    for item in items:
        print(f"{item.change:<9}  {item.kind:<10}  {f'{item.name} {item.detail}':<24}  {item.link}".rstrip(), flush=True)


def _tell_plan(schedule: Schedule, notify_env: str | None, as_json: bool) -> None:
    from flows.server.deployments import planned

    schedule.check_crons()
    entries = planned(schedule)
    if as_json:
        print(json.dumps({"pool": schedule.pool, "notify_env": notify_env, "deployments": entries}))
        return
    for entry in entries:
        crons = ", ".join(f"{each['cron']} {each['timezone']}" for each in entry.get("schedules", ()))
        when = crons or ("after the nightly run" if entry.get("triggers") else "by hand")
        print(f"would set up  {entry['name']:<{10 + len(schedule.name)}}  {when:<28}  {entry['entrypoint']}")
    print(
        f"in the work pool {schedule.pool}; {f'failures go to the webhook in {notify_env}' if notify_env else 'nobody is told of failures'}"
    )
