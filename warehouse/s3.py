"""A lake in an S3-compatible store: the same files as in a folder, with conditional puts in the place of locks."""

from __future__ import annotations

import contextlib
import os
import tempfile
import time
from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from schemas.errors import InputError, LakeError
from warehouse.storage import Entry
from warehouse.workplace import workplace

if TYPE_CHECKING:
    import pyarrow.fs


class S3Storage:
    """A lake at `s3://bucket/prefix`. Endpoint, region and credentials come from where the AWS tools take them."""

    def __init__(self, address: str) -> None:
        self.address = address.rstrip("/")
        self._bucket, _, self._prefix = self.address.removeprefix("s3://").partition("/")
        if not self._bucket or not self._prefix:
            raise InputError(address, "", "an S3 address needs a bucket and a prefix", "give s3://bucket/prefix")
        if any(character in self.address for character in "[]*?#%\\ "):
            raise InputError(address, "", "the lake's address holds one of [ ] * ? # % \\ or a space", "choose a prefix without them")

    def __reduce__(self) -> tuple[Any, ...]:
        return (S3Storage, (self.address,))

    @cached_property
    def _files(self) -> Any:
        return object_store(self.address)

    def read(self, path: str) -> bytes:
        """See Storage."""
        return bytes(self._files.cat_file(self.arrow_path(path)))

    def write(self, path: str, data: bytes, lasting: bool = True) -> None:
        """See Storage. A put is whole or not at all."""
        self._files.call_s3("put_object", Bucket=self._bucket, Key=self._key(path), Body=data)

    def move_in(self, file: Path, path: str) -> None:
        """See Storage. An upload in parts, which are one object when the last is there and none before."""
        self._files.put_file(str(file), self.arrow_path(path))
        file.unlink()

    def workplace(self) -> contextlib.AbstractContextManager[Path]:
        """See Storage. In the system's folder of temporary files."""
        return workplace(Path(tempfile.gettempdir()) / "metascenes")

    def create(self, path: str, data: bytes) -> bool:
        """See Storage. A put on the condition that there is no such object."""
        return self._put_if(path, data, IfNoneMatch="*")

    def exists(self, path: str) -> bool:
        """See Storage."""
        return self._head(path) is not None

    def refresh(self, path: str, seconds: float) -> bool:
        """See Storage. An object is copied onto itself."""
        try:
            head = self._files.call_s3("head_object", Bucket=self._bucket, Key=self._key(path))
            if time.time() - head["LastModified"].timestamp() > seconds:
                place = {"Bucket": self._bucket, "Key": self._key(path)}
                self._files.call_s3("copy_object", CopySource=place, MetadataDirective="REPLACE", **place)
        except FileNotFoundError:
            return False
        return True

    def remove(self, path: str) -> None:
        """See Storage."""
        self._files.call_s3("delete_object", Bucket=self._bucket, Key=self._key(path))

    def entries(self, folder: str) -> list[Entry]:
        """See Storage."""
        found = [one for one in self._listed(folder) if one["type"] == "file"]
        made = [Entry(self._relative(one["name"]), int(one["size"]), one["LastModified"].timestamp()) for one in found]
        return sorted(made, key=lambda entry: entry.path)

    def names(self, folder: str, head: str = "") -> list[str]:
        """See Storage."""
        found = self._files.find(self.arrow_path(folder), maxdepth=1, prefix=head) if head else self._listed_names(folder, "file")
        return sorted(name.rpartition("/")[2] for name in found)

    def folders(self, folder: str) -> list[str]:
        """See Storage."""
        return sorted(name.rstrip("/").rpartition("/")[2] for name in self._listed_names(folder, "directory"))

    def walk(self, folder: str) -> Iterator[Entry]:
        """See Storage."""
        for name, one in self._files.find(self.arrow_path(folder), detail=True).items():
            if one["type"] == "file":
                yield Entry(self._relative(name), int(one["size"]), one["LastModified"].timestamp())

    def read_tagged(self, path: str) -> tuple[bytes, str] | None:
        """See Storage. The tag is the object's ETag."""
        try:
            answer = self._files.call_s3("get_object", Bucket=self._bucket, Key=self._key(path))
        except FileNotFoundError:
            return None
        import fsspec.asyn

        return bytes(fsspec.asyn.sync(self._files.loop, answer["Body"].read)), str(answer["ETag"])

    def swap(self, path: str, data: bytes | None, tag: str) -> bool:
        """See Storage. A put on the condition that the object still has the tag.

        Removing has no such condition on all stores, so there it is looked up first. Only the holder of a lease
        removes it, while nobody else may touch it.
        """
        if data is not None:
            return self._put_if(path, data, IfMatch=tag)
        if self._head(path) != tag:
            return False
        self.remove(path)
        return True

    def delta_address(self, path: str) -> str:
        """See Storage."""
        return f"{self.address}/{path}"

    def delta_options(self) -> dict[str, str] | None:
        """See Storage. delta-rs does not read the AWS tools' files, so it is given what they say."""
        from botocore.session import get_session

        session = get_session()
        options = {"conditional_put": "etag", "AWS_REGION": session.get_config_variable("region") or "us-east-1"}
        credentials = session.get_credentials()
        if credentials is not None:
            frozen = credentials.get_frozen_credentials()
            named = {"AWS_ACCESS_KEY_ID": frozen.access_key, "AWS_SECRET_ACCESS_KEY": frozen.secret_key, "AWS_SESSION_TOKEN": frozen.token}
            options |= {name: value for name, value in named.items() if value}
        endpoint = _endpoint()
        if endpoint:
            options |= {"AWS_ENDPOINT_URL": endpoint, "AWS_ALLOW_HTTP": str(endpoint.startswith("http://")).lower()}
        return options

    def arrow_filesystem(self) -> pyarrow.fs.FileSystem:
        """See Storage."""
        from pyarrow.fs import FSSpecHandler, PyFileSystem

        return PyFileSystem(FSSpecHandler(self._files))

    def arrow_path(self, path: str) -> str:
        """See Storage."""
        return f"{self._bucket}/{self._key(path)}"

    def duckdb_path(self, path: str) -> str:
        """See Storage."""
        return f"{self.address}/{path}"

    def register(self, connection: Any) -> None:
        """See Storage."""
        connection.register_filesystem(self._files)

    def local_path(self, path: str) -> Path | None:
        """See Storage."""
        return None

    def _key(self, path: str) -> str:
        return f"{self._prefix}/{path}" if path else self._prefix

    def _relative(self, name: str) -> str:
        return name.removeprefix(f"{self._bucket}/{self._prefix}/")

    def _listed(self, folder: str) -> list[dict[str, Any]]:
        try:
            found = self._files.ls(self.arrow_path(folder), detail=True, refresh=True)
        except FileNotFoundError:
            return []
        return [one for one in found if one["name"].rstrip("/") != self.arrow_path(folder)]

    def _listed_names(self, folder: str, kind: str) -> list[str]:
        return [one["name"] for one in self._listed(folder) if one["type"] == kind]

    def _head(self, path: str) -> str | None:
        """ETag of an object; None when there is none."""
        try:
            return str(self._files.call_s3("head_object", Bucket=self._bucket, Key=self._key(path))["ETag"])
        except FileNotFoundError:
            return None

    def _put_if(self, path: str, data: bytes, **condition: str) -> bool:
        """Put an object on a condition; whether it held."""
        from botocore.exceptions import ClientError

        try:
            self._files.call_s3("put_object", Bucket=self._bucket, Key=self._key(path), Body=data, **condition)
        except (OSError, ClientError) as error:
            cause = error if isinstance(error, ClientError) else error.__cause__
            code = cause.response.get("Error", {}).get("Code", "") if isinstance(cause, ClientError) else ""
            # 409: another conditional put to the same object is under way; 404: it was removed meanwhile.
            refusals = ("PreconditionFailed", "ConditionalRequestConflict", "NoSuchKey", "412", "409", "404")
            if code in refusals or isinstance(error, FileNotFoundError):
                return False
            raise
        return True


def object_store(address: str) -> Any:
    """The S3-compatible store that the environment names, as an fsspec file system; `address` is for the error.

    Raises:
        InputError: the package that talks to it is not installed.
    """
    try:
        import s3fs
    except ImportError as error:
        raise InputError(address, "", "addresses on S3 need the package s3fs", "pip install s3fs") from error
    from botocore.exceptions import ConnectionError as StoreError
    from botocore.exceptions import HTTPClientError
    from fsspec.asyn import sync_wrapper

    class ObjectStore(s3fs.S3FileSystem):
        """The same, with a word of ours for a store that does not answer."""

        async def _call_s3(self, *arguments: Any, **named: Any) -> Any:
            try:
                return await super()._call_s3(*arguments, **named)
            except (StoreError, HTTPClientError) as error:
                raise StoreAway(address, _endpoint() or "Amazon S3") from error

        call_s3 = sync_wrapper(_call_s3)

    return ObjectStore(endpoint_url=_endpoint(), use_listings_cache=False)


class StoreAway(LakeError, ConnectionError):
    """A store that does not answer; it may later."""

    def __init__(self, address: str, endpoint: str) -> None:
        super().__init__(address, endpoint)
        self.errno = None  # two arguments of an OSError are taken for its number and words

    def __str__(self) -> str:
        address, endpoint = self.args
        return f"{address}: the store at {endpoint} does not answer; check AWS_ENDPOINT_URL and that it runs"


def _endpoint() -> str | None:
    """The endpoint that the environment names; None for Amazon's own."""
    return os.environ.get("AWS_ENDPOINT_URL_S3") or os.environ.get("AWS_ENDPOINT_URL") or None
