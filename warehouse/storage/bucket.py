"""The objects of a bucket as others put them there: listed by keys, of which some can be no path, and fetched as they were listed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import cached_property
from typing import Any

from warehouse.storage.objects import StoreError, answered, credentials_for, endpoint, object_store
from warehouse.storage.refusals import StoreAway

_CHUNK_BYTES = 2**20


@dataclasses.dataclass(frozen=True, slots=True)
class Object:
    """An object: key, size [B], time of its put [s since the epoch], and ETag without quotes."""

    key: str
    size: int
    modified: float
    tag: str


class Bucket:
    """A bucket at `s3://bucket`, `gs://bucket` or `az://container`. Raises StoreAway, StoreError and FileNotFoundError."""

    def __init__(self, address: str) -> None:
        self.address = address

    @cached_property
    def _credentials(self) -> Any:
        return credentials_for(self.address)

    @cached_property
    def _store(self) -> Any:
        return object_store(self.address, self._credentials)

    def object(self, key: str) -> Object | None:
        """The object of a key; None when there is none."""
        store = self._store
        try:
            with answered(self.address, key):
                return _object(store.head(key))
        except FileNotFoundError:
            return None

    def objects(self, folder: str) -> Iterator[Object]:
        """Every object below a folder ("" is all of the bucket), in the order of keys."""
        if self._credentials is not None:
            yield from self._listed_by_key(folder)
            return
        store = self._store
        with answered(self.address, folder):
            for page in store.list(folder or None):
                yield from map(_object, page)

    def _listed_by_key(self, folder: str) -> Iterator[Object]:
        # obstore gives up a listing at the first key with an empty or .. part, of which anybody may have put one.
        from botocore.exceptions import ClientError, HTTPClientError
        from botocore.exceptions import ConnectionError as Unconnected

        head = f"{folder}/" if folder else ""
        client = self._credentials.session.create_client("s3", endpoint_url=endpoint(), region_name=self._credentials.region)
        try:
            for page in client.get_paginator("list_objects_v2").paginate(Bucket=self.address.rpartition("/")[2], Prefix=head):
                for row in page.get("Contents", []):
                    yield Object(row["Key"], int(row["Size"]), row["LastModified"].timestamp(), row["ETag"].strip('"'))
        except (Unconnected, HTTPClientError) as error:
            raise StoreAway(self.address, endpoint() or "Amazon S3") from error
        except ClientError as error:
            raise StoreError(self.address, error.response.get("Error", {}).get("Code", "") or type(error).__name__) from error

    def chunks(self, entry: Object) -> Iterator[bytes]:
        """The bytes of an object as it was listed; StoreError where it has another ETag by now. What breaks is taken up where it broke."""
        from obstore.exceptions import PreconditionError

        store = self._store
        with answered(self.address, entry.key):
            try:
                for chunk in store.get(entry.key, options={"if_match": f'"{entry.tag}"'}).stream(min_chunk_size=_CHUNK_BYTES):
                    yield bytes(chunk)
            except PreconditionError as error:
                raise StoreError(f"{self.address}/{entry.key}", "changed since it was listed") from error


def _object(meta: Any) -> Object:
    return Object(str(meta["path"]), int(meta["size"]), meta["last_modified"].timestamp(), str(meta["e_tag"] or "").strip('"'))
