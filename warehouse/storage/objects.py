"""A lake in a store of objects (S3 and what speaks it, Google Cloud Storage, Azure): conditional puts in the place of locks."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import re
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime, timedelta
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from schemas.errors import InputError, LakeError
from schemas.machine.scratch import temporary_folder
from schemas.parsing import json_value
from warehouse.storage.files import Entry
from warehouse.storage.refusals import StoreAway

if TYPE_CHECKING:
    import pyarrow.fs

T = TypeVar("T")
U = TypeVar("U")

AT_ONCE = 16
"""Requests for many small objects that are under way at a time."""

# Refused credentials of a role end within the hour; whoever gives them is asked again in time.
_CREDENTIALS_LIFE = timedelta(minutes=15)


class ObjectStorage:
    """A lake at `s3://`, `gs://` or `az://`. Endpoint, region and credentials come from where the store's own tools take them."""

    def __init__(self, address: str) -> None:
        self.address = address.rstrip("/")
        self._scheme, _, self._place = self.address.partition("://")
        if not all(self._place.partition("/")[::2]):
            raise InputError(address, "", "the address needs a bucket and a prefix", f"give {self._scheme}://bucket/prefix")
        if any(character in self.address for character in "[]*?#%\\ "):
            raise InputError(address, "", "the lake's address holds one of [ ] * ? # % \\ or a space", "choose a prefix without them")

    def __reduce__(self) -> tuple[Any, ...]:
        return (ObjectStorage, (self.address,))

    @cached_property
    def _credentials(self) -> Credentials | None:
        return credentials_for(self.address)

    @cached_property
    def _store(self) -> Any:
        return object_store(self.address, self._credentials)

    def _ask(self, path: str, question: Callable[[Any], T]) -> T:
        store = self._store
        with answered(self.address, path):
            return question(store)

    def read(self, path: str) -> bytes:
        """See Storage."""
        return self._ask(path, lambda store: bytes(store.get(path).bytes()))

    def write(self, path: str, data: bytes, lasting: bool = True) -> None:
        """See Storage. A put is whole or not at all."""
        self._ask(path, lambda store: store.put(path, data, use_multipart=False))

    def write_together(self, files: Mapping[str, bytes]) -> None:
        """See Storage."""
        *first, last = files
        for _ in self.each(lambda path: self.write(path, files[path]), first):
            pass
        self.write(last, files[last])

    def move_in(self, file: Path, path: str) -> None:
        """See Storage. An upload in parts, which are one object when the last is there and none before."""
        self._ask(path, lambda store: store.put(path, file))
        file.unlink()

    def workplace(self) -> contextlib.AbstractContextManager[Path]:
        """See Storage. In the system's folder of temporary files."""
        return temporary_folder()

    def create(self, path: str, data: bytes) -> bool:
        """See Storage. A put on the condition that there is no such object."""
        return self._put_if(path, data, "create")

    def exists(self, path: str) -> bool:
        """See Storage."""
        return self._head(path) is not None

    def refresh(self, path: str, seconds: float) -> bool:
        """See Storage. An old object counts as missing: no store makes it younger without another put."""
        head = self._head(path)
        return head is not None and time.time() - head["last_modified"].timestamp() <= seconds

    def remove(self, path: str) -> None:
        """See Storage."""
        with contextlib.suppress(FileNotFoundError):
            self._ask(path, lambda store: store.delete(path))

    def remove_all(self, paths: Sequence[str]) -> None:
        """See Storage."""
        for _ in self.each(self.remove, paths):
            pass

    def each(self, work: Callable[[T], U], items: Sequence[T]) -> Iterator[U]:
        """See Storage. A store far away answers `AT_ONCE` requests in the time of one."""
        if len(items) < 2:
            yield from map(work, items)
            return
        with ThreadPoolExecutor(min(AT_ONCE, len(items)), thread_name_prefix="requests") as threads:
            yield from threads.map(work, items)

    def entries(self, folder: str) -> list[Entry]:
        """See Storage."""
        return sorted(map(_entry, self._listed(folder)["objects"]), key=lambda entry: entry.path)

    def names(self, folder: str, head: str = "") -> list[str]:
        """See Storage. Stores list in the order of the names, so that those with a head are asked for alone."""
        if not head:
            return [entry.path.rpartition("/")[2] for entry in self.entries(folder)]
        first = f"{folder}/{head}".lstrip("/")
        listed = self._pages(folder, offset=first[:-1] + chr(ord(first[-1]) - 1))
        later = itertools.dropwhile(lambda entry: not entry.path.startswith(first), listed)
        matching = itertools.takewhile(lambda entry: entry.path.startswith(first), later)
        names = (entry.path.removeprefix(f"{folder}/") for entry in matching)
        return sorted(name for name in names if "/" not in name)

    def folders(self, folder: str) -> list[str]:
        """See Storage."""
        return sorted(name.rpartition("/")[2] for name in self._listed(folder)["common_prefixes"])

    def walk(self, folder: str) -> Iterator[Entry]:
        """See Storage."""
        return self._pages(folder)

    def read_tagged(self, path: str) -> tuple[bytes, str] | None:
        """See Storage. The tag is the object's ETag, and its generation where the store has one."""

        def both(store: Any) -> tuple[bytes, str]:
            answer = store.get(path)
            return bytes(answer.bytes()), _tag(answer.meta)

        try:
            return self._ask(path, both)
        except FileNotFoundError:
            return None

    def swap(self, path: str, data: bytes | None, tag: str) -> bool:
        """See Storage. A put on the condition that the object still has the tag.

        Removing has no such condition on all stores, so there it is looked up first. Only the holder of a lease
        removes it, while nobody else may touch it.
        """
        if data is not None:
            return self._put_if(path, data, json_value(tag))
        head = self._head(path)
        if head is None or _tag(head) != tag:
            return False
        self.remove(path)
        return True

    def delta_address(self, path: str) -> str:
        """See Storage."""
        return f"{self.address}/{path}"

    def delta_options(self) -> dict[str, str] | None:
        """See Storage. delta-rs does not read the AWS tools' files, so it is given what they say."""
        if self._credentials is None:
            return None
        options = {"conditional_put": "etag", "AWS_REGION": self._credentials.region}
        credentials = self._credentials()
        named = {"AWS_ACCESS_KEY_ID": "access_key_id", "AWS_SECRET_ACCESS_KEY": "secret_access_key", "AWS_SESSION_TOKEN": "token"}
        options |= {name: str(credentials[key]) for name, key in named.items() if credentials[key]}
        host = endpoint()
        if host:
            options |= {"AWS_ENDPOINT_URL": host, "AWS_ALLOW_HTTP": str(host.startswith("http://")).lower()}
        return options

    def arrow_filesystem(self) -> pyarrow.fs.FileSystem:
        """See Storage."""
        from pyarrow.fs import FSSpecHandler, PyFileSystem

        return PyFileSystem(FSSpecHandler(self._files))

    def arrow_path(self, path: str) -> str:
        """See Storage."""
        return f"{self._place}/{path}"

    def duckdb_path(self, path: str) -> str:
        """See Storage."""
        return f"{self.address}/{path}"

    def register(self, connection: Any) -> None:
        """See Storage."""
        connection.register_filesystem(self._files)

    @cached_property
    def _files(self) -> Any:
        from warehouse.storage.ranges import RangeFiles

        return RangeFiles(self._scheme, self._place, self._ask)

    def local_path(self, path: str) -> Path | None:
        """See Storage."""
        return None

    def _listed(self, folder: str) -> Any:
        try:
            return self._ask(folder, lambda store: store.list_with_delimiter(folder))
        except FileNotFoundError:
            return {"objects": [], "common_prefixes": []}

    def _pages(self, folder: str, offset: str | None = None) -> Iterator[Entry]:
        store = self._store
        with contextlib.suppress(FileNotFoundError), answered(self.address, folder):
            for page in store.list(folder, offset=offset):
                yield from map(_entry, page)

    def _head(self, path: str) -> Any:
        """What a store says of an object; None when there is none."""
        try:
            return self._ask(path, lambda store: store.head(path))
        except FileNotFoundError:
            return None

    def _put_if(self, path: str, data: bytes, mode: Any) -> bool:
        """Put an object on a condition; whether it held."""
        from obstore.exceptions import AlreadyExistsError, PreconditionError

        def put(store: Any) -> bool:
            try:
                store.put(path, data, mode=mode, use_multipart=False)
            except (AlreadyExistsError, PreconditionError):
                return False
            return True

        return self._ask(path, put)


def object_store(address: str, credentials: Credentials | None) -> Any:
    """The store that an address and the environment name, as obstore's; paths in it are below the address. On S3 with credentials.

    Raises:
        InputError: the package that talks to it is not installed.
    """
    try:
        import obstore.store
    except ImportError as error:
        raise InputError(address, "", "addresses in stores of objects need the package obstore", "pip install obstore") from error
    from_url: Any = obstore.store.from_url
    if credentials is None:
        return from_url(address)
    host = endpoint()
    place: dict[str, Any] = {"endpoint": host, "client_options": {"allow_http": host.startswith("http://")}} if host else {}
    # One object is deleted at a time, and not every store that speaks S3 knows the request for several.
    return from_url(address, region=credentials.region, credential_provider=credentials, disable_bulk_delete=True, **place)


def credentials_for(address: str) -> Credentials | None:
    """Credentials for an address on S3; None where obstore and delta-rs find them by themselves."""
    return Credentials(address) if address.startswith("s3://") else None


class Credentials:
    """Region and credentials for S3 from the environment, profiles or roles, as the AWS tools find them; called, they are refreshed."""

    def __init__(self, address: str) -> None:
        """Raises InputError where there are none, or the package that finds them is not installed."""
        try:
            from botocore.session import get_session
        except ImportError as error:
            raise InputError(address, "", "addresses on S3 need the package botocore", "pip install botocore") from error
        self.session = get_session()
        self.region = str(self.session.get_config_variable("region") or "us-east-1")
        self._credentials = self.session.get_credentials()
        if self._credentials is None:
            remedy = "set AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY, or AWS_PROFILE"
            raise InputError(address, "", "no credentials for S3 are found", remedy)

    def __call__(self) -> dict[str, Any]:
        """The credentials of now, as obstore takes them."""
        frozen = self._credentials.get_frozen_credentials()
        until = datetime.now(UTC) + _CREDENTIALS_LIFE
        return {"access_key_id": frozen.access_key, "secret_access_key": frozen.secret_key, "token": frozen.token, "expires_at": until}


@contextlib.contextmanager
def answered(address: str, path: str = "") -> Iterator[None]:
    """Say in one line what a store refuses; what obstore says of it has twenty, with the store's own page.

    Raises:
        FileNotFoundError: there is no such object, or no such bucket.
        StoreAway: the store does not answer.
        StoreError: it refuses.
    """
    from obstore.exceptions import BaseError

    try:
        yield
    except (BaseError, FileNotFoundError) as error:
        text = str(error)
        status = re.search(r"status code: (\d+ ?[A-Za-z ]*)", text)
        code = re.search(r"<Code>(\w+)</Code>", text)
        place = f"{address}/{path}" if path else address
        if isinstance(error, FileNotFoundError) or (status and status[1].startswith("404")):
            raise FileNotFoundError(2, f"there is no such {'bucket' if code and 'Bucket' in code[1] else 'object'}", place) from error
        if "HTTP error: " in text or (status and re.match("50[0234]", status[1])):
            raise StoreAway(address, endpoint() or "its usual address") from error
        raise StoreError(place, code[1] if code else status[1].strip() if status else type(error).__name__) from error


class StoreError(LakeError, OSError):
    """What a store refuses: the address, and the store's word for it."""

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(address, reason)
        self.errno, self.reason = None, reason

    def __str__(self) -> str:
        return f"{self.args[0]}: the store refuses ({self.reason}); check the address and the credentials"


def _entry(meta: Any) -> Entry:
    return Entry(str(meta["path"]), int(meta["size"]), meta["last_modified"].timestamp())


def _tag(meta: Any) -> str:
    return json.dumps({name: meta[name] for name in ("e_tag", "version") if meta[name] is not None})


def endpoint() -> str | None:
    """The S3 endpoint that the environment names; None for Amazon's own."""
    return os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or None
