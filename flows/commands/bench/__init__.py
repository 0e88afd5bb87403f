"""`metascenes bench`: what our claims about quality and speed rest on, measured again on any machine."""

from __future__ import annotations

import os
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import click
from click.core import ParameterSource

from flows.commands.bench.acting import policy, robot
from flows.commands.bench.capturing import capture
from flows.commands.bench.comparing import files
from flows.commands.bench.drawing import synthesis
from flows.commands.bench.furnished import rooms
from flows.commands.bench.matching import alignment, selection
from flows.commands.bench.measurement import chosen_words, listed_numbers, processes_option, run_measurement
from flows.commands.bench.modeling import models
from flows.commands.options import json_option
from schemas.errors import InputError

METHODS = ("paper", "released", "default")

_OPTIONS = {"rooms": "--rooms", "address": "--lake", "moves_only": "--moves-only"}


@click.group("bench", short_help="Measure quality and speed on this machine.")
def command() -> None:
    """Measure quality and speed on this machine, from a checkout of the project.

    Example: metascenes bench optimization --rooms 5
    """
    if find_spec("bench") is None or find_spec("bench.machine") is None:
        raise InputError("metascenes bench", "", "is not part of the installed package", "run it in a checkout of the project")


command.add_command(alignment)
command.add_command(capture)
command.add_command(files)
command.add_command(models)
command.add_command(policy)
command.add_command(robot)
command.add_command(rooms)
command.add_command(selection)
command.add_command(synthesis)


@command.command("optimization")
@click.option("--rooms", type=click.IntRange(1, 10_000), default=50, show_default=True, help="Generated rooms, with objects out of place.")
@click.option("--lake", "address", metavar="ADDRESS", help="Measure the scenes of this lake instead of generated rooms.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same rooms and moves.")
@click.option("--methods", default=",".join(METHODS), show_default=True, help="Methods, with commas between.")
@click.option("--moves-only", is_flag=True, help="Time Algorithm 1 per move, and nothing else.")
@processes_option
@json_option
def optimization(rooms: int, address: str | None, seed: int, methods: str, moves_only: bool, processes: int, as_json: bool) -> None:
    """Measure the optimization: rooms before and after each method, side by side, and how long it takes.

    Rooms are furnished by the generator, then disturbed by a rule that no method knows. `drawn` is a room before that,
    `input` after it.

    The exit code is 1 when a goal is missed, 2 when nothing could be measured, and else 0.

    Example: metascenes bench optimization --rooms 5
    """
    context = click.get_current_context()
    for option, other in (("rooms", "address"), ("moves_only", "rooms"), ("moves_only", "address")):
        if all(context.get_parameter_source(name) == ParameterSource.COMMANDLINE for name in (option, other)):
            raise click.UsageError(f"{_OPTIONS[option]} together with {_OPTIONS[other]}: only one of them can be measured; leave one out")
    from bench.optimization import BenchConfig, run_bench, steps_of
    from bench.optimization.tables import print_report

    config = BenchConfig(
        methods=chosen_words(methods, METHODS, "--methods"),
        rooms=rooms,
        seed=seed,
        lake=address,
        moves_only=moves_only,
        processes=processes,
    )
    run_measurement("measured", steps_of(config), partial(run_bench, config), print_report, as_json)


@command.command("exports")
@click.option("--rooms", type=click.IntRange(1, 10_000), default=20, show_default=True, help="Generated rooms.")
@click.option("--episodes", type=click.IntRange(1, 1000), default=20, show_default=True, help="Episodes per room, for the gates to replay.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same rooms.")
@processes_option
@json_option
def exports(rooms: int, episodes: int, seed: int, processes: int, as_json: bool) -> None:
    """Measure the exports: rooms in every format, through every gate, and simulated by nothing but their files.

    What MuJoCo makes of the MJCF, and of the USD by a reader that had no part in writing it, is held against the certificates.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench exports --rooms 5
    """
    from bench.exports import ExportsBench, print_exports, run_exports_bench

    run_measurement("exported", rooms, partial(run_exports_bench, ExportsBench(rooms, seed, processes, episodes)), print_exports, as_json)


@command.command("engines")
@click.option(
    "--engine",
    "named",
    multiple=True,
    metavar="NAME=PYTHON",
    help="Interpreter of pybullet, ovphysx or newton; METASCENES_<NAME>_PYTHON by default. May be repeated.",
)
@click.option("--demo", type=click.IntRange(0, 100), default=3, show_default=True, help="Scenes of the demo.")
@click.option("--rooms", type=click.IntRange(0, 10_000), default=10, show_default=True, help="Generated rooms.")
@click.option(
    "--realdata",
    type=click.Path(path_type=Path, file_okay=False),
    envvar="METASCENES_REALDATA",
    help="Folder with the AWS small house and its models, which is measured, too.",
)
@click.option("--lake", "address", metavar="ADDRESS", help="Measure the scenes of this lake, too.")
@click.option(
    "--folder",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("engines"),
    show_default=True,
    help="Where lakes and exports are made; what has not changed is not made again.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same scenes.")
@click.option("--processes", type=click.IntRange(1, 256), default=os.cpu_count() or 1, show_default="one per core", help="Engines at once.")
@json_option
def engines(named: tuple[str, ...], demo: int, rooms: int, realdata: Path | None, address: str | None, folder: Path, seed: int,
            processes: int, as_json: bool) -> None:  # fmt: skip
    """Measure exported scenes in other physics engines, each by its own reader: what stays, and who contradicts the certificates.

    MuJoCo reads the MJCF, PyBullet the URDF, PhysX and Newton the USD. Every free object is left alone for 2 s, and again after
    nudges of 0.05 m/s along +x, -x, +y and -y. Engines other than MuJoCo want environments of their own; those that are not
    installed are named in the table.

    The exit code is 1 when a goal is missed, 2 when nothing could be measured, and else 0.

    Example: metascenes bench engines --rooms 2 --engine pybullet=engines/pybullet/bin/python
    """
    if not (demo or rooms or realdata or address):
        raise click.UsageError("--demo 0 together with --rooms 0: no scene is left; give one of them, --realdata or --lake")
    from bench.engines.report import EnginesBench, run_engines_bench, scenes_of
    from bench.engines.scenes import SceneChoice
    from bench.engines.setups import interpreters
    from bench.engines.tables import print_engines
    from flows.progress import Progress

    config = EnginesBench(SceneChoice(folder.resolve(), demo, rooms, realdata, address, seed, processes), interpreters(named))
    with Progress("exported", config.scenes.steps) as progress:
        scenes = scenes_of(config, progress.advance)
    run_measurement("simulated", len(scenes) * len(config.setups), partial(run_engines_bench, config, scenes), print_engines, as_json)


@command.command("navigation")
@click.option("--rooms", type=click.IntRange(1, 10_000), default=10, show_default=True, help="Generated rooms.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same rooms.")
@processes_option
@json_option
def navigation(rooms: int, seed: int, processes: int, as_json: bool) -> None:
    """Measure navigation: path finders against each other, against a plain visibility graph, and episodes replayed.

    The path finder `recast` is measured where `make native` has built it.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench navigation --rooms 3
    """
    from bench.navigation import NavigationBench, print_navigation, run_navigation_bench

    run_measurement("measured", rooms, partial(run_navigation_bench, NavigationBench(rooms, seed, processes)), print_navigation, as_json)


@command.command("colliders")
@click.option("--library", metavar="FOLDER", help="Measure the assets of this folder of GLB files as well.")
@click.option("--models", type=click.IntRange(1, 1000), default=2, show_default=True, help="Models of the generator per category.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same models.")
@json_option
def colliders(library: str | None, models: int, seed: int, as_json: bool) -> None:
    """Measure colliders: rays from six sides at every asset, which may stop in no opening of it and pass by no part of it.

    The exit code is 1 when a goal is missed, and else 0.

    Example: metascenes bench colliders --library assets
    """
    from bench.colliders import CollidersBench, print_colliders, run_colliders_bench, steps_of

    config = CollidersBench(library, models, seed)
    run_measurement("measured", steps_of(config), partial(run_colliders_bench, config), print_colliders, as_json)


@command.command("warehouse")
@click.option(
    "--scale", "scenes", type=click.IntRange(100), default=100_000, show_default=True,
    help="Scenes of the largest generated lake, 40 objects each; a tenth and a hundredth are measured beside it.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same lake.")
@click.option("--runs", type=click.IntRange(2, 100), default=5, show_default=True, help="Runs of every question after the first.")
@click.option("--parts", default="", help="Measure only these, with commas between: answers, volumes, growth, contention, refusals.")
@json_option
def warehouse(scenes: int, seed: int, runs: int, parts: str, as_json: bool) -> None:
    """Measure the warehouse: how long a large lake takes to answer and to change, what contention does to it, and what it refuses.

    The lakes are generated once and kept in the cache of this machine (METASCENES_CACHE): 100,000 scenes take 5.5 GB and ten
    minutes on two cores. Questions are asked by a process of its own on two cores. The box plot is compared with pandas.

    The exit code is 1 when a goal is missed, 2 when nothing could be measured, and else 0.

    Example: metascenes bench warehouse --scale 1000
    """
    from bench.warehouse.report import PARTS, WarehouseBench, run_warehouse_bench, steps_of
    from bench.warehouse.tables import print_warehouse

    config = WarehouseBench(scenes=scenes, seed=seed, runs=runs, parts=chosen_words(parts, PARTS, "--parts"))
    run_measurement("measured", steps_of(config), partial(run_warehouse_bench, config), print_warehouse, as_json)


@command.command("flows")
@click.option("--scenes", default="10,100,1000", show_default=True, help="Numbers of small scenes to run, with commas between.")
@click.option("--runners", default="pool,processes,dask", show_default=True, help="Runners to compare, with commas between.")
@click.option("--workers", type=click.IntRange(1, 256), default=2, show_default=True, help="Worker processes of every run.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same scenes and kills.")
@click.option("--parts", default="", help="Measure only these, with commas between: startup, overhead, scene, speed, sharing, chaos.")
@click.option("--speed-scenes", type=click.IntRange(4), default=100, show_default=True, help="Scenes for one worker on one core, and two.")
@click.option("--speed-rooms", type=click.IntRange(2), default=6, show_default=True, help="Rooms of about 25 objects for them.")
@click.option("--chaos-scenes", type=click.IntRange(1), default=50, show_default=True, help="Scenes of the run that is disturbed.")
@click.option("--kills", type=click.IntRange(0), default=12, show_default=True, help="How many times something is killed in it.")
@json_option
def flows(scenes: str, runners: str, workers: int, seed: int, parts: str, speed_scenes: int, speed_rooms: int, chaos_scenes: int,
          kills: int, as_json: bool) -> None:  # fmt: skip
    """Measure the flows: what orchestration costs, one warm scene, two workers beside one on one core, memory, two runs at once, and chaos.

    Small scenes are run by `metascenes run` as anybody would; all seven stages of one take about half a second. Chaos kills
    workers, runs, the Prefect server and its PostgreSQL at random, and needs PostgreSQL's programs (Debian: postgresql).

    The exit code is 1 when a goal is missed, 2 when nothing could be measured, and else 0.

    Example: metascenes bench flows --scenes 10,100 --runners pool
    """
    from bench.flows.report import PARTS, RUNNERS, FlowsBench, run_flows_bench, steps_of
    from bench.flows.tables import print_flows

    config = FlowsBench(
        scenes=listed_numbers(scenes, "--scenes"), runners=chosen_words(runners, RUNNERS, "--runners"), workers=workers, seed=seed,
        parts=chosen_words(parts, PARTS, "--parts"), speed_scenes=speed_scenes, speed_rooms=speed_rooms,
        chaos_scenes=chaos_scenes, kills=kills,
    )  # fmt: skip
    run_measurement("measured", steps_of(config), partial(run_flows_bench, config), print_flows, as_json)


@command.command("scale")
@click.option("--objects", default="100,300,1000", show_default=True, help="Numbers of objects in one scene, with commas between.")
@click.option("--scenes", default="30,100,300", show_default=True, help="Numbers of near-empty scenes, with commas between.")
@click.option("--requests", metavar="NUMBERS", help="Numbers of near-empty scenes whose requests to a store of objects are counted.")
@click.option("--held", metavar="NUMBERS", help="Numbers of generated scenes in a lake to which near-empty ones are added.")
@click.option(
    "--project", type=click.IntRange(1), metavar="SCENES", help="What so many near-empty scenes would take; needs two --requests."
)
@click.option(
    "--usd",
    "prices",
    type=float,
    nargs=4,
    default=(0.04, 0.005, 0.0004, 0.023),
    show_default=True,
    help="Prices for --project: an hour of a core, a thousand puts, a thousand gets, a GB for a month.",
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same scenes.")
@json_option
def scale(
    objects: str,
    scenes: str,
    requests: str | None,
    held: str | None,
    project: int | None,
    prices: tuple[float, float, float, float],
    seed: int,
    as_json: bool,
) -> None:
    """Measure what grows with the objects of a scene and with the number of scenes: seconds and memory of every stage, and bytes.

    With three sizes or more, the power of the size is told that a stage's processor seconds grow with. Every stage does its own work,
    on little, as in `metascenes bench flows`; a thousand objects take about ten minutes of a processor.

    The exit code is 1 when something grows faster than linearly, 2 when a size did not go through, and else 0.

    Example: metascenes bench scale --objects 10,30,100 --scenes 3,10,30
    """
    from bench.flows.projection import Prices
    from bench.flows.scale import ScaleBench, run_scale_bench
    from bench.flows.tables import print_scale
    from flows.run.fanout.committer import MANY_SCENES

    counted = listed_numbers(requests, "--requests") if requests else ()
    if project is not None and len(set(counted)) < 2:
        raise click.BadParameter(
            "needs two numbers of --requests, to tell what a commit asks from what its scenes add", param_hint="--project"
        )
    if max(counted, default=0) > MANY_SCENES:  # a second commit would be taken for what scenes add
        raise click.BadParameter(f"takes no more than {MANY_SCENES}, as many as one commit does", param_hint="--requests")
    numbers = listed_numbers(objects, "--objects"), listed_numbers(scenes, "--scenes")
    holding = listed_numbers(held, "--held") if held else ()
    config = ScaleBench(*numbers, counted, holding, seed, project, Prices(*prices))
    steps = len(config.objects) + len(config.scenes) + len(config.requests) + len(config.held)
    run_measurement("measured", steps, partial(run_scale_bench, config), print_scale, as_json)


@command.command("view")
@click.option("--lake", "address", metavar="ADDRESS", help="Open the first scene of this lake instead of a generated one.")
@click.option("--pages", type=click.IntRange(1, 1000), default=5, show_default=True, help="How often it is opened, with an empty cache.")
@click.option("--annotate", is_flag=True, help="The annotation page instead: also until a drag is kept, and until an object settles.")
@json_option
def view(address: str | None, pages: int, annotate: bool, as_json: bool) -> None:
    """Measure the viewer in headless chromium, without a GPU: 200,000 points and 40 objects, until they are seen whole.

    Example: metascenes bench view
    """
    from bench.annotating import print_annotating_report, run_annotating_bench
    from bench.viewer import ViewerBench, print_viewer_report, run_viewer_bench

    run, show = (run_annotating_bench, print_annotating_report) if annotate else (run_viewer_bench, print_viewer_report)
    run_measurement("pages", pages, partial(run, ViewerBench(address, pages=pages)), show, as_json)


@command.command("chaos")
@click.option("--kills", type=click.IntRange(1), default=1000, show_default=True, help="Stop after so many kills.")
@click.option("--minutes", type=click.FloatRange(min=0), default=120.0, show_default=True, help="Begin no batch after so many minutes.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="The same seed gives the same stories and kills.")
@click.option("--kinds", default="", help="Only these, with commas between: lake, writers, clock, clock writers, disk, runs, configs.")
@click.option(
    "--folder", type=click.Path(path_type=Path, file_okay=False), default=Path("chaos"), show_default=True,
    help="Where the journal is kept, from which the same command goes on.",
)  # fmt: skip
@json_option
def chaos(kills: int, minutes: float, seed: int, kinds: str, folder: Path, as_json: bool) -> None:
    """Kill whatever works on small lakes, in batches, and hold each lake against one that nobody disturbed.

    SIGKILL hits scenes' workers, commits, compactions, vacuums, releases, erasures, backups, restores and imports of annotations
    before chosen steps and at random moments; eight writers and upkeep at once; runs, their workers, and two runs of different
    settings on one lake. Clocks are wrong and jump (Debian: libfaketime), disks are full (wants root, to mount small ones).

    The exit code is 1 when a batch found a fault, 2 when a kind cannot be done here, and else 0.

    Example: metascenes bench chaos --kills 100 --minutes 10 --kinds lake,writers
    """
    from bench.kills.campaign import KINDS, Campaign, run_campaign
    from bench.kills.tables import print_campaign

    campaign = Campaign(folder, kills, minutes, seed, chosen_words(kinds, KINDS, "--kinds"))
    run_measurement("kills", kills, partial(run_campaign, campaign), print_campaign, as_json)
