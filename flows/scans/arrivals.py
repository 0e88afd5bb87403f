"""Which scans are new or changed, by content, and which are still being copied. Does not import Prefect.

A look lists every scan and sleeps for nothing: what it has to remember until the next one lies in the lake.
"""

from __future__ import annotations

import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from flows.run.fingerprints import RACY_SECONDS, FileHashes, digest
from flows.run.identity import Content, content_of, recorded_content, same_scenes
from flows.scans.choice import DAY_SECONDS, ScanSource, scan_source
from flows.scans.copies import incomplete_copies
from flows.scans.listing import ScanListing, files_of
from schemas.errors import InputError
from schemas.wording import counted
from tasks.capture.formats import survey
from tasks.capture.scan import PassedOver, Scan
from tasks.capture.wholeness import Gap, find_gap, is_temporary
from warehouse.lake import Lake
from warehouse.sharing.looks import Looks
from warehouse.tables.history import StageState

SETTLE_SECONDS = 120.0
"""Nobody has written to a scan for so long: a copy over a network has finished, or it has stalled."""

PATIENCE = 30
"""A scan that can be read, but lacks what others have, waits so many times longer: a stalled copy, or meant so."""

ATTEMPTS = 3
"""Runs that may end one after the other without having brought a scan into the lake; from then on it is tried once a day."""

HERE = "here"
"""The run of a watcher that computes by itself. When it looks again, that run is over."""

State = Literal["new", "changed", "waiting", "known", "failed before"]


@dataclasses.dataclass(frozen=True)
class Arrival:
    """A scan as a look found it, `why` it is in its state, and its `content` (a hash, '' while it is waiting).

    `attempt` counts the runs that were asked for this content before, `run` is the last of them, asked for at `asked_at` [s
    since the epoch]; `asks` counts those for any content. `is_overdue`: it has been incomplete for more than a day, and nobody
    was told within the last one. left_out: Links out of the folder of scans, in a line. `same_as`: the scene that it is, where the
    lake has its content under another name.
    """

    scan: str
    state: State
    why: str = ""
    size_bytes: int = 0
    content: str = ""
    attempt: int = 0
    run: str = ""
    asked_at: float = 0.0
    asks: int = 0
    is_overdue: bool = False
    left_out: str = ""
    same_as: str = ""


@dataclasses.dataclass
class Look:
    """What a look found at the time `now` [s since the epoch], and what the next one is to remember.

    passed_over: Files that are not scans and need not be.
    """

    now: float
    arrivals: list[Arrival]
    memory: dict[str, Any]
    before: dict[str, Any]
    passed_over: tuple[InputError, ...] = ()

    def due(self, is_over: Callable[[str], bool]) -> list[Arrival]:
        """New and changed scans that no run is at work on; `is_over` says whether a run has ended.

        A run that was asked for more than a day ago counts as over: one that nobody starts must not block its scans for ever.
        Those for which `ATTEMPTS` runs have ended in vain are `failed before` until a day after the last of them was asked for.
        """
        fresh = {item.run for item in self.arrivals if item.state in _WANTED and item.run and self._is_of_today(item)}
        ended = {run: is_over(run) for run in fresh}
        due = []
        for index, arrival in enumerate(self.arrivals):
            if arrival.state not in _WANTED:
                continue
            if not ended.get(arrival.run, True):
                self.arrivals[index] = dataclasses.replace(arrival, why=f"run {arrival.run} is under way")
            elif arrival.attempt >= ATTEMPTS and self._is_of_today(arrival):
                why = (
                    f"{counted(arrival.attempt, 'run')} ended and it is not in the "
                    f"lake; the last is {arrival.run}; it is tried again once a day"
                )
                self.arrivals[index] = dataclasses.replace(arrival, state="failed before", why=why)
            else:
                due.append(arrival)
        return due

    def _is_of_today(self, arrival: Arrival) -> bool:
        """Whether its last run was asked for less than a day ago. Clocks of two machines may differ either way."""
        return abs(self.now - arrival.asked_at) < DAY_SECONDS

    def asked(self, due: Iterable[Arrival], run: str) -> None:
        """Remember that a run was asked for these scans."""
        for arrival in due:
            record = {"content": arrival.content, "attempt": arrival.attempt + 1, "run": run, "at": self.now, "asks": arrival.asks + 1}
            self.memory["scans"][_key(arrival.scan)]["asked"] = record

    @property
    def is_news(self) -> bool:
        """Whether a scan's state has changed since the last look, or somebody is to be told today."""
        return self.before.get("sign") != self.sign or any(arrival.is_overdue for arrival in self.arrivals)

    @property
    def sign(self) -> str:
        """Changes when a scan's state does."""
        return digest(*(f"{arrival.scan}={arrival.state}:{arrival.why}:{arrival.content}" for arrival in self.arrivals))


_WANTED = ("new", "changed")


def request_key(scans: str, lake: str, due: Iterable[Arrival]) -> str:
    """A name for the run that is asked for: the same scans with the same content, after as many runs for them, give the same."""
    return digest("watch", scans, lake, *sorted(f"{arrival.scan}={arrival.content}:{arrival.attempt}:{arrival.asks}" for arrival in due))


def look(
    scans: str | Path,
    lake: Lake,
    settle_seconds: float = SETTLE_SECONDS,
    format: str = "auto",
    dataset: str | None = None,
    *,
    links_into: Sequence[str] = (),
    now: float | None = None,
    hashes: FileHashes | None = None,
) -> Look:
    """Hold the scans at an address against the lake. Writes caches of this machine and nothing else.

    A scan counts once two looks, `settle_seconds` or more apart, saw the same files. `now` [s since the epoch] is the time.

    Raises:
        InputError: no such place, or an unknown format.
    """
    hashes = hashes or FileHashes()
    source = scan_source(scans, links_into)
    try:
        before = _memory(scans, lake).read()
        now = time.time() if now is None else now
        watcher = _Watcher(source, lake, settle_seconds, now, hashes, before)
        arrivals = watcher.look(format, dataset)
        return Look(now, arrivals, watcher.memory, before, tuple(watcher.passed_over))
    finally:
        hashes.save()
        source.close()


def remember(latest: Look, scans: str | Path, lake: Lake) -> None:
    """Write down what the next look at these scans needs, unless nothing has changed."""
    latest.memory["sign"] = latest.sign
    if latest.memory != latest.before:
        _memory(scans, lake).write(latest.memory)


def _memory(scans: str | Path, lake: Lake) -> Looks:
    return lake.looks(str(scans) if "://" in str(scans) else str(Path(scans).resolve()))


class _Watcher:
    """One look."""

    def __init__(self, source: ScanSource, lake: Lake, settle: float, now: float, hashes: FileHashes, memory: Mapping[str, Any]) -> None:
        self._source, self._lake, self._settle, self._now, self._hashes = source, lake, settle, now, hashes
        before = memory.get("scans")
        self._before: Mapping[str, Any] = before if isinstance(before, dict) else {}
        self._after: dict[str, dict[str, Any]] = {}
        self.memory: dict[str, Any] = {"scans": self._after}
        self.passed_over: list[InputError] = []

    def look(self, format: str, dataset: str | None) -> list[Arrival]:
        """Everything that lies there, by scene id."""
        listings, errors = self._source.listing(format, dataset)
        self.passed_over = [error for error in errors if isinstance(error, PassedOver)]
        for scene, listing in listings.items():
            self._recall(scene, listing.mark)
        copying = {scene: name for scene, listing in listings.items() if (name := _temporary(listing))}
        settled = [scene for scene in listings if scene not in copying and self._age(scene) >= self._settle]
        failures = self._open([listings[scene] for scene in settled if not {"content", "nameless"} <= self._after[_key(scene)].keys()])
        here = [listings[scene].scan for scene in settled if scene not in failures and isinstance(listings[scene].scan.path, Path)]
        failures |= {scene: error.problem for scene, error in incomplete_copies(here, self._hashes).items()}
        lacking = _lacking(listings.values())
        captures, same = self._known(set(listings), [scene for scene in settled if scene not in failures])
        arrivals = []
        for scene, listing in sorted(listings.items()):
            arrival = Arrival(scene, "waiting", size_bytes=listing.size)
            if scene in copying:
                arrival = dataclasses.replace(arrival, why=f"{copying[scene]} is still being copied")
            elif scene in failures:
                arrival = dataclasses.replace(arrival, why=failures[scene])
            elif scene not in settled:
                arrival = dataclasses.replace(arrival, why=f"its files changed less than {self._settle:g} s ago")
            else:
                arrival = self._judged(arrival, captures.get(scene), lacking.get(scene, ""))
                if scene in same and arrival.state in _WANTED:
                    arrival = _known_as(arrival, same[scene], captures.get(same[scene]))
            arrivals.append(self._timed(arrival))
        return arrivals + [self._timed(self._unusable(error)) for error in errors if error not in self.passed_over]

    def _known(self, scenes: set[str], settled: Sequence[str]) -> tuple[dict[str, StageState], dict[str, str]]:
        """States of the capture by scene, and the scans that are scenes of another name, of those that have settled."""
        history = self._lake.history(scenes)
        contents = {
            scene: Content(str(self._after[_key(scene)]["content"]), str(self._after[_key(scene)]["nameless"])) for scene in settled
        }
        same = same_scenes(self._lake, contents, {scene: history.get((scene, "capture")) for scene in contents})
        history |= self._lake.history(set(same.values()) - scenes) if same else {}
        return {scene: state for (scene, stage), state in history.items() if stage == "capture"}, same

    def _recall(self, name: str, mark: str) -> None:
        """What is remembered of a scan: all of it while its files are the same, else since when it is incomplete, and its runs."""
        entry = self._before.get(_key(name))
        entry = dict(entry) if isinstance(entry, dict) else {}
        if entry.get("mark") != mark or not isinstance(entry.get("since"), int | float) or entry["since"] > self._now:
            entry = {key: entry[key] for key in ("incomplete", "told", "asked") if key in entry} | {"mark": mark, "since": self._now}
        self._after[_key(name)] = entry

    def _age(self, scene: str) -> float:
        return float(self._now - self._after[_key(scene)]["since"])

    def _open(self, listings: Sequence[ScanListing]) -> dict[str, str]:
        """Look into scans that have settled: what they lack, and the hash of their content. Why that was not possible, by scene."""
        ready, errors = self._source.fetch([listing.scan for listing in listings])
        local = {scan.scene_id: scan for scan in ready}
        why = {listing.scan.scene_id: "; ".join(map(str, errors)) for listing in listings if listing.scan.scene_id not in local}
        for listing in listings:
            scene = listing.scan.scene_id
            if scene in local:
                try:
                    self._note(listing, local[scene])
                except (OSError, InputError) as error:
                    why[scene] = f"{Path(str(error.filename)).name}: {error.strerror}" if isinstance(error, OSError) else str(error)
        return why

    def _note(self, listing: ScanListing, scan: Scan) -> None:
        """Remember what a scan lacks and the hash of its content."""
        entry = self._after[_key(scan.scene_id)]
        gap = find_gap(scan)
        files, left_out = survey(scan)
        content = content_of(scan, files, self._hashes)
        if scan.path == listing.scan.path and ScanListing(scan, files_of(scan)).mark != listing.mark:
            raise InputError(scan.scene_id, "files", "changed while they were looked at")
        entry |= {
            "content": content.named,
            "nameless": content.nameless,
            "gap": gap.what if gap else "",
            "is_readable": gap is None or gap.is_readable,
            "left_out": left_out,
        }
        # Within the resolution of time stamps a file may change without a sign of it: then the next look looks again.
        entry["is_lasting"] = self._settle >= RACY_SECONDS

    def _judged(self, arrival: Arrival, capture: StageState | None, lacking: str) -> Arrival:
        """The state of a scan that has settled."""
        entry = self._after[_key(arrival.scan)]
        content, gap = str(entry["content"]), Gap(str(entry["gap"]), bool(entry["is_readable"]))
        arrival = dataclasses.replace(arrival, left_out=str(entry.get("left_out", "")))
        if not entry.pop("is_lasting", True):
            for key in ("content", "nameless", "gap", "is_readable", "left_out"):
                entry.pop(key, None)
        last, done = (capture.last, capture.done) if capture else (None, None)
        if last is not None and last.outcome == "failed" and recorded_content(last) == content:
            return dataclasses.replace(arrival, state="failed before", why=last.error or "", content=content)
        if any(run is not None and run.outcome == "done" and recorded_content(run) == content for run in (last, done)):
            return dataclasses.replace(arrival, state="known", content=content)
        if gap.what and not gap.is_readable:
            return dataclasses.replace(arrival, why=gap.what)
        if (gap.what or lacking) and self._age(arrival.scan) < PATIENCE * self._settle:
            why = f"{gap.what or lacking}; it is read as it is when nothing changes for {PATIENCE * self._settle:g} s"
            return dataclasses.replace(arrival, why=why)
        asked = entry.get("asked")
        asked = asked if isinstance(asked, dict) else {}
        state: State = "changed" if capture is not None else "new"
        arrival = dataclasses.replace(arrival, state=state, content=content, asks=int(asked.get("asks", 0)))
        if asked.get("content") != content:
            return arrival
        last_run, asked_at = str(asked.get("run", "")), float(asked.get("at", 0.0))
        return dataclasses.replace(arrival, attempt=int(asked.get("attempt", 0)), run=last_run, asked_at=asked_at)

    def _timed(self, arrival: Arrival) -> Arrival:
        """Since when a scan is incomplete, and whether somebody is to be told today."""
        entry = self._after[_key(arrival.scan)]
        if arrival.state != "waiting":
            entry.pop("incomplete", None)
            entry.pop("told", None)
            return arrival
        since = entry.setdefault("incomplete", self._now)
        if self._now - since <= DAY_SECONDS or self._now - entry.get("told", -DAY_SECONDS) < DAY_SECONDS:
            return arrival
        entry["told"] = self._now
        return dataclasses.replace(arrival, is_overdue=True)

    def _unusable(self, error: InputError) -> Arrival:
        """What cannot be a scan yet: an empty folder, one without a known format."""
        self._recall(error.file, digest(str(error)))
        why = ": ".join(part for part in (error.field, error.problem) if part)
        return Arrival(error.file, "waiting", why=f"{why}; {error.remedy}" if error.remedy else why)


def _key(scan: str) -> str:
    """A scan's name in the memory, which names no scene: nothing of an erased one may be found in the lake."""
    return digest(scan)[:24]


def _known_as(arrival: Arrival, scene: str, capture: StageState | None) -> Arrival:
    """A scan that would be wanted, as the scene that it is under another name."""
    if capture is not None and capture.done is None and capture.last.outcome == "failed":
        return dataclasses.replace(arrival, state="failed before", why=f"as {scene}: {capture.last.error}")
    return dataclasses.replace(arrival, state="known", same_as=scene, why=f"is {scene}, the same scan under another name")


def _temporary(listing: ScanListing) -> str:
    """A temporary file of a copy that is under way, '' when there is none."""
    return next((file.path for file in listing.files if is_temporary(file.path)), "")


def _lacking(listings: Collection[ScanListing]) -> dict[str, str]:
    """What a scan has not, and more than half of the others of its kind have; scenes that lack nothing are left out."""
    kinds = {listing.scan.scene_id: _kinds(listing) for listing in listings}
    lacking = {}
    counts: dict[str, Counter[str]] = {}
    totals = Counter(listing.scan.format for listing in listings)
    for listing in listings:
        counts.setdefault(listing.scan.format, Counter()).update(kinds[listing.scan.scene_id])
    for listing in listings:
        siblings = totals[listing.scan.format] - 1
        own = kinds[listing.scan.scene_id]
        missing = sorted(kind for kind, count in counts[listing.scan.format].items() if kind not in own and 2 * count > siblings > 1)
        if missing:
            lacking[listing.scan.scene_id] = f"has no {missing[0]}, which most others have"
    return lacking


def _kinds(listing: ScanListing) -> set[str]:
    """Kinds of the files of a scan: names with `*` for the scan's own name; of files in folders the folder and the suffix."""
    kinds = set()
    for file in listing.files:
        folder, _, name = file.path.rpartition("/")
        if not name.startswith("."):
            kind = f"{folder}/*{Path(name).suffix}" if folder else name
            kinds.add(kind.replace(listing.scan.scan, "*"))
    return kinds


@dataclasses.dataclass(frozen=True)
class WatchReport:
    """What a look found, by scene id, and which scans it asked a run for. `run` is that run, '' when there was nothing to ask.

    `waiting` says why, `overdue` are those of them that have been incomplete for more than a day and were not told of today.
    `failures` are those of the run, where it was done at once. `left_out` says which links of which scan are not followed. `same`:
    known scans that are scenes of another name, by their own.
    """

    new: tuple[str, ...]
    changed: tuple[str, ...]
    waiting: dict[str, str]
    failed_before: dict[str, str]
    known: int
    overdue: tuple[str, ...]
    asked: tuple[str, ...] = ()
    run: str = ""
    failures: tuple[str, ...] = ()
    left_out: dict[str, str] = dataclasses.field(default_factory=dict)
    same: dict[str, str] = dataclasses.field(default_factory=dict)

    def __str__(self) -> str:
        total = len(self.new) + len(self.changed) + len(self.waiting) + len(self.failed_before) + self.known
        counts = {"new": len(self.new), "changed": len(self.changed), "waiting": len(self.waiting),
                  "failed before": len(self.failed_before), "known": self.known, "asked for": len(self.asked)}  # fmt: skip
        return f"{counted(total, 'scan')}: " + (", ".join(f"{count} {name}" for name, count in counts.items() if count) or "nothing")


def watch_report(latest: Look, asked: Iterable[Arrival] = (), run: str = "", failures: Iterable[str] = ()) -> WatchReport:
    """A look as a report."""

    def named(state: State) -> dict[str, str]:
        return {arrival.scan: arrival.why for arrival in latest.arrivals if arrival.state == state}

    overdue = tuple(f"{arrival.scan}: {arrival.why}" for arrival in latest.arrivals if arrival.is_overdue)
    return WatchReport(tuple(named("new")), tuple(named("changed")), named("waiting"), named("failed before"), len(named("known")),
                       overdue, tuple(arrival.scan for arrival in asked), run, tuple(failures),
                       {arrival.scan: arrival.left_out for arrival in latest.arrivals if arrival.left_out}
                       | {error.file: f"{error.problem}; {error.remedy}".removesuffix("; ") for error in latest.passed_over},
                       {arrival.scan: arrival.same_as for arrival in latest.arrivals if arrival.same_as})  # fmt: skip
