"""Tokens of people in their file: kept, withdrawn, renewed, by commands and servers at once."""

from __future__ import annotations

import dataclasses
import json
import stat
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from flows.cli import cli
from flows.server.access import new_token
from flows.view.annotating.hosting import key_file
from flows.view.annotating.keys import KeyFile, Keys
from schemas.errors import InputError
from schemas.files import write_whole
from tests.flows.view.batches import BATCH, asked_lake, serving

ROLES = {"ada": ("annotator",), "rita": ("reviewer",)}
ORIGIN = "http://127.0.0.1:8765"


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "b1.sqlite.tokens"


def tokens(keys: KeyFile) -> dict[str, str | None]:
    return {name: key.token for name, key in keys.read().people.items()}


def test_tokens_stay_while_nobody_else_could_read_them(file: Path) -> None:
    keys = KeyFile(file)
    assert (keys.read().people, keys.read().port) == ({}, 0)
    first = keys.serve(ROLES, 8765, ORIGIN)
    assert len({key.token for key in first.people.values()}) == 2
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert keys.serve({"ada": ROLES["ada"]}) == first, "who was left out once keeps the address, and so does the port"
    assert first.address("ada") == f"{ORIGIN}/?token={first.people['ada'].token}"
    keys.change(["rita"], [])
    file.chmod(0o644)
    assert keys.people(ROLES) == {}, "others could have read it: a running server refuses it at once"
    replaced = keys.serve(ROLES)
    assert replaced.people["ada"].token not in (None, first.people["ada"].token)
    assert replaced.people["rita"].token is None, "withdrawn people stay so"
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    link = file.with_name("link")
    link.symlink_to(file)
    assert (KeyFile(link).read().people, KeyFile(link).people(ROLES)) == ({}, {})


def test_reading_an_exposed_file_changes_no_token_and_the_next_change_replaces_all(file: Path, caplog: pytest.LogCaptureFixture) -> None:
    server, command = KeyFile(file), KeyFile(file)
    first = server.serve(ROLES, 8765, ORIGIN)
    content = file.read_bytes()
    file.chmod(0o644)
    assert (server.people(ROLES), server.people(ROLES)) == ({}, {})
    assert [record.getMessage() for record in caplog.records] == [server.exposure()], "said once"
    assert command.read() == command.read() == dataclasses.replace(first, is_exposed=True)
    assert command.read().address("ada") is None
    assert command.change([], ["ada"], is_dry=True).people["rita"].token != first.people["rita"].token
    assert file.read_bytes() == content
    renewed = command.change([], ["ada"])
    assert renewed == command.read()
    assert server.people(ROLES) == {key.token: name for name, key in renewed.people.items()}, "every new address works"
    assert not {key.token for key in renewed.people.values()} & {key.token for key in first.people.values()}


def test_a_file_system_without_modes_is_refused_before_addresses_are_given(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = KeyFile(file).serve(ROLES, 8765, ORIGIN)

    def write_open(path: Path, data: bytes, cache: bool) -> None:
        write_whole(path, data, cache)
        path.chmod(0o777)

    monkeypatch.setattr("flows.view.annotating.keys.write_whole", write_open)
    for act in (lambda: KeyFile(file).serve(ROLES), lambda: KeyFile(file).change(["ada"], [])):
        with pytest.raises(InputError, match="its file system does not keep owner and mode; name a file on another") as refused:
            act()
        assert "\n" not in str(refused.value)
    assert KeyFile(file).people(ROLES) == {}
    monkeypatch.undo()
    later = KeyFile(file).serve(ROLES)
    assert later.people["ada"].token is None, "a withdrawal holds all the same"
    assert later.people["rita"].token not in (None, first.people["rita"].token)


def test_a_file_of_another_user_is_exposed(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keys = KeyFile(file)
    keys.serve(ROLES, 8765, ORIGIN)
    owner = file.stat().st_uid
    monkeypatch.setattr("flows.view.annotating.keys.os.geteuid", lambda: owner + 1)
    assert keys.read() == Keys({}, is_exposed=True)
    with pytest.raises(InputError, match="does not keep owner and mode"):
        keys.serve(ROLES)


@pytest.mark.parametrize(
    "text",
    ["[]", "x", '{"tokens": {"ada": "short"}, "port": 1}', '{"tokens": {}, "port": "x"}', '{"people": {"ada": {}}, "port": 1}',
     '{"people": {"ada": {"token": 1}}, "port": 1}', '{"people": [], "port": 1}', '{"people": {}, "port": 70000}'],
)  # fmt: skip
def test_other_files_are_refused_and_let_nobody_in(file: Path, text: str, caplog: pytest.LogCaptureFixture) -> None:
    keys = KeyFile(file)
    token = keys.serve(ROLES, 8765, ORIGIN).people["ada"].token
    assert keys.people(ROLES)[str(token)] == "ada"
    file.write_text(text)
    assert (keys.people(ROLES), keys.people(ROLES)) == ({}, {})
    assert len(caplog.records) == 1, "said once"
    with pytest.raises(InputError):
        keys.read()
    file.unlink()
    assert keys.people(ROLES) == {}


def test_tokens_of_an_earlier_version_hold(file: Path) -> None:
    token = new_token()
    file.write_text(json.dumps({"port": 8765, "tokens": {"ada": token}}))
    file.chmod(0o600)
    keys = KeyFile(file)
    assert keys.people(ROLES) == {token: "ada"}
    assert keys.serve(ROLES, 8765, ORIGIN).people["ada"].token == token
    assert keys.change(["ada"], []).people["ada"].token is None


def test_a_running_server_sees_every_change_and_a_start_brings_nobody_back(file: Path) -> None:
    server, command = KeyFile(file), KeyFile(file)
    first = server.serve(ROLES, 8765, ORIGIN).people["ada"].token
    assert first is not None
    assert set(server.people(ROLES).values()) == {"ada", "rita"}
    assert set(server.people(["rita"]).values()) == {"rita"}, "people of this server alone"
    withdrawn = command.change(["ADA"], [])
    assert "ada" not in server.people(ROLES).values()
    for _ in range(2):
        assert KeyFile(file).serve(ROLES, 8765, ORIGIN).people["ada"] == withdrawn.people["ada"]
    assert command.change(["ada"], []) == withdrawn, "the first time stays"
    before = file.read_bytes()
    assert command.change([], ["ada"], is_dry=True).people["ada"].token not in (None, first)
    assert file.read_bytes() == before
    second = command.change([], ["ada"]).people["ada"].token
    assert second not in (None, first)
    assert server.people(ROLES)[str(second)] == "ada"
    assert first not in server.people(ROLES)
    for option in ({"withdrawn": ["eve"], "renewed": []}, {"withdrawn": [], "renewed": ["eve"]}):
        with pytest.raises(InputError, match="'eve' has no token"):
            command.change(**option)


@given(st.lists(st.tuples(st.sampled_from(["serve", "withdraw", "renew"]), st.sampled_from(["ada", "bob", "rita"])), max_size=12))
def test_whatever_is_done_at_once_no_change_is_lost(tmp_path_factory: pytest.TempPathFactory, acts: list[tuple[str, str]]) -> None:
    """Each person's last act decides; acts of different people run at the same time."""
    file = tmp_path_factory.mktemp("keys") / "tokens"
    roles = dict.fromkeys(("ada", "bob", "rita"), ("annotator",))
    KeyFile(file).serve(roles, 1, ORIGIN)

    def carry_out(name: str) -> bool:
        keys, is_withdrawn = KeyFile(file), False
        for act in [act for act, whose in acts if whose == name]:
            if act == "serve":
                keys.serve(roles, 1, ORIGIN)
            else:
                is_withdrawn = act == "withdraw"
                keys.change([name] if is_withdrawn else [], [] if is_withdrawn else [name])
        return is_withdrawn

    with ThreadPoolExecutor(3) as pool:
        ended = dict(zip(roles, pool.map(carry_out, roles), strict=True))
    assert {name: token is None for name, token in tokens(KeyFile(file)).items()} == ended
    assert [path.name for path in file.parent.iterdir()] == ["tokens"], "nothing unfinished is left"


def ask(lake: Any, *options: str) -> Any:
    result = CliRunner().invoke(cli, ["annotate", "tokens", BATCH, "--lake", lake.address, *options])
    if isinstance(result.exception, Exception):
        raise result.exception
    return result


def test_the_command_lists_withdraws_and_renews(tmp_path: Path) -> None:
    lake = asked_lake(tmp_path)
    assert "no tokens yet" in ask(lake).output
    with pytest.raises(InputError, match="known are none"):
        ask(lake, "--withdraw", "ada")
    drafts = tmp_path / "lake" / "drafts" / f"{BATCH}.sqlite"
    drafts.parent.mkdir()
    keys = key_file(drafts)
    served = keys.serve(ROLES, 8765, ORIGIN)
    listed = json.loads(ask(lake, "--json").output)["people"]
    assert [(row["person"], row["roles"], row["state"]) for row in listed] == [
        ("ada", ["annotator"], "valid"), ("rita", ["reviewer"], "valid"),
    ]  # fmt: skip
    secrets = [str(key.token) for key in served.people.values()]
    assert not any(secret in ask(lake).output + ask(lake, "--json").output for secret in secrets)
    assert str(served.address("ada")) in ask(lake, "--addresses").output
    assert "withdrawn" in ask(lake, "--withdraw", "ada", "--dry-run").output
    assert keys.read() == served
    assert [row["state"] for row in json.loads(ask(lake, "--withdraw", "Ada", "--json").output)["people"]] == ["withdrawn", "valid"]
    renewed = ask(lake, "--renew", "ada").output
    assert str(keys.read().address("ada")) in renewed
    assert str(keys.read().address("rita")) not in renewed
    assert keys.read().people["ada"].token not in (None, served.people["ada"].token)
    assert ask(lake, "--renew", "ada", "--withdraw", "ADA").exit_code == 2
    drafts.with_name(f"{drafts.name}.tokens").chmod(0o640)
    exposed = ask(lake, "--addresses", "--json")
    rows = json.loads(exposed.stdout)["people"]
    assert [(row["state"], row["address"]) for row in rows] == [("exposed", None), ("exposed", None)]
    assert exposed.stderr == f"{keys.exposure()}\n"
    assert "--renew NAME" in exposed.stderr
    again = ask(lake, "--renew", "ada", "--addresses")
    assert again.stderr == ""
    for name, key in keys.read().people.items():
        assert str(keys.read().address(name)) in again.stdout
        assert keys.people(ROLES)[str(key.token)] == name


@pytest.mark.whole
def test_a_withdrawn_person_is_out_at_once_and_stays_out(tmp_path: Path) -> None:
    lake = asked_lake(tmp_path)
    with serving(tmp_path, "--reviewer", "rita") as server:
        ada, bob = server.guest("ada"), server.guest("bob")
        ada.ask("GET", "/api/me")
        before = dict(ada.client.cookies)
        ask(lake, "--withdraw", "ada")
        assert ada.client.get("/api/me").status_code == 401
        assert ada.client.get(server.addresses["ada"]["address"]).status_code == 401
        bob.ask("GET", "/api/me")
        server.end()
    with serving(tmp_path, "--reviewer", "rita") as server:
        assert server.addresses["ada"]["address"] is None
        assert bob.client.get("/api/me").status_code == 401, "sessions end with the server"
        bob = server.guest("bob")
        ask(lake, "--renew", "ada", "--renew", "bob")
        assert bob.client.get("/api/me").status_code == 401
        rows = {row["person"]: row for row in json.loads(ask(lake, "--addresses", "--json").output)["people"]}
        assert ada.client.get("/api/me").status_code == 401
        assert ada.client.get(rows["ada"]["address"]).status_code == 200
        ada.ask("GET", "/api/me")
        assert dict(ada.client.cookies) != before
        assert server.end() == 0
    assert server.errors == ""
