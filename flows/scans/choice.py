"""Where scans lie, a folder or `s3://bucket/prefix` (`gs://`, `az://`), and which of them a run is about."""

from __future__ import annotations

import datetime
import fnmatch
import os
import time
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Protocol

from flows.scans.listing import ScanListing, listings
from schemas.errors import InputError, check_address
from schemas.wording import meant
from tasks.capture.formats import find_scans, scan_files
from tasks.capture.premises import stores
from tasks.capture.scan import Scan
from warehouse.storage.files import STORES

DAY_SECONDS = 86_400.0


class ScanSource(Protocol):
    """A place with scans. All answers of a source come from one listing."""

    address: str

    def find(self, format: str = "auto", dataset: str | None = None) -> tuple[list[Scan], list[InputError]]:
        """Scans that lie there, as `find_scans` has them, and what is wrong with the rest. Nothing is opened or fetched.

        Raises:
            InputError: the place does not exist or cannot be listed, or the format is not known.
        """

    def listing(self, format: str = "auto", dataset: str | None = None) -> tuple[dict[str, ScanListing], list[InputError]]:
        """Every file of every scan by scene id, with size, time and ETag; and what is wrong with the rest. Nothing is fetched."""

    def fetch(self, scans: Sequence[Scan]) -> tuple[list[Scan], list[InputError]]:
        """The same scans as files of this machine, each whole; and an error for each that could not be had whole."""

    def folder(self, only: Iterable[str] | None = None) -> Path:
        """A local folder that `find_scans` reads, with the scans of these scene ids at least (None: all of them). Of a store it
        is one of links into the cache folder.

        Raises:
            InputError: a scan could not be fetched whole.
        """

    def close(self) -> None:
        """What `fetch` and `folder` gave may be removed from now on."""


def scan_source(address: str | Path, links_into: Sequence[str] = ()) -> ScanSource:
    """The scans at an address: a folder, one scan, or `s3://bucket/prefix` with endpoint and credentials as lakes have them.

    links_into: Folders that links out of the folder may lead into; each text is one, or several as in PATH. A folder that is
        there may have a colon in its name.

    Raises:
        InputError: the address is of no known kind, or carries credentials; or one of the folders does not exist.
    """
    text = str(address)
    check_address(text, "--scans")
    allowed = stores(folder for listed in links_into for folder in _folders(listed))
    if isinstance(address, str) and address.startswith(STORES):
        from flows.scans.mirror import StoreSource

        return StoreSource(address)
    if isinstance(address, str) and "://" in address:
        raise InputError(address.partition("://")[0] + "://", "--scans", "is not supported", "give a folder or s3://bucket/prefix")
    return FolderSource(Path(text), allowed)


def _folders(listed: str) -> Iterator[str]:
    """The folders of a text as in PATH; what is a folder as a whole is one, whatever is in its name."""
    parts = listed.split(os.pathsep)
    while parts:
        count = next((count for count in range(len(parts), 1, -1) if os.path.isdir(os.pathsep.join(parts[:count]))), 1)
        if folder := os.pathsep.join(parts[:count]):
            yield folder
        parts = parts[count:]


class FolderSource:
    """Scans in a folder of this machine, read where they lie."""

    def __init__(self, path: Path, links_into: Sequence[Path] = ()) -> None:
        self.address = str(path)
        self._path, self._links_into = path, tuple(links_into)

    def find(self, format: str = "auto", dataset: str | None = None) -> tuple[list[Scan], list[InputError]]:
        """See ScanSource."""
        return find_scans(self._path, format, dataset, self._links_into)

    def listing(self, format: str = "auto", dataset: str | None = None) -> tuple[dict[str, ScanListing], list[InputError]]:
        """See ScanSource."""
        scans, errors = self.find(format, dataset)
        return listings(scans, errors)

    def fetch(self, scans: Sequence[Scan]) -> tuple[list[Scan], list[InputError]]:
        """See ScanSource. They are here already."""
        return list(scans), []

    def folder(self, only: Iterable[str] | None = None) -> Path:
        """See ScanSource. The folder itself, whatever else lies in it."""
        return self._path

    def close(self) -> None:
        """See ScanSource."""


def found_scans(
    address: str | Path,
    format: str = "auto",
    dataset: str | None = None,
    *,
    scenes: Sequence[str] = (),
    first: str | None = None,
    last: str | None = None,
    since: str | None = None,
    until: str | None = None,
    links_into: Sequence[str] = (),
) -> tuple[list[Scan], list[InputError]]:
    """The chosen scans at an address, ready to be read from this machine's files, and what is wrong with the rest. Where
    `scenes` names each of them, nothing is said of the rest.

    Of scans in an S3 store, only the chosen ones are fetched, and of these what changed since the last time. What was
    fetched stays at least until this process ends.

    Raises:
        InputError: no such place, an unknown format, a folder of `links_into` that does not exist, or a choice that cannot be (see
            `chosen`).
    """
    source = scan_source(address, links_into)
    all_scans, errors = source.find(format, dataset)
    wanted = chosen(all_scans, scenes=scenes, first=first, last=last, since=since, until=until)
    ready, missing = source.fetch(wanted)
    if scenes and not any(_is_pattern(scene) for scene in scenes):
        errors = []
    return ready, [*errors, *missing]


def chosen(
    scans: Sequence[Scan],
    *,
    scenes: Sequence[str] = (),
    first: str | None = None,
    last: str | None = None,
    since: str | None = None,
    until: str | None = None,
) -> list[Scan]:
    """The scans that meet every condition, in their order.

    Args:
        scans: Scans that were found.
        scenes: Scene ids or shell patterns; without a slash they speak of the scan's name, as in the id or as its folder has
            it. Any of them suffices; none: all.
        first: First scene id of a range, included; ids are compared as texts, names of scans where there is no slash.
        last: Last scene id of a range, included.
        since: Day or time (ISO 8601, UTC unless it says otherwise) from which on the scan arrived, included. A scan arrives
            when its newest file was last written.
        until: Day or time until which it arrived, included; a day counts to its end.

    Raises:
        InputError: a pattern that no scan meets, a range whose end is before its start, no date.
    """
    scenes = [unicodedata.normalize("NFC", scene) for scene in scenes]
    exact = {scene for scene in scenes if not _is_pattern(scene)}
    patterns = [scene for scene in scenes if _is_pattern(scene)]
    names = {name for scan in scans for name in _names(scan)}
    for pattern in scenes:
        if pattern not in names and not (pattern in patterns and any(_matches(scan, pattern) for scan in scans)):
            known = ", ".join(scan.scene_id for scan in scans[:3]) + (", ..." if len(scans) > 3 else "")
            remedy = f"{meant(pattern, sorted(names))}there are {known}" if scans else "look at --scans"
            raise InputError("--scene", pattern, f"no scan matches, of {len(scans)}", remedy)
    if first is not None and last is not None and ("/" in first) == ("/" in last) and first > last:
        raise InputError("--first", first, f"is after --last {last}", "swap them")
    start, end = _moment(since, "--since")[0], _moment(until, "--until")[1]
    if start is not None and end is not None and start >= end:
        raise InputError("--since", str(since), f"is after --until {until}", "swap them")
    tests: list[Callable[[Scan], bool]] = []
    if scenes:
        tests.append(lambda scan: not exact.isdisjoint(_names(scan)) or any(_matches(scan, p) for p in patterns))
    if first is not None:
        tests.append(lambda scan: _as_in(scan, first) >= first)
    if last is not None:
        tests.append(lambda scan: _as_in(scan, last) <= last)
    if start is not None or end is not None:
        tests.append(lambda scan: _is_within(arrived(scan), start, end))
    return [scan for scan in scans if all(test(scan) for test in tests)]


def arrived(scan: Scan) -> float | None:
    """When a scan arrived [s since the epoch]: the newest modification of its files; None where they cannot be looked at."""
    try:
        return max((file.stat().st_mtime for file in scan_files(scan)), default=None)
    except (OSError, InputError):
        return None


def settled(scans: Sequence[Scan], seconds: float, by_change: bool = True) -> tuple[list[Scan], list[Scan]]:
    """Scans that nobody seems to be copying any more, and those that are left for later.

    A scan is left while a file of it is younger than `seconds`, or a copying program's temporary file lies in its folder; and
    for a day after its last change while it lacks what its reader cannot do without. Only scans of the last day are opened.
    `by_change`: files are as old as their last change of any kind, which a copy cannot set; else as their modification.
    """
    from tasks.capture.wholeness import find_gap, is_temporary

    calm: list[Scan] = []
    busy: list[Scan] = []
    now = time.time()
    for scan in scans:
        try:
            states = [file.stat() for file in scan_files(scan)]
            moments = [max(status.st_mtime, status.st_ctime) if by_change else status.st_mtime for status in states]
            age = now - max(moments, default=0.0)
            is_busy = age < seconds or any(is_temporary(entry.name) for entry in scan.folder.iterdir())
            if not is_busy and age < DAY_SECONDS:
                gap = find_gap(scan)
                is_busy = gap is not None and not gap.is_readable
        except (OSError, InputError):  # its own error comes when it is read
            is_busy = False
        (busy if is_busy else calm).append(scan)
    return calm, busy


def _is_within(moment: float | None, start: float | None, end: float | None) -> bool:
    """Whether a scan is in a range of time. One that cannot be looked at is: so it is reported, not passed over."""
    return moment is None or ((start is None or moment >= start) and (end is None or moment < end))


def _is_pattern(text: str) -> bool:
    return any(letter in text for letter in "*?[")


def _matches(scan: Scan, pattern: str) -> bool:
    return any(fnmatch.fnmatchcase(name, pattern) for name in _names(scan) if ("/" in name) == ("/" in pattern))


def _names(scan: Scan) -> tuple[str, ...]:
    """What a scan is called: its scene id, the scan's part of it, and its name where it lies."""
    return scan.scene_id, _as_in(scan, ""), unicodedata.normalize("NFC", scan.scan)


def _as_in(scan: Scan, text: str) -> str:
    """The scene id, or without a slash in what it is compared to, only the scan's part of it."""
    return scan.scene_id if "/" in text else scan.scene_id.rpartition("/")[2]


def _moment(text: str | None, option: str) -> tuple[float | None, float | None]:
    """Start and end [s since the epoch] of the day, or of the microsecond, that a text names."""
    if text is None:
        return None, None
    try:
        day = datetime.date.fromisoformat(text)
    except ValueError:
        pass
    else:
        begin = datetime.datetime(day.year, day.month, day.day, tzinfo=datetime.UTC).timestamp()
        return begin, begin + DAY_SECONDS
    try:
        moment = datetime.datetime.fromisoformat(text)
        begin = (moment if moment.tzinfo else moment.replace(tzinfo=datetime.UTC)).timestamp()
    except (ValueError, OverflowError) as error:
        today = time.strftime("%Y-%m-%d", time.gmtime())
        raise InputError(option, text[:40], "is no date", f"write {today} or {today}T18:30+02:00") from error
    return begin, begin + 1e-6
