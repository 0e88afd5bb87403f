"""How well agents see, move and find things, measured: cameras, environments, policies that learn, and carts."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from flows.commands.bench.measurement import chosen_words, processes_option, run_measurement
from flows.commands.options import json_option


@click.command("policy")
@click.option("--rooms", type=click.IntRange(2, 10_000), default=75, show_default=True, help="Generated rooms; a fifth is held out.")
@click.option("--episodes", type=click.IntRange(2, 10_000), default=100, show_default=True, help="Of a room; a held-out one has half.")
@click.option("--seeds", type=click.IntRange(1, 100), default=3, show_default=True, help="Seeds of every training.")
@click.option("--steps", type=click.IntRange(0), default=0, help="Steps of every training; those of the system where left out.")
@click.option(
    "--variants", default="", help="Train only these, with commas between: small, sensing, dagger, blind, goalless, blind-dagger, "
    "goalless-dagger, small-dagger; the first five where left out, `none` trains nothing.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same rooms and episodes.")
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False), default=Path("policy"), show_default=True,
    help="Where rooms, models and trajectories are kept: the same command goes on.",
)  # fmt: skip
@click.option(
    "--realdata", type=click.Path(path_type=Path, file_okay=False), envvar="METASCENES_REALDATA",
    help="Folder with the AWS small house, whose pictures are timed, and in which datasets are compared.",
)  # fmt: skip
@click.option("--parts", default="", help="Measure only these, with commas between: frames, steps, loop, compared, killed.")
@processes_option
@json_option
def policy(rooms: int, episodes: int, seeds: int, steps: int, variants: str, seed: int, folder: Path, realdata: Path | None, parts: str,
           processes: int, as_json: bool) -> None:  # fmt: skip
    """Measure agents: pictures and steps per second, and how many targets policies find in rooms that they did not learn from.

    `loop`: rooms are generated, policies are trained on four fifths of them (`sensing` has depth and the pixels of its goal beside colors,
    `dagger` is corrected where it went wrong itself besides, `blind` has no pictures, `goalless` is not told what it is sent to), and act
    in the episodes of the others beside chance and the experts. Found is who stops by itself within 1 m of a view point with the target
    in view. `compared`: policies that learned from replicas of scans, from the same rooms as they were drawn, and from both, in the AWS
    small house. `killed`: a training and an evaluation end by SIGKILL, and are given again.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench policy --rooms 20 --seeds 1 --steps 500 --variants small,blind --parts loop
    """
    from bench.policy.report import PARTS, PolicyBench, run_policy_bench
    from bench.policy.tables import print_policy
    from bench.policy.trainings import USUAL, VARIANTS

    chosen: tuple[str, ...] = USUAL
    if variants.strip():
        chosen = () if variants.strip() == "none" else chosen_words(variants, tuple(VARIANTS), "--variants")
    config = PolicyBench(
        folder.resolve(), rooms, seeds, steps, chosen, seed, processes, realdata, chosen_words(parts, PARTS, "--parts"), episodes
    )  # fmt: skip
    run_measurement("measured", config.advances, partial(run_policy_bench, config), print_policy, as_json)


@click.command("robot")
@click.option("--rooms", type=click.IntRange(1, 10_000), default=20, show_default=True, help="Replicas of rooms; every other one is hard.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same rooms and runs.")
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False), default=Path("robot"), show_default=True,
    help="Where replicas and runs are kept: the same command goes on.",
)  # fmt: skip
@click.option(
    "--realdata", type=click.Path(path_type=Path, file_okay=False), envvar="METASCENES_REALDATA",
    help="Folder with the AWS small house, whose replica is driven in, too.",
)  # fmt: skip
@click.option("--parts", default="", help="Measure only these, with commas between: drives, killed.")
@processes_option
@json_option
def robot(rooms: int, seed: int, folder: Path, realdata: Path | None, parts: str, processes: int, as_json: bool) -> None:
    """Measure carts: whether they arrive on the shortest paths of episodes, what they touch, and how well they know where they are.

    Rooms are generated and scanned, every other one a dwelling that is scanned badly, and become replicas. In each, ten ways are driven
    with noise, slip and delay; then with a tenth of the small furniture moved since the scan; then three each by wheels on the floor of the
    scene exported for MuJoCo. `killed`: a drive ends by SIGKILL, and is given again.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench robot --rooms 4
    """
    from bench.robot.report import PARTS, RobotBench, run_robot_bench
    from bench.robot.tables import print_robot

    config = RobotBench(folder.resolve(), rooms, seed, processes, realdata, chosen_words(parts, PARTS, "--parts"))
    run_measurement("driven", config.advances, partial(run_robot_bench, config), print_robot, as_json)
