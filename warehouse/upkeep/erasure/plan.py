"""What an erasure is about, kept in `erasure.json` while it is under way: whoever is killed leaves the rest to the next."""

from __future__ import annotations

import dataclasses
import json
from datetime import datetime

from schemas.errors import InputError
from schemas.parsing import json_value
from warehouse.storage.files import Storage
from warehouse.upkeep.erasure.traces import Traces

PATH = "erasure.json"


@dataclasses.dataclass(frozen=True)
class ErasurePlan:
    """An erasure under way.

    `started_at`: beginning of the first attempt. `blobs`, `assets`, `releases`: those that name the scene.
    `last`: id of the last snapshot at the first attempt, which stays; 0 if the lake had none, None if an earlier version
    wrote the plan. Without it a repetition would take the snapshot that this very erasure added for the last one, and drop
    the one before.
    """

    scene_id: str
    started_at: datetime
    traces: Traces
    blobs: frozenset[str]
    assets: frozenset[str]
    releases: frozenset[str]
    last: int | None = None

    def __or__(self, other: ErasurePlan) -> ErasurePlan:
        """Both, as begun by this one."""
        traces = self.traces | other.traces
        blobs, assets, releases = self.blobs | other.blobs, self.assets | other.assets, self.releases | other.releases
        return dataclasses.replace(self, traces=traces, blobs=blobs, assets=assets, releases=releases)

    def write(self, storage: Storage) -> None:
        """Keep the plan in the lake."""
        fields = {
            "scene_id": self.scene_id, "started_at": self.started_at.isoformat(),
            "names": sorted(self.traces.names), "spared": sorted(self.traces.spared),
            "blobs": sorted(self.blobs), "assets": sorted(self.assets), "releases": sorted(self.releases), "last": self.last,
        }  # fmt: skip
        storage.write(PATH, json.dumps(fields).encode())


def read_plan(storage: Storage) -> ErasurePlan | None:
    """The erasure that was begun and not finished; None when there is none.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        data = storage.read(PATH)
    except FileNotFoundError:
        return None
    try:
        fields = json_value(data)
        if not isinstance(fields, dict):
            raise TypeError(fields)
        last = fields.get("last")  # an earlier version wrote none
        if not isinstance(last, int | None):
            raise TypeError(last)
        sets = {name: frozenset(map(str, fields[name])) for name in ("names", "spared", "blobs", "assets", "releases")}
        begun = datetime.fromisoformat(fields["started_at"])
        traces = Traces(sets["names"], sets["spared"])
        return ErasurePlan(str(fields["scene_id"]), begun, traces, sets["blobs"], sets["assets"], sets["releases"], last)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{storage.address}/{PATH}", "", f"cannot be read ({type(error).__name__})", "remove it and erase again"
        ) from error
