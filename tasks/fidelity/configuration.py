"""How fidelity is measured."""

from __future__ import annotations

import dataclasses

from tasks.settings import Config, Count, NonNegative, Positive


@dataclasses.dataclass(frozen=True)
class FidelityConfig(Config):
    """How scan and replica are sampled, seen and rendered."""

    object_samples_per_m2: Positive = 1000.0  # a point every 3 cm: a chair has 1,500, so that its shares are known to about 1 percent
    room_samples_per_m2: Positive = 200.0  # a point every 7 cm: floor and walls are large, and flat
    min_samples: Count = 300  # of the smallest object; shares are known to 3 percent at worst
    max_samples: Count = 4_000  # of an object; shares are known to 1 percent at worst, more would cost time alone
    max_room_samples: Count = 20_000  # of a floor and walls of 100 m2
    label_reach_m: NonNegative = 0.01  # thinned meshes lie some millimetres beside the faces that their instances were cut from
    max_cameras: Count = 24  # of a walk; further frames show little that these do not
    picture_width: Count = 160  # an object of 5 cm still covers 6 pixels at 2 m
    max_pictures: Count = 8  # evenly among the cameras: means over 150,000 pixels
    hidden_m: NonNegative = 0.1  # as far behind scanned surface as the widest threshold; what is deeper was hidden from the cameras
    empty_margin_m: Positive = 0.05  # between scanned surface and what counts as seen empty: noise of depth and of fusion
    ceiling: bool = False  # as exports.shell.ceiling: replicas are measured as they are handed out
