"""The command line. Commands load when they are called, so that `metascenes --help` answers at once."""

from __future__ import annotations

import contextlib
import difflib
import importlib
import os
import sys
import traceback
from typing import TYPE_CHECKING, NoReturn

import click

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

COMMANDS = {
    "demo": "Make raw scans of furnished rooms and turn them into replica scenes.",
    "run": "Turn a folder of scans into replica scenes in a lake.",
    "watch": "Turn new and changed scans into replica scenes as they arrive.",
    "scan": "Scan a furnished GLB scene with the virtual scanner.",
    "storeys": "Divide scans of several floors into a scan of each.",
    "scenes": "List the scenes of a lake: what each is, how far it has come, how much of it stands.",
    "sql": "Ask the lake a question in SQL; reads only.",
    "explain": "Say what an object, a scene, an asset, a model or a file was made from.",
    "view": "Show scenes in the browser: scan, replica, and all that is known of each object.",
    "stats": "Draw the statistics and write the report.",
    "export": "Write scenes as USD, Habitat dataset, MJCF, URDF, SDF, GLB and maps into a folder.",
    "release": "Make, list, compare and attach releases: versions that can be cited.",
    "library": "Index, list and remove libraries of models that candidates are taken from.",
    "annotate": "Ask people, take in what they chose, and have it reviewed.",
    "import": "Import finished datasets: Habitat scene datasets, the MetaScenes release.",
    "evaluate": "Measure how well agents navigate the episodes.",
    "drive": "Let a simulated cart drive the ways that policies take.",
    "train": "Train a learned system on a snapshot or release of the lake.",
    "compare": "Compare datasets of the lake by what is learned from them.",
    "models": "List, show, export, import and withdraw models.",
    "synthesize": "Draw what stands on a table, and make scenes of it that simulators load.",
    "status": "Say what is done, running, failed and stale, from the lake alone.",
    "deploy": "Schedule runs on a Prefect server, or start one with a worker.",
    "lake": "Compact, vacuum, measure, back up, restore the lake, or erase a scene from it.",
    "compile": "Compile what runs compute with, once for this machine.",
    "doctor": "Check a USD, MJCF, URDF, SDF or GLB file, a map, a Habitat dataset or the lake.",
    "bench": "Measure quality and speed on this machine.",
}
"""Commands with their first line of help, in the order of `--help`. Each lives in `flows.commands.<name>`."""

MODULES = {"import": "ingest", "train": "training.train", "models": "training.models", "compare": "training.compare"}
"""Commands whose names no module can have, or that have a folder for several, and their modules."""


class LazyGroup(click.Group):
    """A group whose commands are imported when they are used."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of the commands, in order."""
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of that name, imported now."""
        if cmd_name not in COMMANDS:
            return None
        command: click.Command = importlib.import_module(f"flows.commands.{MODULES.get(cmd_name, cmd_name)}").command
        return command

    def resolve_command(self, ctx: click.Context, args: list[str]) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that is meant by the first word; a mistyped one is told what it is near to."""
        if args and args[0] not in COMMANDS and not args[0].startswith("-") and not ctx.resilient_parsing:
            close = difflib.get_close_matches(args[0].lower(), COMMANDS, n=1)
            ctx.fail(f"No such command '{args[0]}'." + (f" Did you mean '{close[0]}'?" if close else ""))
        return super().resolve_command(ctx, args)

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Commands that a word may become, without importing them, and options."""
        from click.shell_completion import CompletionItem

        named = [CompletionItem(name, help=text) for name, text in COMMANDS.items() if name.startswith(incomplete)]
        return named + click.Command.shell_complete(self, ctx, incomplete)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """The list of commands in `--help`, without importing them."""
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


EXIT_CODES = {
    0: "done",
    1: "some scenes failed or something is not as it should be",
    2: "misuse or input that cannot be used",
    3: "a defect",
    130: "interrupted",
    141: "nobody reads on",
    143: "terminated",
}
"""What a shell or a scheduler is told at the end, of every command."""

COMPLETE = "_METASCENES_COMPLETE"
"""Names what a shell wants that completes a line: click's own protocol."""

_HELP = f"""The scene lake: scans of real rooms in, replica scenes that simulators load out.

The environment variable METASCENES_LAKE names the lake of every command that is given no --lake.

Exit codes: {", ".join(f"{code} {text}" for code, text in EXIT_CODES.items())}.

Example: metascenes run --scans ./scans --lake ./lake
"""


@click.group(cls=LazyGroup, help=_HELP, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(package_name="metascenes")
def cli() -> None:
    """All commands."""


def main() -> None:
    """Entry point. It ends with one of EXIT_CODES."""
    from flows.terminal import guarded

    # A shell that completes a line takes click's bytes as they are.
    with guarded() if COMPLETE not in os.environ else contextlib.nullcontext():
        _main()


def _main() -> None:
    from schemas.errors import LakeError
    from schemas.machine.loopback import bypass_proxies
    from schemas.machine.scratch import sweep_temporary_folders
    from schemas.text import one_line

    bypass_proxies()
    sweep_temporary_folders()
    try:
        code = cli(standalone_mode=False)  # click hands back the code of an Exit instead of raising it
        sys.stdout.flush()
        sys.exit(code if isinstance(code, int) else 0)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except click.Abort:  # what click makes of Ctrl-C
        _end(130)
    except (LakeError, UnicodeError) as error:
        _say_and_exit(one_line(error), error, 2)
    except SystemExit:
        raise
    except BaseException as error:
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":  # a library in Rust that gave up
            _end(143 if type(error).__name__ == "TerminationSignal" else 130)
        _explain(error)


def _explain(error: BaseException) -> NoReturn:
    """Say what the operating system refused, whichever library says so; everything else is a defect of ours."""
    from schemas.text import one_line
    from warehouse.storage.refusals import Refused, number_of

    number = number_of(error)
    if number is not None and not isinstance(error, ConnectionError):
        place = next((str(name) for name in (getattr(error, "filename", None), getattr(error, "filename2", None)) if name), None)
        _say_and_exit(str(Refused(place, number)) if place else one_line(error), error, 2)
    if isinstance(error, OSError):
        _say_and_exit(one_line(error), error, 2)
    _say_and_exit(f"unexpected {type(error).__name__}: {one_line(error)} (METASCENES_TRACEBACK=1 shows where)", error, 3)


def _end(code: int) -> None:
    """Leave at once: threads of Prefect's may still be at work and would be waited for. What is finished is staged."""
    from schemas.errors import LakeError

    print("interrupted; the same command goes on where this one stopped", file=sys.stderr, flush=True)
    with contextlib.suppress(LakeError, SystemExit):
        sys.stdout.flush()
    os._exit(code)


def _say_and_exit(text: str, error: BaseException, code: int) -> NoReturn:
    """One line for people, the traceback for those who ask, and an exit code that a scheduler can trust."""
    print(f"metascenes: {text}", file=sys.stderr)
    if os.environ.get("METASCENES_TRACEBACK"):
        traceback.print_exception(error)
    for each in (error, error.__cause__, error.__context__):
        if each is not None:  # at the end DuckDB complains of what is still held
            traceback.clear_frames(each.__traceback__)
    sys.exit(code)


if __name__ == "__main__":
    main()
