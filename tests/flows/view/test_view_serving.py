"""What `metascenes view` opens: the scene that was asked for, by a file that nobody else reads."""

from __future__ import annotations

import html
import json
import re
import stat
import webbrowser
from collections.abc import Callable
from pathlib import Path
from urllib.parse import parse_qs, unquote, urlsplit

import pytest
import uvicorn
from click.testing import CliRunner, Result

from flows.commands.view import command
from flows.view import bundle, serving
from schemas.machine.scratch import temporary_folders
from tests.flows.view.lakes import OBJECTS, SCENES, shown_lake
from warehouse.lake import Lake


@pytest.fixture(scope="module")
def lake(tmp_path_factory: pytest.TempPathFactory) -> Lake:
    return shown_lake(tmp_path_factory.mktemp("serving"))


@pytest.fixture
def ask(lake: Lake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., tuple[Result, list[str], list[str]]]:
    """Runs the command at a screen; its result, what the browser was given, and what the files that it was given held."""
    for name in ("view.html", "view.js", "view.css"):
        (tmp_path / name).write_text("")
    monkeypatch.setattr(bundle, "BUILT", tmp_path)
    monkeypatch.setattr(serving, "_has_screen", lambda: True)
    monkeypatch.setattr(uvicorn.Server, "run", lambda *_, **__: None)
    opened, pages = list[str](), list[str]()

    def keep(address: str) -> bool:
        opened.append(address)
        file = Path(unquote(urlsplit(address).path))
        if file.is_file():
            assert stat.S_IMODE(file.stat().st_mode) == 0o600
            assert file.parent in temporary_folders(), "it is removed after a kill, too"
            pages.append(file.read_text())
        return True

    monkeypatch.setattr(webbrowser, "open", keep)

    def run(*arguments: str) -> tuple[Result, list[str], list[str]]:
        return CliRunner().invoke(command, [*arguments, "--lake", lake.address]), opened, pages

    return run


@pytest.mark.parametrize("place", ["", SCENES[1], f"{SCENES[1]}/0002"])
def test_the_browser_is_led_to_what_is_printed(ask: Callable[..., tuple[Result, list[str], list[str]]], place: str) -> None:
    result, opened, pages = ask(*[place] if place else [])
    assert result.exit_code == 0, result.output
    printed = result.output.splitlines()[0]
    query = parse_qs(urlsplit(printed).query)
    assert query.get("at", [""]) == [place]
    (address,), (page,) = opened, pages
    assert query["token"][0] not in address, "arguments are seen by everybody on the machine"
    target = re.search(r'content="0;url=([^"]*)"', page)
    assert target is not None
    assert html.unescape(target[1]) == printed
    assert not Path(unquote(urlsplit(address).path)).parent.exists(), "it goes with the server"


def test_scripts_get_the_same_address_and_no_browser(ask: Callable[..., tuple[Result, list[str], list[str]]]) -> None:
    result, opened, _ = ask(f"{SCENES[1]}/0002", "--json")
    answer = json.loads(result.output)
    assert (parse_qs(urlsplit(answer["address"]).query)["at"], answer["scene_id"]) == ([f"{SCENES[1]}/0002"], SCENES[1])
    assert opened == []


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ("demo/none", "there is no such scene"),
        ("demo/none/0000", "there is no such scene"),
        (f"{SCENES[0]}/{OBJECTS:04d}", "there is no such object"),
        (f"{SCENES[0]}/", "there is no such object"),
        (f"{SCENES[0]}/0000/0", "there is no such object"),
    ],
)
def test_what_is_not_there_is_named(ask: Callable[..., tuple[Result, list[str], list[str]]], place: str, reason: str) -> None:
    result, opened, _ = ask(place)
    assert reason in str(result.exception)
    assert opened == []


def test_a_file_is_of_a_whole_scene(ask: Callable[..., tuple[Result, list[str], list[str]]], tmp_path: Path) -> None:
    result, _, _ = ask(f"{SCENES[0]}/0000", "--out", str(tmp_path / "scene.html"))
    assert result.exit_code == 2
    assert "leave /0000 away" in result.output
