"""What strangers read: the README keeps short, links lead somewhere, and command lines are such that the command line takes them."""

from __future__ import annotations

import re
import shlex
import unicodedata
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import unquote

import click
import pytest

from flows.cli import cli
from tests.conftest import REPOSITORY

README = REPOSITORY / "README.md"
ROOT_PAGES = ("README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "SECURITY.md", "GLOSSARY.md")
PAGES = [page for name in ROOT_PAGES if (page := REPOSITORY / name).is_file()] + sorted((REPOSITORY / "docs").glob("*.md"))
MAX_LINES, MAX_WORDS, MAX_CELL = 150, 1800, 150
MAX_PICTURE_BYTES = 1_500_000
RUN_AS_A_WHOLE = {"CONTRIBUTING.md"}
"""Its commands name what its recipes add; `test_recipes.py` runs them."""

FENCE = re.compile(r"^(?P<fence>```+)(?P<language>\w*)[^\n]*\n(?P<block>.*?)^(?P=fence)$", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"(?P<picture>!?)\[(?:[^\[\]]|\[[^\]]*\])*\]\((?P<target>[^()\s]+)\)")
CELLS = re.compile(r"(?<!\\)\|")
PLACEHOLDERS = {"...", "<command>"}
USAGE = ("[OPTIONS]", "[ARGS]...")
"""Ends of lines that say what a command takes, in the generated page of commands."""


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return FENCE.sub("", page.read_text())


def anchors(page: Path) -> set[str]:
    """Anchors of a page's headings, as GitHub and Python-Markdown make them of text in ASCII; the second of a name ends with -1."""
    found: set[str] = set()
    for heading in re.findall(r"^#{1,6} +(.+?) *#*$", prose(page), re.MULTILINE):
        text = LINK.sub(lambda link: link[0].split("](")[0].lstrip("!["), heading)
        kept = "".join(letter for letter in text.lower() if letter in " -_" or unicodedata.category(letter)[0] in "LN")
        name = anchor = kept.strip().replace(" ", "-")
        count = 0
        while anchor in found:
            count += 1
            anchor = f"{name}-{count}"
        found.add(anchor)
    return found


def problem_of(page: Path, target: str) -> str | None:
    """What is wrong with a link of a page; None where nothing is."""
    if re.match(r"(https?|mailto):", target):
        return None
    path, _, anchor = target.partition("#")
    file = (page.parent / unquote(path)).resolve() if path else page
    if not file.is_relative_to(REPOSITORY):
        return "leaves the repository"
    if not file.exists():
        return "leads to no file"
    return f"{file.name} has no heading for it" if anchor and anchor not in anchors(file) else None


def commands_of(page: Path) -> Iterator[list[str]]:
    """Words of every `metascenes` command line in a page's blocks of code and between its single backquotes."""
    text = page.read_text()
    lines = [line for match in FENCE.finditer(text) for line in match["block"].replace("\\\n", " ").splitlines()]
    inline = re.findall(r"(?<!`)`(metascenes [^`\n]+)`(?!`)", FENCE.sub("", text))
    for line in [*lines, *(part.replace("\\|", "|") for part in inline)]:
        start = re.match(r"(?:\$ |[A-Z_]+=\S+ )*(metascenes\b.*)", line.strip())
        if start and not line.endswith(USAGE):
            yield words_of(start[1])


def words_of(line: str) -> list[str]:
    """Words of one command: without its comment, and what a shell would hand on to another command or file."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars="|;&>")
    lexer.whitespace_split = True
    words = []
    for word in lexer:
        if set(word) <= set("|;&>"):
            break
        words.append(word)
    return words


def refusal(words: list[str]) -> str | None:
    """Why the command line would refuse these words before it does anything; None where it takes them."""
    group: click.Command = cli
    context = click.Context(cli, info_name="metascenes", **cli.context_settings)
    rest = words[1:]
    while isinstance(group, click.Group) and rest and not rest[0].startswith("-"):
        inner = group.get_command(context, rest[0])
        if inner is None:
            return f"no command {rest[0]}"
        group, rest = inner, rest[1:]
        context = click.Context(group, parent=context, info_name=group.name)
    given = [word for word in rest if word not in PLACEHOLDERS]
    if isinstance(group, click.Group):  # its name alone, as in prose
        return None if given in ([], ["--help"], ["--version"]) else f"{group.name} does not take {given}"
    options: dict[str, click.Option | None] = dict.fromkeys(group.get_help_option_names(context))
    for option in group.params:
        if isinstance(option, click.Option):
            options |= dict.fromkeys((*option.opts, *option.secondary_opts), option)
    values = 0
    for word in given:
        if values:
            values -= 1
        elif word.startswith("--"):
            name, has_value = word.split("=")[0], "=" in word
            if name not in options:
                return f"{' '.join(words[:2])} has no option {name}"
            known = options[name]
            values = 0 if known is None or known.is_flag or has_value else known.nargs
    return None


def complaint(words: list[str]) -> str | None:
    """Why the command line refuses a whole command, values and arguments included; None where it takes it. Nothing is done."""
    group: click.Command = cli
    context, rest = click.Context(cli, info_name="metascenes", **cli.context_settings), words[1:]
    try:
        while isinstance(group, click.Group):
            name, inner, rest = group.resolve_command(context, rest)
            assert inner is not None
            group, context = inner, click.Context(inner, parent=context, info_name=name)
        group.make_context(context.info_name, rest, parent=context.parent)
    except click.exceptions.Exit:  # --help
        return None
    except click.ClickException as error:
        return error.format_message()
    return None


def test_the_readme_is_short() -> None:
    text = README.read_text()
    assert len(text.splitlines()) <= MAX_LINES
    assert len(text.split()) <= MAX_WORDS
    rows = [line for line in prose(README).splitlines() if line.startswith("|")]
    assert rows
    assert [cell for row in rows for cell in CELLS.split(row) if len(cell.strip()) > MAX_CELL] == []


def test_the_rows_of_a_table_have_as_many_cells_as_its_head() -> None:
    wrong = []
    for page in PAGES:
        width = 0
        for line in prose(page).splitlines():
            cells = len(CELLS.split(line)) if line.startswith("|") else 0
            if cells and width and cells != width:
                wrong.append(f"{page.name}: {line[:80]}")
            width = (width or cells) if cells else 0
    assert wrong == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_somewhere(page: Path) -> None:
    targets = [link["target"] for link in LINK.finditer(prose(page))]
    assert [f"{target}: {problem}" for target in targets if (problem := problem_of(page, target))] == []


def test_every_page_is_reached_from_the_readme() -> None:
    reached, ahead = set(), [README]
    while ahead:
        page = ahead.pop()
        if page not in reached and page.is_file() and page.suffix == ".md":
            reached.add(page)
            targets = (link["target"].partition("#")[0] for link in LINK.finditer(prose(page)))
            ahead += [(page.parent / target).resolve() for target in targets if target and "://" not in target]
    assert set(PAGES) <= reached


def test_pictures_are_light_and_shown() -> None:
    """Every picture beside the pages is on one of them."""
    pictures = {file for file in (REPOSITORY / "docs").iterdir() if file.suffix in {".jpg", ".png", ".webp", ".gif", ".svg"}}
    shown = {(page.parent / link["target"]).resolve() for page in PAGES for link in LINK.finditer(prose(page)) if link["picture"]}
    assert pictures <= shown
    assert [file.name for file in sorted(pictures) if file.stat().st_size > MAX_PICTURE_BYTES] == []


def test_every_command_of_the_readme_is_taken_as_it_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Options, values and arguments, as the command line itself reads them, where the files and folders that they name are there."""
    monkeypatch.chdir(tmp_path)
    commands = list(commands_of(README))
    for words in commands:
        for word in words[2:]:
            if re.fullmatch(r"[\w./-]+\.(glb|usda)", word):
                Path(word).parent.mkdir(parents=True, exist_ok=True)
                Path(word).touch()
            elif re.fullmatch(r"\w[\w-]*", word):
                Path(word).mkdir(exist_ok=True)
    assert len(commands) >= 10
    assert [f"{shlex.join(words)}: {problem}" for words in commands if (problem := complaint(words))] == []


@pytest.mark.parametrize("page", [page for page in PAGES if page.name not in RUN_AS_A_WHOLE], ids=lambda page: page.name)
def test_every_command_and_option_exists(page: Path) -> None:
    assert [f"{shlex.join(words)}: {problem}" for words in commands_of(page) if (problem := refusal(words))] == []


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("metascenes run --scans a --lake b", None),
        ("metascenes run --scans a --no-such", "metascenes run has no option --no-such"),
        ("metascenes nonsense", "no command nonsense"),
        ("metascenes lake compact --dry-run", None),
        ("metascenes lake shrink", "no command shrink"),
        ('metascenes sql "SELECT 1" --output json | jq .', None),
        ("metascenes status --lake b    # --done", None),
    ],
)
def test_commands_are_read_as_a_shell_reads_them(line: str, problem: str | None) -> None:
    assert refusal(words_of(line)) == problem


def test_anchors_are_those_of_headings(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# A `stage`, and: its *rows*\n\n```\n# no heading\n```\n## Rows\n## Rows\n")
    assert anchors(page) == {"a-stage-and-its-rows", "rows", "rows-1"}
