"""A small lake with datasets to compare: two to learn from, one to be tested in, one room of which is learned from by another name."""

from __future__ import annotations

from pathlib import Path

from tasks.navigation import split_of
from tests.tasks.simulation.acted_scenes import CONFIG, LIVING, STUDY, acted_scene, as_scene, lake_of_scenes
from warehouse.lake import Lake

SCENES = {
    "alpha/one": (LIVING, "alpha/room_a"),
    "alpha/two": (LIVING, "alpha/room_b"),
    "beta/one": (STUDY, "beta/room_d"),
    "beta/kept": (STUDY, "beta/room_c"),
    "gamma/leak": (LIVING, "gamma/room_a"),
    "gamma/one": (STUDY, "gamma/room_x"),
    "gamma/two": (LIVING, "gamma/room_f"),
}
"""Scenes: whose rows they have, and their rooms. `room_a` is learned from, whatever dataset it is in; `room_c` is a test room."""

for _, _room in SCENES.values():
    assert split_of(_room, CONFIG.test_share) == ("test" if _room.endswith("_c") else "train"), _room

QUICK = """
[comparison]
seeds = 1
scenes = 2
trajectories = 4

[evaluation]
max_steps = 20

[training.system]
kind = "navigation"
validation_share = 0.5

[training.system.model]
kind = "small"
width = 16
heads = 2
feedforward = 24
fusion_layers = 1
decoder_layers = 2
window = 4

[training.system.model.camera]
width = 16
height = 16

[training.system.model.eyes]
kind = "own"
patch = 4
part = 2
width = 8

[training.system.batch]
windows = 8

[training.system.fitting]
steps = 6
warmup_steps = 1
validate_steps = 3
checkpoint_steps = 2
record_steps = 2
device = "cpu"
"""
"""Settings with which all takes seconds, as TOML."""


def compared_lake(folder: Path) -> Lake:
    """The lake, committed."""
    return lake_of_scenes(folder, {name: as_scene(acted_scene(of), name, room) for name, (of, room) in SCENES.items()})
