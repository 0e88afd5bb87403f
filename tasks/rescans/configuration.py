"""Settings of the rescans stage."""

from __future__ import annotations

import dataclasses

from tasks.settings import Config, Count, NonNegative, Positive, Share


@dataclasses.dataclass(frozen=True)
class RegistrationConfig(Config):
    """How a scan is laid onto an earlier one of its room, and when it is another room after all."""

    yaws: Count = 72  # every 5 degrees: frames lie along walls but for oblique rooms, and ICP pulls in more than half of a step
    starts: Count = 6  # refined: a rectangle fits in two ways, a square in four, and furniture decides
    least_wall_share: Share = 0.6  # a scan that stops halfway through a room still has most of its walls in the other
    most_conflict: Share = 0.1  # doors are opened and partitions moved; a room of another size has a wall, a quarter, on bare floor
    least_object_share: Share = 0.3  # of the scan of which more fits: equal rooms share walls, not furniture, and a fifth by chance


@dataclasses.dataclass(frozen=True)
class MatchingConfig(Config):
    """Which objects of two scans are the same, and when one was moved."""

    moved_m: Positive = 0.1  # drift, voxels and what each scan saw of an object come to less; chairs at a table are moved by more
    turned_radians: Positive = 0.3  # 17 degrees: of a mug's handle, scans at 2 cm tell no less
    size_m: NonNegative = 0.08  # how much sides of the same object's box may differ: one more side seen, four voxels
    size_share: Share = 0.5  # or by this share of the longer: of a chair seen from one side half is missing
    seen_share: Share = 0.5  # of the place of an object that the other scan must have seen: below, it may still be there
    still_share: Share = 0.6  # of an object's surface that the other scan shows where no object is named: it is there, unnamed


@dataclasses.dataclass(frozen=True)
class RescansConfig(Config):
    """How scans of one room are held against each other."""

    earlier: Count = 1  # scans before it, by name, that each is held against: changes add up from one to the next
    registration: RegistrationConfig = dataclasses.field(default_factory=RegistrationConfig)
    matching: MatchingConfig = dataclasses.field(default_factory=MatchingConfig)
