"""What a person sees of a run in Prefect's UI: names, progress, a table of scenes, a summary, links, assets and log lines.

The lake is the truth and this is a view of it: a server that is away costs a line in the log, never a scene.
"""

from __future__ import annotations

import contextlib
import contextvars
import hashlib
import logging
import queue
import re
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from flows.progress import current
from flows.run import outcome
from schemas.errors import check_address
from schemas.text import one_line

if TYPE_CHECKING:
    from flows.run.plan import Plan
    from flows.run.report import RunReport
    from warehouse.lake import Lake

UPDATE_SECONDS = 2.0
"""Between two updates of a progress artifact: a person sees it move, a server is asked nothing worth speaking of."""

PATIENCE_SECONDS = 30.0
"""How long the end of a run waits for a server that does not answer: it may be restarting."""

MAX_ROWS = 1000
"""Scenes in the table artifact. Its page draws every row; all scenes are in the lake."""


def public_address(address: str) -> str:
    """An address as it may be shown: an absolute folder, or a URL as it is.

    Raises:
        InputError: the URL carries credentials.
    """
    check_address(address)
    return address if "://" in address else str(Path(address).expanduser().absolute())


def link_of(address: str) -> str:
    """An address as a link: `file://` for a folder or file, an s3:// address as it is."""
    address = public_address(address)
    return address if "://" in address else Path(address).as_uri()


def short_name(address: str) -> str:
    """The last part of an address: `scannet` for `/data/scannet/` and for `s3://bucket/scannet`."""
    return re.split(r"[/\\]", public_address(address).rstrip("/\\"))[-1] or address


def artifact_key(kind: str, lake: str) -> str:
    """The key of a kind of artifact about a lake. Every run on that lake uses it again, so that the UI shows its history."""
    shown = public_address(lake)
    name = re.sub(r"[^a-z0-9]+", "-", f"run-{kind}-{short_name(shown)}".lower()).strip("-")
    return f"{name}-{hashlib.sha256(shown.rstrip('/').encode()).hexdigest()[:6]}"


def flow_run_name(scans: str, lake: str, scenes: int | None = None, dataset: str | None = None) -> str:
    """A name for a run: `scannet -> lake`, and how many scenes it has to do once that is known."""
    name = f"{dataset or short_name(scans)} -> {short_name(lake)}"
    return name if scenes is None else f"{name}, {scenes} scene{'' if scenes == 1 else 's'}"


def task_run_name(scenes: str | Sequence[str], stage: str = "") -> str:
    """A name for a task: `scannet/scene0001_00 optimization`; of a batch its first scene and how many more."""
    names = [scenes] if isinstance(scenes, str) else list(scenes)
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f"{names[0] if names else 'nothing'}{more} {stage}".strip()


def run_log(text: str, warning: bool = False) -> None:
    """A line in the log of the running task or flow, as Prefect's server keeps it; nothing outside of one.

    It is not printed: the command line says its lines itself, and whoever reads them there need not read them twice.
    """
    from prefect.exceptions import MissingContextError
    from prefect.logging import get_run_logger

    with contextlib.suppress(MissingContextError):
        logger: Any = get_run_logger()
        base: logging.Logger = getattr(logger, "logger", logger)
        level = logging.WARNING if warning else logging.INFO
        if base.isEnabledFor(level):
            lines = logging.Logger(base.name, level)  # its own one, without parents: those print
            lines.handlers = base.handlers
            lines.log(level, text, extra=getattr(logger, "extra", None))


def committed(lake: str, snapshot_id: int, scans: str, scenes: int | None = None) -> None:
    """Tell Prefect that a lake was materialized from a folder of scans: once per commit, inside a flow run.

    The server keeps it as the event `prefect.asset.materialization.succeeded` with the lake as its resource and the scans as
    a related one.
    """
    from prefect.assets import Asset, AssetProperties, materialize

    source = Asset(key=_asset_key(scans), properties=AssetProperties(name=short_name(scans), url=link_of(scans)))
    asset = Asset(key=_asset_key(lake), properties=AssetProperties(name=short_name(lake), url=link_of(lake)))

    @materialize(asset, by="metascenes", asset_deps=[source], name="commit", task_run_name=f"snapshot {snapshot_id}", persist_result=False)
    def commit() -> None:
        asset.add_metadata({"snapshot_id": snapshot_id} | ({} if scenes is None else {"scenes": scenes}))

    with _away_is_no_failure("the asset"):
        commit()


def _asset_key(address: str) -> str:
    """An address as a key of an asset, which may not hold every character that a path may."""
    shown = link_of(address).replace("%20", "-").rstrip("/")
    key = re.sub(r"[\s#?&%\"'<>\[\]{}|\\^`\x00]", "-", shown)
    if key == shown and len(key) <= 512:
        return key
    return f"{key[:490]}-{hashlib.sha256(shown.encode()).hexdigest()[:8]}"


@contextlib.contextmanager
def _away_is_no_failure(what: str) -> Iterator[None]:
    """What goes wrong between us and the server is a line in the log."""
    import httpx
    from prefect.exceptions import PrefectException

    try:
        yield
    except (httpx.HTTPError, PrefectException, OSError) as error:
        _log(f"{what} is not in Prefect: {_line(error)}; the lake is not affected")


class Ticker:
    """One progress artifact of a flow run, kept up to date by one thread: a run never waits for Prefect's server.

    Must be started inside the flow run. Whatever happens to the server, nothing here fails: what could not be told is told when
    it is back, and what never could be is a line in the log.
    """

    def __init__(self, key: str, intro: str, name: str | None = None) -> None:
        """`intro` begins its description; `name` becomes the name of the flow run."""
        self._key, self._intro, self._name = key, intro, name
        self._progress, self._text = 0.0, ""
        self._artifact: Any = None
        self._is_away = self._is_told = False
        self._lock, self._news, self._over = threading.Lock(), threading.Event(), threading.Event()
        self._final: list[Callable[[], object]] = []
        self._give_up = 0.0
        self._defect: Exception | None = None
        self._news.set()
        context = contextvars.copy_context()  # Prefect finds the run, and its client, in there
        self._thread: threading.Thread | None = threading.Thread(target=lambda: context.run(self._talk), name="ticker", daemon=True)
        self._thread.start()

    def advance(self, done: int, total: int, text: str) -> None:
        """So much is over; `text` says what was last. Returns at once."""
        with self._lock:
            self._progress = 100.0 * min(done, total) / total if total else 100.0
            self._text = f"{done} of {total}; last {text}" if text else f"{done} of {total}"
        self._news.set()

    def finish(self, text: str, steps: Sequence[Callable[[], object]] = (), patience: float | None = None) -> None:
        """It is all over, as `text` says; `steps` leave further artifacts. Waits `patience` seconds at most for the server."""
        with self._lock:
            self._progress, self._text = 100.0, text
        self._final = list(steps)
        self.close(PATIENCE_SECONDS if patience is None else patience)

    def close(self, patience: float = UPDATE_SECONDS) -> None:
        """Send what is still to be sent, and stop. Progress stays where it is."""
        thread, self._thread = self._thread, None
        if thread is None:
            return
        self._give_up = time.monotonic() + patience
        self._over.set()
        self._news.set()
        thread.join(2 * patience)
        if self._defect is not None:
            raise self._defect
        if not self._is_told:
            _drop_events()
            _log(f"Prefect's server did not answer for {patience:g} s: what it shows of this run is not complete, the lake is")

    def _talk(self) -> None:
        """The thread: the newest progress every `UPDATE_SECONDS` at most, and everything else in the end."""
        from prefect.settings import PREFECT_CLIENT_MAX_RETRIES, temporary_settings

        try:
            with temporary_settings(updates={PREFECT_CLIENT_MAX_RETRIES: 0}):  # we try again ourselves, with what is newest then
                while not self._over.is_set():
                    self._news.wait()
                    self._news.clear()
                    if not self._is_taken(self._tell):
                        self._news.set()
                    self._over.wait(UPDATE_SECONDS)
                for step in (self._tell, *self._final):
                    while not self._is_taken(step):
                        if time.monotonic() > self._give_up:
                            return
                        time.sleep(UPDATE_SECONDS / 4)
            self._is_told = True
        except Exception as error:  # a defect of ours is raised where somebody sees it
            self._defect = error

    def _is_taken(self, step: Callable[[], object]) -> bool:
        """Whether the server took a step. An absent server is logged once, until it is back."""
        import httpx
        from prefect.exceptions import PrefectException

        try:
            step()
        except (httpx.HTTPError, PrefectException, OSError, RuntimeError, ValueError) as error:  # ValueError: a proxy's page
            status = _status(error)
            if status == 404:  # a server with another database: it knows neither our artifact nor, perhaps, the run
                self._artifact = self._name = None
                return False
            if 400 <= status < 500 and status not in (408, 429):
                _log(f"Prefect's server refuses what it is told of this run ({_line(error)}); the lake has everything")
                return True
            if not self._is_away:
                _log(f"Prefect's server does not answer ({_line(error)}); the run goes on, the lake has everything")
            self._is_away = True
            return False
        if self._is_away:
            _log("Prefect's server answers again")
        self._is_away = False
        return True

    def _tell(self) -> None:
        """Name and progress."""
        from prefect.artifacts import create_progress_artifact, update_progress_artifact
        from prefect.client.orchestration import get_client
        from prefect.runtime import flow_run

        with self._lock:
            progress, description = self._progress, f"{self._intro}\n\n{self._text}".strip()
        if self._name is not None:
            get_client(sync_client=True).set_flow_run_name(flow_run.id, self._name)
            self._name = None
        if self._artifact is None:
            self._artifact = create_progress_artifact(progress, key=self._key, description=description)
        else:
            update_progress_artifact(self._artifact, progress, description=description)


class Board:
    """What a run of `flows.pipeline.replicate` leaves in Prefect's UI; see `Ticker` for what happens when no server answers."""

    def __init__(self) -> None:
        self._ticker: Ticker | None = None
        self._name, self._scans = "", ""

    def begin(self, plan: Plan, lake: str, scans: str, dataset: str | None = None) -> None:
        """Name the flow run after what is to do, and start its progress artifact. Must be called inside it.

        Raises:
            InputError: an address carries a user name or a password.
        """
        self._name, self._scans = flow_run_name(scans, lake, len(plan.todo), dataset), public_address(scans)
        intro = f"{flow_run_name(scans, lake, dataset=dataset)}: {outcome.todo(plan)}"
        self._ticker = Ticker(artifact_key("progress", lake), intro, self._name)

    def advance(self, done: int, total: int, text: str) -> None:
        """So much of the run is over; `text` says what was last. Returns at once, whether or not a server answers."""
        if self._ticker is not None:
            self._ticker.advance(done, total, text)

    def end(self, report: RunReport, plan: Plan, lake: Lake, outputs: Mapping[str, str] | None = None) -> None:
        """Leave the table of scenes, the summary, and links to the lake and to `outputs` (name: address), which exist.

        Gives up on a server that does not answer within `PATIENCE_SECONDS`.
        """
        if self._ticker is None:
            return
        runs = outcome.runs_of(report, plan, lake)
        rows = outcome.scene_rows(report, plan, runs, outcome.formats_of(lake, report.done))
        text = outcome.run_markdown(report, plan, runs, lake.address)
        links = {"lake": lake.address, **(outputs or {})}
        steps = [partial(self._leave_scenes, lake.address, rows), partial(self._leave_summary, lake.address, text)]
        self._ticker.finish(outcome.counts(report), [*steps, *(partial(self._leave_link, lake.address, *link) for link in links.items())])

    def __enter__(self) -> Board:
        return self

    def __exit__(self, *exception: object) -> None:
        """Without a report, progress stays where it was."""
        if self._ticker is not None:
            self._ticker.close()

    def _leave_scenes(self, lake: str, rows: Sequence[Mapping[str, Any]]) -> None:
        from prefect.artifacts import create_table_artifact

        cut = f" The first {MAX_ROWS:,} of {len(rows):,}; all are in the lake." if len(rows) > MAX_ROWS else ""
        about = f"The scenes of {self._name}, failed ones first.{cut}"
        create_table_artifact([dict(row) for row in rows[:MAX_ROWS]], key=artifact_key("scenes", lake), description=about)

    def _leave_summary(self, lake: str, text: str) -> None:
        from prefect.artifacts import create_markdown_artifact

        create_markdown_artifact(text, key=artifact_key("summary", lake), description=f"What {self._name} did, and what to do next.")

    def _leave_link(self, lake: str, name: str, address: str) -> None:
        from prefect.artifacts import create_link_artifact

        about = f"{name.capitalize()}: {public_address(address)}, from {self._scans}"
        create_link_artifact(link_of(address), link_text=public_address(address), key=artifact_key(name, lake), description=about)


def _drop_events() -> None:
    """Forget the events that wait for a server which is gone: Prefect spends seven seconds on each before a process may end."""
    from prefect.events.worker import EventsWorker

    waiting = EventsWorker.instance()._queue
    with contextlib.suppress(queue.Empty):
        while True:
            waiting.get_nowait()
            waiting.task_done()


def _status(error: BaseException) -> int:
    """The status of an answer that became an error; 0 when there was no answer."""
    response = getattr(getattr(error, "http_exc", error), "response", None)
    return int(getattr(response, "status_code", 0))


def _line(error: BaseException) -> str:
    return f"{type(error).__name__}: {one_line(error)[:200]}".rstrip(": ")


def _log(text: str) -> None:
    """A line where this process tells its progress: the server that it is about is not there to take it."""
    current().say(text)
