"""Scans in a store of objects, and their mirror in the cache folder of this machine.

A version of a scan is a folder `versions/<scan>-<version>/<name>`, made elsewhere and renamed into its place, so that it is
whole or not there, and never written again. Every source that uses versions says so in a folder of links,
`views/<writer>/`, and what no living process uses is removed once the store holds something else in its place.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import shutil
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import Any

from flows.progress import Progress
from flows.run.fanout.quota import GB, KEEP_FREE_GB
from flows.run.fingerprints import cache_folder, digest
from flows.scans.listing import ListedPath, ScanFile, ScanListing, files_of, listed_folder, listings, usable_paths
from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.text import one_line
from tasks.batches import parse_json
from tasks.capture.formats import find_scans, scan_files
from tasks.capture.premises import place_of
from tasks.capture.scan import Scan
from warehouse.sharing.writer import new_token, writer_of
from warehouse.storage.bucket import Bucket, Object
from warehouse.storage.objects import StoreError
from warehouse.storage.refusals import StoreAway
from warehouse.storage.workplace import workplace

SCANS_AT_ONCE, OBJECTS_AT_ONCE = 4, 8
"""Scans, and objects of one scan, that are fetched at the same time: requests take longer than their bytes."""


FORGOTTEN_SECONDS = 30 * 86_400.0
"""A view by another machine (a cache folder that several share) is taken to be over after this time."""


class FetchError(InputError):
    """A scan could not be fetched from its store: a full disk, an expired key, a broken transfer. No fault of the scan."""


class StoreSource:
    """Scans below `s3://bucket/prefix` (`gs://`, `az://`). Objects are listed once; their bytes are fetched when they are asked for."""

    def __init__(self, address: str) -> None:
        scheme, _, place = address.partition("://")
        bucket, _, self._prefix = place.rstrip("/").partition("/")
        self._bucket = Bucket(f"{scheme}://{bucket}")
        self.address = f"{self._bucket.address}/{self._prefix}".rstrip("/")
        names = self._prefix.split("/") if self._prefix else [bucket]
        if not bucket or "@" in bucket or any(name in ("", ".", "..") for name in names):
            raise InputError(
                f"{scheme}://", "--scans", "needs a bucket, and a prefix without empty folders", f"give {scheme}://bucket/prefix"
            )
        self.name = names[-1]
        self._root = cache_folder() / "scans" / digest(self.address)[:32]
        self._views: list[Path] = []
        self._promised, self._room = 0, threading.Lock()

    def find(self, format: str = "auto", dataset: str | None = None) -> tuple[list[Scan], list[InputError]]:
        """See ScanSource. Paths of the scans are names in the listing."""
        files, errors = self._objects
        if not files:
            return [], [*errors, InputError(self.address, "--scans", "holds no objects", "name a scan, or a folder of scans")]
        scans, wrong = find_scans(self._folder, format, dataset)
        return scans, [*errors, *wrong]

    def listing(self, format: str = "auto", dataset: str | None = None) -> tuple[dict[str, ScanListing], list[InputError]]:
        """See ScanSource."""
        return listings(*self.find(format, dataset))

    def fetch(self, scans: Sequence[Scan]) -> tuple[list[Scan], list[InputError]]:
        """See ScanSource. Objects that were fetched before, and are unchanged by size and ETag, are not fetched again."""
        versions = [_Version.of(scan, self._folder, self._root) for scan in scans]
        self._view(versions)
        ready: list[Scan] = []
        errors: list[InputError] = []
        missing = sum(not version.is_whole for version in versions)
        with Progress("scans fetched", missing) as progress, ThreadPoolExecutor(SCANS_AT_ONCE) as threads:
            for version, error in zip(versions, threads.map(lambda v: self._ensure(v, progress), versions), strict=True):
                if error is None:
                    ready.append(dataclasses.replace(version.scan, path=version.path))
                else:
                    errors.append(error)
        self._sweep(versions)
        return ready, errors

    def folder(self, only: Iterable[str] | None = None) -> Path:
        """See ScanSource. A folder of links to the mirrored scans."""
        wanted = None if only is None else set(only)
        _, errors = self.fetch([scan for scan in self.find()[0] if wanted is None or scan.scene_id in wanted])
        if errors:
            raise errors[0]
        return self._views[-1] / self.name

    def close(self) -> None:
        """See ScanSource."""
        while self._views:
            shutil.rmtree(self._views.pop(), ignore_errors=True)

    @cached_property
    def _objects(self) -> tuple[list[ScanFile], list[InputError]]:
        """All objects, with paths below the address; '' is the object at the address itself."""
        try:
            files = [entry for entry in self._bucket.objects(self._prefix) if not entry.key.endswith("/")]
            itself = self._bucket.object(self._prefix) if self._prefix and not files else None
        except StoreAway:
            raise
        except OSError as error:
            remedy = "check the address, AWS_ENDPOINT_URL and the credentials"
            raise InputError(self.address, "--scans", f"cannot be listed ({_reason(error)})", remedy) from error
        return usable_paths(self._listed(entry) for entry in (files if itself is None else [itself]))

    def _listed(self, entry: Object) -> ScanFile:
        return ScanFile(entry.key.removeprefix(self._prefix).removeprefix("/"), entry.size, int(entry.modified * 1e9), entry.tag)

    @cached_property
    def _folder(self) -> Path:
        return listed_folder(self.name, self._objects[0])

    def _view(self, versions: Sequence[_Version]) -> None:
        """Links to versions, made before the versions are, so that no other process removes what is about to be used."""
        view = self._root / "views" / new_token()
        with _locked(self._root / "lock"):
            view.mkdir(parents=True)
            self._views.append(view)
            (view / "versions").write_text("\n".join(version.folder.name for version in versions))
            if not versions:
                (view / self.name).mkdir()
            for link, target in {pair for version in versions for pair in version.links(view / self.name)}:
                link.parent.mkdir(parents=True, exist_ok=True)
                with contextlib.suppress(FileExistsError):  # the license that two scans of one folder share
                    link.symlink_to(target)

    def _ensure(self, version: _Version, progress: Progress) -> InputError | None:
        """Fetch a version unless it is there already, whoever fetched it."""
        try:
            with _locked(self._root / "locks" / version.folder.name[-2:]):
                if not version.is_whole:
                    self._make(version)
                    progress.advance(version.scan.scene_id)
                version.keep_times()
        except InputError as error:
            return error
        except Exception as error:
            return FetchError(version.scan.scene_id, "objects", f"cannot be fetched ({_reason(error)})", "run the same command again")
        return None

    def _make(self, version: _Version) -> None:
        with workplace(self._root / "making") as made:
            here = made / "content" / version.content.name
            here.mkdir(parents=True)
            known = version.known_files()
            missing = [(e, below) for e, below in version.files if not _linked(known.get(_mark(e, below)), e.size, here / below)]
            if missing:
                with self._space(version.scan.scene_id, sum(entry.size for entry, _ in missing)):
                    # All of them end before an error goes on: none may write to a folder that is being removed.
                    with ThreadPoolExecutor(OBJECTS_AT_ONCE) as threads:
                        fetches = [threads.submit(self._object, entry, here / below) for entry, below in missing]
                    for fetch in fetches:
                        fetch.result()
            version.put(here, made)

    @contextlib.contextmanager
    def _space(self, scene: str, size: int) -> Iterator[None]:
        """Room for the `size` bytes of a scan beside what else is being fetched. What others have written of theirs counts twice."""
        with self._room:
            self._promised += size
        try:
            if shutil.disk_usage(self._root).free - self._promised < KEEP_FREE_GB * GB:
                problem = f"the disk of {self._root} would have less than {KEEP_FREE_GB:g} GB left with its {size / GB:.3g} GB"
                raise FetchError(scene, "objects", problem, "free some, or set METASCENES_CACHE, and run again")
            yield
        finally:
            with self._room:
                self._promised -= size

    def _object(self, entry: ScanFile, path: Path) -> None:
        """One object as it was listed: another ETag or size by now is an error."""
        path.parent.mkdir(parents=True, exist_ok=True)
        key = "/".join(part for part in (self._prefix, entry.path) if part)
        written = 0
        with path.open("wb") as out:
            for chunk in self._bucket.chunks(Object(key, entry.size, entry.modified_ns / 1e9, entry.tag)):
                written += out.write(chunk)
        if written != entry.size:
            raise OSError(f"{entry.path} ended after {written} of {entry.size} bytes")

    def _sweep(self, wanted: Sequence[_Version]) -> None:
        """Remove versions that nobody uses and the store no longer holds, and views of processes that ended."""
        current = {version.place: version.folder.name for version in wanted}
        with _locked(self._root / "lock"):
            used: set[str] = set()
            for view in (self._root / "views").iterdir():
                if _is_over(view):
                    shutil.rmtree(view, ignore_errors=True)
                else:
                    with contextlib.suppress(FileNotFoundError):  # being closed
                        used |= set((view / "versions").read_text().splitlines())
            for facts in (self._root / "versions").glob("*.json"):
                place = facts_of(facts).get("scan")
                is_current = isinstance(place, str) and (
                    current[place] == facts.stem if place in current else (self._folder / place).exists()
                )
                if not is_current and facts.stem not in used:
                    facts.unlink(missing_ok=True)
                    shutil.rmtree(facts.with_suffix(""), ignore_errors=True)


@dataclasses.dataclass(frozen=True)
class _Version:
    """A scan as the store has it now. `place`: its path below the address, '' at the address itself; `files`: what is
    fetched of it, with each file's path below the scan's folder; `folder`: where this version lies in the mirror."""

    scan: Scan
    place: str
    files: tuple[tuple[ScanFile, str], ...]
    folder: Path

    @staticmethod
    def of(scan: Scan, listed: Path, root: Path) -> _Version:
        """The version of a scan that a listing shows."""
        place = scan.path.relative_to(listed).as_posix()
        files = tuple(sorted(_needed(scan)))
        version = digest(*(_mark(entry, below) for entry, below in files))[:40]
        place = "" if place == "." else place
        return _Version(scan, place, files, root / "versions" / f"{digest(place)[:16]}-{version}")

    @property
    def content(self) -> Path:
        """The scan's folder in the mirror; it keeps its name, which some readers take for the scan's."""
        return self.folder / (self.scan.path.name if self.scan.path.is_dir() else "file")

    @property
    def path(self) -> Path:
        """The scan in the mirror: its folder, or its one file."""
        return self.content if self.scan.path.is_dir() else self.content / self.scan.path.name

    @property
    def is_whole(self) -> bool:
        """Whether the mirror has every file of it. Somebody may have cleaned up in the cache folder."""
        return self._facts.is_file() and all(_size(self.content / below) == entry.size for entry, below in self.files)

    @property
    def _facts(self) -> Path:
        return self.folder.parent / f"{self.folder.name}.json"

    def links(self, root: Path) -> list[tuple[Path, Path]]:
        """Links that show the scan below `root` where it lies below the address, and what they lead to."""
        if self.scan.path.is_dir() or not self.place:
            return [(root / self.place, self.path)]
        return [((root / self.place).parent / below, self.content / below) for _, below in self.files]

    def known_files(self) -> dict[str, Path]:
        """Files of other versions of the scan, by path, size and ETag."""
        known: dict[str, Path] = {}
        for facts in self.folder.parent.glob(f"{self.folder.name.partition('-')[0]}-*.json"):
            read = facts_of(facts)
            files = read.get("files")
            content = facts.with_suffix("") / str(read.get("content", ""))
            known |= {mark: content / str(below) for mark, below in files.items()} if isinstance(files, dict) else {}
        return known

    def put(self, content: Path, spare: Path) -> None:
        """Put the finished content in its place; what is left of a damaged one goes to the folder `spare`."""
        for _, below in self.files:
            with (content / below).open("rb") as file:
                os.fsync(file.fileno())  # a power failure must not leave a version that is whole by its sizes only
        made = spare / "version"
        made.mkdir()
        content.rename(made / content.name)
        files = {_mark(entry, below): below for entry, below in self.files}
        facts = {"scene": self.scan.scene_id, "scan": self.place, "content": content.name, "files": files}
        (spare / "facts").write_text(json.dumps(facts))
        self.folder.parent.mkdir(parents=True, exist_ok=True)
        if self.folder.exists():
            self.folder.rename(spare / "damaged")
        made.rename(self.folder)
        (spare / "facts").replace(self._facts)

    def keep_times(self) -> None:
        """Give every file the time of its object, which tells when the scan arrived."""
        for entry, below in self.files:
            path = self.content / below
            if path.stat().st_mtime_ns != entry.modified_ns:
                os.utime(path, ns=(entry.modified_ns, entry.modified_ns))


def facts_of(path: Path) -> dict[str, Any]:
    """Facts of a version, as they were written; empty if the file is gone or damaged. The version is fetched again then."""
    try:
        read = parse_json(read_file(path, path.name, BUDGET.text_bytes), str(path))
    except InputError:
        return {}
    return read if isinstance(read, dict) else {}


def _needed(scan: Scan) -> list[tuple[ScanFile, str]]:
    """Objects that a scan is read from; all that lie in its folder where these alone would not be known for the same scan."""
    root = scan.path if scan.path.is_dir() else scan.path.parent
    read = [(_entry(path), place_of(path, root)) for path in scan_files(scan)]
    if scan.path.is_file():
        return read
    again, _ = find_scans(listed_folder(scan.path.name, [dataclasses.replace(e, path=below) for e, below in read]), scan.format)
    if [(other.scan, len(other.path.parts)) for other in again] == [(scan.scan, 1)]:
        return read
    own = {(_entry(root / file.path), file.path) for file in files_of(scan) if not file.path.startswith("../")}
    return sorted(own | set(read))


def _entry(path: Path) -> ScanFile:
    assert isinstance(path, ListedPath)
    return path.entry


def _mark(entry: ScanFile, below: str) -> str:
    return f"{below}={entry.size}:{entry.tag}"


def _linked(known: Path | None, size: int, path: Path) -> bool:
    """Whether `path` could be made of a file that was fetched before, and still has its size [B]."""
    if known is None or _size(known) != size:
        return False
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(known, path)
    except FileNotFoundError:
        return False
    except OSError:  # a file system without hard links
        shutil.copyfile(known, path)
    return True


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return -1


def _is_over(view: Path) -> bool:
    """Whether the process that made a view has ended."""
    writer = writer_of(view.name)
    if writer is not None and writer.is_here:
        return not writer.is_alive
    try:
        return time.time() - view.stat().st_mtime > FORGOTTEN_SECONDS
    except FileNotFoundError:
        return False


@contextlib.contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold a lock file; the kernel frees it when the process ends, however it ends."""
    import fcntl

    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def _reason(error: BaseException) -> str:
    """What went wrong, without what a client may quote of requests: they can carry credentials."""
    if isinstance(error, StoreError):
        return error.reason
    text = error.strerror or str(error) if isinstance(error, OSError) else ""
    return f"{type(error).__name__}{': ' if text else ''}{one_line(text)[:120]}"
