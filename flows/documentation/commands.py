"""The page of commands in the documentation: every command with its arguments and options, as `--help` has them."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

import click

from flows.cli import EXIT_CODES, cli

_HEAD = f"""# Commands

What `--help` says of each. Written by `make pages` from the commands.

Exit codes: {", ".join(f"{code} {text}" for code, text in EXIT_CODES.items())}.

`METASCENES_LAKE` in the environment names the lake of every command that is given no `--lake`.
"""


def commands_page() -> str:
    """The page, Markdown."""
    listed = list(_commands(cli, click.Context(cli, info_name="metascenes", **cli.context_settings)))
    index = [f"| [`{path}`](#{_anchor(path)}) | {command.get_short_help_str(200)} |" for path, command, _ in listed[1:]]
    sections = [line for path, command, context in listed[1:] for line in _section(path, command, context)]
    return "\n".join([_HEAD, "| command | |", "|---|---|", *index, "", *sections])


def _commands(command: click.Command, context: click.Context) -> Iterator[tuple[str, click.Command, click.Context]]:
    """A command and those below it, each with its words and its context."""
    yield context.command_path, command, context
    if isinstance(command, click.Group):
        for name in command.list_commands(context):
            below = command.get_command(context, name)
            if below is not None:
                yield from _commands(below, click.Context(below, info_name=name, parent=context))


def _section(path: str, command: click.Command, context: click.Context) -> Iterator[str]:
    """One command: usage, help, example, options."""
    text, _, example = inspect.cleandoc(command.help or "").partition("Example: ")
    usage = " ".join([path, *command.collect_usage_pieces(context)])
    yield from (f"## `{path}`", "", _prose(text.strip()), "", "```", usage, "", example.strip(), "```", "")
    records = [option.get_help_record(context) for option in command.get_params(context) if "--help" not in option.opts]
    rows = [
        f"| `{names.replace('|', _PIPE)}` | {_prose(' '.join(text.split())).replace('|', _PIPE)} |" for names, text in filter(None, records)
    ]
    if rows:
        yield from ("| option | |", "|---|---|", *rows, "")


_PIPE = "\\|"


def _prose(text: str) -> str:
    """Text of a command as Markdown: what stands outside of code means itself."""
    parts = text.split("`")
    return "`".join(part if i % 2 else part.replace("<", "&lt;").replace("*", "\\*") for i, part in enumerate(parts))


def _anchor(path: str) -> str:
    return path.replace(" ", "-")
