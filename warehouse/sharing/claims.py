"""Claims: which scenes a living run is computing, so that two runs on one lake share the work instead of repeating it.

One held file per scene. A claim protects nobody's rows, the lease does that; it only says that somebody is at it.
"""

from __future__ import annotations

import dataclasses
import time

from warehouse.sharing.held import LIFE_SECONDS, Facts, Hold, Holder, Keeper, held_in
from warehouse.sharing.writer import new_token
from warehouse.storage.files import Storage
from warehouse.tables.staging import quoted_scene

FOLDER = "claims"


@dataclasses.dataclass(frozen=True)
class Claim(Holder):
    """Who computes a scene, and since when [s since the epoch]."""

    scene_id: str = ""
    since: float = 0.0


class Claims(Keeper):
    """``with Claims(storage) as claims: ...``: the scenes that this run computes. Leaving gives all of them back.

    Any thread may ask. Who gets a claim looks at the scene's history once more: another run may have finished it
    between the plan and the claim. A scene that is done, or left to others, is given back by `release`.
    """

    def claim(self, scene_id: str) -> bool:
        """Whether the scene is ours now: nobody had it, its holder is dead, or it was ours before. Never waits.

        False says that a living run had it in this moment, which may give it back unfinished: look again later.
        """
        return self._take(scene_id, path_of(scene_id), _facts(scene_id))

    def held(self) -> set[str]:
        """The scenes that are ours: those whose claim was taken or renewed within its life."""
        with self._lock:
            return set(filter(self._is_fresh, self._holds))

    def lost(self) -> set[str]:
        """The scenes whose claim is somebody else's by now, or was removed, since the last claim of them.

        This happens to a run that was stopped, or cut off from the storage, for longer than a claim lives.
        """
        with self._lock:
            return set(self._lost)


def claims_of(storage: Storage) -> dict[str, Claim]:
    """The claims of living runs by scene, of whatever process."""
    return dict(sorted((claim.scene_id, claim) for _, _, claim in _claims(storage) if not claim.is_gone))


def dead_claims(storage: Storage) -> dict[str, Claim]:
    """The claims of dead runs by file. The next run that wants the scene takes it over; a sweep removes them."""
    return {path: claim for path, _, claim in _claims(storage) if claim.is_gone}


def sweep_claims(storage: Storage) -> None:
    """Remove the claims of dead runs."""
    for path, claim in dead_claims(storage).items():
        # Taken over before it goes: whoever wants the scene in this moment gets it before or after, never half.
        hold = Hold(storage, path, new_token(), LIFE_SECONDS, _facts(claim.scene_id))
        if hold.take():
            hold.give_back()


def remove_claim(storage: Storage, scene_id: str) -> None:
    """Take a scene's claim away, whoever holds it: that run finds it among its lost ones."""
    storage.remove(path_of(scene_id))


def path_of(scene_id: str) -> str:
    """The file of a scene's claim."""
    return f"{FOLDER}/{quoted_scene(scene_id)}.json"


def _facts(scene_id: str) -> Facts:
    return {"scene_id": scene_id, "since": time.time()}


def _claims(storage: Storage) -> list[tuple[str, Holder, Claim]]:
    def claim(holder: Holder, facts: Facts) -> Claim:
        return Claim(**dataclasses.asdict(holder), scene_id=str(facts["scene_id"]), since=float(facts["since"]))

    return held_in(storage, FOLDER, claim, lambda claim: path_of(claim.scene_id))
