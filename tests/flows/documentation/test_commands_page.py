"""The page of commands, held against what the commands print when they are asked for help."""

from __future__ import annotations

import re

import pytest
from click.testing import CliRunner

from flows.cli import cli
from flows.documentation.commands import commands_page
from tests.conftest import REPOSITORY
from tests.flows.commands.test_commands import every_command


def sections() -> dict[str, str]:
    """The page's sections by command."""
    return {part.partition("`")[0]: part for part in re.split(r"(?m)^## `", commands_page())[1:]}


def words(text: str) -> list[str]:
    """Words of a text without what Markdown needs."""
    return re.findall(r"[\w.]+", text.replace("&lt;", "<"))


def test_the_page_is_what_the_commands_say() -> None:
    assert (REPOSITORY / "docs" / "commands.md").read_text() == commands_page(), "write it with: make golden"


def test_the_page_has_every_command_once_and_in_order() -> None:
    page = commands_page()
    names = [" ".join(("metascenes", *command)) for command in every_command() if command]
    assert sections().keys() == set(names)
    assert re.findall(r"(?m)^\| \[`([^`]+)`\]\(#\S+\)", page) == re.findall(r"(?m)^## `([^`]+)`", page)
    assert re.findall(r"\(#(\S+)\)", page) == [name.replace(" ", "-") for name in re.findall(r"(?m)^## `([^`]+)`", page)]


@pytest.mark.parametrize("command", [command for command in every_command() if command], ids=" ".join)
def test_a_section_says_what_help_says(command: tuple[str, ...]) -> None:
    shown = CliRunner().invoke(cli, [*command, "--help"], prog_name="metascenes", terminal_width=1000).output
    section = sections()[" ".join(("metascenes", *command))]
    usage, _, rest = shown.removeprefix("Usage: ").partition("\n")
    assert f"\n{usage}\n" in section
    text, _, listed = rest.partition("\nOptions:\n")
    assert set(words(text)) <= {*words(section), "Example"}
    rows = [line for line in section.splitlines() if line.startswith("| `--")]
    before_help = re.split(r"\s(?:-h, )?--help\s", listed)[0]  # click keeps the names under which help was asked for first
    assert [word for row in rows for word in words(row)] == words(before_help)
