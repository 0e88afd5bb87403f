"""Claims: which scenes a living run is computing, so that two runs on one lake share the work instead of repeating it.

One file per scene, held as the lease is: created only if absent, renewed while the run lives, taken over when it is
dead. A claim protects nobody's rows, the lease does that; it only says that somebody is at it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType

from warehouse.lease import LIFE_SECONDS, Hold, Holder, parsed
from warehouse.renewal import Renewal
from warehouse.staging import quoted_scene
from warehouse.storage import Storage
from warehouse.writer import new_token

FOLDER = "claims"

RENEWERS = 16
"""Claims renewed at a time. A distant store takes 0.1 s for one: thousands are then renewed well within their life."""


@dataclasses.dataclass(frozen=True)
class Claim(Holder):
    """Who computes a scene, and since when [s since the epoch]."""

    scene_id: str = ""
    since: float = 0.0


class Claims:
    """``with Claims(storage) as claims: ...``: the scenes that this run computes. Leaving gives all of them back.

    Any thread may ask. Who gets a claim looks at the scene's history once more: another run may have finished it
    between the plan and the claim.
    """

    def __init__(self, storage: Storage, life: float = LIFE_SECONDS) -> None:
        self._storage, self._life = storage, life
        self._token = ""
        self._holds: dict[str, Hold] = {}
        self._lost: set[str] = set()
        self._lock = threading.Lock()
        self._renewal = Renewal("claims", self._renew, life / 3)

    def __enter__(self) -> Claims:
        self._token = new_token()
        self._renewal.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._renewal.stop()
        with contextlib.ExitStack() as rest:  # every one is tried, and the last error is told
            for scene_id in list(self._holds):
                rest.callback(self.release, scene_id)

    def claim(self, scene_id: str) -> bool:
        """Whether the scene is ours now: nobody had it, its holder is dead, or it was ours before. Never waits.

        False says that a living run had it in this moment, which may give it back unfinished: look again later.
        """
        with self._lock:
            hold = self._holds.get(scene_id)
            if hold is not None and hold.is_held and not hold.is_older_than(self._life):
                return True
            facts = {"scene_id": scene_id, "since": time.time()}
            hold = Hold(self._storage, path_of(scene_id), self._token, self._life, facts)
            if not hold.take():
                return False
            self._holds[scene_id] = hold
            self._lost.discard(scene_id)
            return True

    def release(self, scene_id: str) -> None:
        """Give a scene back: it is done, or left to others. One that is not ours is no error."""
        with self._lock:
            hold = self._holds.pop(scene_id, None)
        if hold is not None:
            hold.give_back()

    def held(self) -> set[str]:
        """The scenes that are ours: those whose claim was taken or renewed within its life."""
        with self._lock:
            return {scene for scene, hold in self._holds.items() if hold.is_held and not hold.is_older_than(self._life)}

    def lost(self) -> set[str]:
        """The scenes whose claim is somebody else's by now, or was removed, since the last claim of them.

        This happens to a run that was stopped, or cut off from the storage, for longer than a claim lives.
        """
        with self._lock:
            return set(self._lost)

    def _renew(self) -> None:
        with self._lock:
            holds = dict(self._holds)
        if holds:
            with ThreadPoolExecutor(min(RENEWERS, len(holds)), thread_name_prefix="claims") as renewers:
                list(renewers.map(self._renew_one, holds, holds.values()))

    def _renew_one(self, scene_id: str, hold: Hold) -> None:
        # The storage may be back at the next renewal; if not, others take the scene over when the claim runs out.
        with contextlib.suppress(Exception):
            if not hold.renew():
                self._lose(scene_id, hold)

    def _lose(self, scene_id: str, hold: Hold) -> None:
        with self._lock:
            if self._holds.get(scene_id) is hold:  # not released meanwhile
                del self._holds[scene_id]
                self._lost.add(scene_id)


def claims_of(storage: Storage) -> dict[str, Claim]:
    """The claims of living runs by scene, of whatever process. Reading takes part in nothing."""
    found = {claim.scene_id: claim for _, claim in _claims(storage) if not claim.is_gone}
    return dict(sorted(found.items()))


def dead_claims(storage: Storage) -> dict[str, Claim]:
    """The claims of dead runs by file. The next run that wants the scene takes it over; a sweep removes them."""
    return {path: claim for path, claim in _claims(storage) if claim.is_gone}


def sweep_claims(storage: Storage) -> None:
    """Remove the claims of dead runs."""
    for path, claim in dead_claims(storage).items():
        # Taken over before it goes: whoever wants the scene in this moment gets it before or after, never half.
        hold = Hold(storage, path, new_token(), LIFE_SECONDS, {"scene_id": claim.scene_id, "since": time.time()})
        if hold.take():
            hold.give_back()


def remove_claim(storage: Storage, scene_id: str) -> None:
    """Take a scene's claim away, whoever holds it: that run finds it among its lost ones."""
    storage.remove(path_of(scene_id))


def path_of(scene_id: str) -> str:
    """The file of a scene's claim."""
    return f"{FOLDER}/{quoted_scene(scene_id)}.json"


def _claims(storage: Storage) -> list[tuple[str, Claim]]:
    """All claims that can be read, by file. Others are none of the lake's."""
    found = []
    for name in storage.names(FOLDER):
        path = f"{FOLDER}/{name}"
        read = storage.read_tagged(path)  # None: given back meanwhile
        holder = parsed(read[0]) if read is not None else None
        if read is None or holder is None:
            continue
        with contextlib.suppress(ValueError, KeyError, TypeError):
            fields = json.loads(read[0])
            claim = Claim(**dataclasses.asdict(holder), scene_id=str(fields["scene_id"]), since=float(fields["since"]))
            if path == path_of(claim.scene_id):
                found.append((path, claim))
    return found
