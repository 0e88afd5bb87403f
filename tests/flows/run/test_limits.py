"""Global concurrency limits around stages, on a real Prefect server."""

from __future__ import annotations

import contextvars
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from flows.run import limits as module
from flows.run.devices import GPU, card_limit, device_limits, with_devices
from flows.run.ledger import CallRules, LakeLedger
from flows.run.limits import Limit, check_limits, limited
from flows.server.services import SERVER
from schemas.errors import InputError
from tasks.calls.asking import Conversation, ask
from tasks.calls.endpoint import EndpointSettings
from tasks.calls.prompts import Prompt
from tasks.candidates import CandidatesConfig, SlotConfig
from tasks.candidates.shap_e import ShapE
from tasks.capture.small_objects.detectors import GroundingDino
from tasks.capture.small_objects.learned import LearnedConfig
from tasks.capture.small_objects.segmenters import Sam2
from tasks.pipeline import STAGES
from tasks.stage import Context
from tests.conftest import REPOSITORY
from tests.services import PrefectServer, free_port, prefect_server_process
from tests.tasks.calls.servers import Server, refuses, says
from warehouse.lake import Lake

pytestmark = [pytest.mark.whole, pytest.mark.timeout(900)]

FAST = {
    **SERVER,
    "PREFECT_SERVER_SERVICES_REPOSSESSOR_LOOP_SECONDS": "1",
    "PREFECT_SERVER_CONCURRENCY_MAXIMUM_CONCURRENCY_SLOT_WAIT_SECONDS": "0.5",
}
"""Our server's settings, but quicker to find what is free again."""


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PrefectServer]:
    with prefect_server_process(tmp_path_factory.mktemp("prefect"), None, **FAST) as running, pytest.MonkeyPatch.context() as patch:
        for name, value in running.access.items():
            patch.setenv(name, value)
        patch.setenv("PREFECT_HOME", str(tmp_path_factory.mktemp("home")))
        from prefect.settings import PREFECT_API_AUTH_STRING, PREFECT_API_URL, temporary_settings

        with temporary_settings({PREFECT_API_URL: running.url, PREFECT_API_AUTH_STRING: running.token}):
            yield running


def make(name: str, slots: int, per_second: float = 0.0, active: bool = True) -> None:
    from prefect.client.orchestration import get_client
    from prefect.client.schemas.actions import GlobalConcurrencyLimitCreate

    with get_client(sync_client=True) as client:
        client.create_global_concurrency_limit(
            GlobalConcurrencyLimitCreate(name=name, limit=slots, slot_decay_per_second=per_second, active=active)
        )


def taken(name: str) -> int:
    from prefect.client.orchestration import get_client

    with get_client(sync_client=True) as client:
        return int(client.read_global_concurrency_limit_by_name(name).active_slots)


def test_no_more_hold_a_slot_at_once_than_there_are(server: PrefectServer) -> None:
    make("two", 2)
    assert check_limits({"candidates": "two"}) == {"candidates": Limit("two", 2)}
    lock, now, most, done = threading.Lock(), [0], [0], []
    two = threading.Event()

    def work(number: int) -> None:
        with limited("candidates", {"candidates": "two"}):
            with lock:
                now[0] += 1
                most[0] = max(most[0], now[0])
                if now[0] == 2:
                    two.set()
            two.wait(120)  # for another one, however busy the machine is
            time.sleep(0.2)  # in which a third would come
            with lock:
                now[0] -= 1
                done.append(number)

    # Prefect's settings of a test are in its context, which threads do not take over by themselves.
    threads = [threading.Thread(target=contextvars.copy_context().run, args=(work, number)) for number in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(done) == list(range(6))
    assert most[0] == 2
    assert taken("two") == 0


def test_a_slot_is_given_back_when_the_work_fails(server: PrefectServer) -> None:
    make("failing", 1)
    held = []

    def work() -> None:
        with limited("candidates", {"candidates": "failing"}):
            held.append(taken("failing"))
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        work()
    assert held == [1]
    assert taken("failing") == 0


def test_a_rate_lets_begin_so_many_a_second_however_long_each_takes(server: PrefectServer) -> None:
    make("rate", 1, per_second=4.0)
    assert check_limits({"captions": "rate"})["captions"].is_rate
    started = time.monotonic()
    with limited("captions", {"captions": "rate"}), limited("captions", {"captions": "rate"}), limited("captions", {"captions": "rate"}):
        seconds = time.monotonic() - started
    assert seconds >= 2 / 4.0 * 0.9  # three begin at the same time as each other's work goes on, but not faster than that


def test_every_request_of_a_call_keeps_a_rate(server: PrefectServer, tmp_path: Path) -> None:
    """Requests are counted, not calls: what is sent again counts again."""
    make("seer", 1, per_second=4.0)
    make("slots", 2)
    with pytest.raises(InputError, match="only a rate holds requests"):
        check_limits({"calls": "slots"})
    assert check_limits({"calls": "seer"})["calls"].is_rate
    model, ledger = Server(), LakeLedger(Lake.open(tmp_path / "lake"), CallRules(limit="seer"))
    model.answers = [refuses(503), refuses(503), says("yes")]
    context = Context("demo/a_00", "captions", 0, {}, ledger=ledger)
    settings = EndpointSettings(model.url, "seer-1", pause_seconds=0.0)
    started = time.monotonic()
    try:
        assert ask(context, settings, Conversation(Prompt("test", ""), [], {}), "x").text == "yes"
        seconds = time.monotonic() - started
        assert len(model.requests) == 3
        assert seconds >= 2 / 4.0 * 0.9
        assert ask(context, settings, Conversation(Prompt("test", ""), [], {}), "x").text == "yes"
        assert len(model.requests) == 3, "what the ledger has needs no slot"
    finally:
        model.close()


def test_a_limit_that_is_switched_off_stops_nothing_and_is_not_taken(server: PrefectServer) -> None:
    make("off", 1, active=False)
    check_limits({"candidates": "off"})
    with limited("candidates", {"candidates": "off"}), limited("candidates", {"candidates": "off"}):
        assert taken("off") == 0


@pytest.mark.parametrize(
    ("limits", "named"),
    [({"candidates": "unheard-of"}, "candidates=unheard-of"), ({"candidate": "two"}, "candidate"), ({"captions": "none"}, "none")],
)
def test_a_limit_that_nothing_could_pass_is_one_line_before_the_run_begins(
    server: PrefectServer, limits: dict[str, str], named: str
) -> None:
    if "captions" in limits:
        make("none", 0)
    with pytest.raises(InputError) as refused:
        check_limits(limits)
    assert named in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1


def test_a_limit_that_was_removed_meanwhile_is_named(server: PrefectServer, monkeypatch: pytest.MonkeyPatch) -> None:
    from prefect.client.orchestration import get_client

    make("short-lived", 1)
    with limited("candidates", {"candidates": "short-lived"}):
        pass
    with get_client(sync_client=True) as client:
        client.delete_global_concurrency_limit_by_name("short-lived")
    with pytest.raises(InputError, match="short-lived"), limited("candidates", {"candidates": "short-lived"}):
        pass


def on_card(device: str) -> LearnedConfig:
    return LearnedConfig(detector=GroundingDino(weights="dino", device=device), segmenter=Sam2(weights="sam2", device=device))


@pytest.mark.parametrize(("device", "name"), [("auto", GPU), ("cuda", GPU), ("cuda:0", GPU), ("cuda:1", f"{GPU}-1"), ("cpu", None)])
def test_networks_on_a_card_go_by_its_limit(device: str, name: str | None) -> None:
    assert device_limits({"capture": on_card(device)}) == ({"capture": name} if name else {})
    assert device_limits({stage.name: stage.config() for stage in STAGES}) == {}, "nothing has weights by default"
    slots = CandidatesConfig(slots=(SlotConfig(ShapE(weights="shap-e", device="cuda")),))
    assert device_limits({"candidates": slots, "capture": on_card("cpu")}) == {"candidates": GPU}


def test_a_card_holds_one_set_of_networks_where_the_server_has_its_limit(server: PrefectServer) -> None:
    stages = {"capture": on_card("cuda:3"), "candidates": on_card("cuda:4")}
    make(card_limit(3), 1)
    assert with_devices({}, stages) == {"capture": card_limit(3)}
    assert with_devices({"capture": "two"}, stages) == {"capture": "two"}, "what somebody says goes before"
    limits = with_devices({}, stages)
    check_limits(limits)
    with limited("capture", limits):
        assert taken(card_limit(3)) == 1
    assert taken(card_limit(3)) == 0


def test_prefect_is_not_asked_for_stages_without_a_limit() -> None:
    code = "import sys, flows.run.limits as a\nwith a.limited('capture', {'candidates': 'gpu'}): print('prefect' in sys.modules)"
    environment = {**os.environ, "PREFECT_API_URL": f"http://127.0.0.1:{free_port()}/api"}
    done = subprocess.run([sys.executable, "-c", code], cwd=REPOSITORY, env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_no_answer_for_long_is_a_lost_connection_and_no_defect_of_the_scene(server: PrefectServer, monkeypatch: pytest.MonkeyPatch) -> None:
    from prefect.settings import PREFECT_API_URL, temporary_settings

    monkeypatch.setattr(module, "_KNOWN", {})
    with (
        temporary_settings({PREFECT_API_URL: f"http://127.0.0.1:{free_port()}/api"}),
        pytest.raises(ConnectionError, match="no answer from the Prefect server"),
        limited("captions", {"captions": "gone"}, patience=1.5),
    ):
        pass


HOLDER = """
import sys, time
from flows.run import limits
limits.LEASE_SECONDS = 60
with limits.limited("candidates", {"candidates": sys.argv[1]}):
    print("held", flush=True)
    time.sleep(3600)
"""


@pytest.mark.slow
def test_slots_come_back_from_killed_holders_and_through_a_killed_server(server: PrefectServer) -> None:
    """The holder and the server die together; work under a slot survives the server, and its slot comes back, too."""
    make("fragile", 2)
    finished = False
    holder: Any = subprocess.Popen([sys.executable, "-c", HOLDER, "fragile"], cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)
    try:
        assert holder.stdout.readline() == "held\n"
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "LEASE_SECONDS", 60.0)
            with limited("candidates", {"candidates": "fragile"}):
                assert taken("fragile") == 2
                server.kill()
                holder.kill()
                finished = True  # on the way out the slot cannot be given back
        assert finished
        again = threading.Timer(3, server.start)
        again.start()
        started = time.monotonic()
        with limited("candidates", {"candidates": "fragile"}):  # waits for the server, then for a slot of the dead
            pass
        again.join()
        assert time.monotonic() - started > 3
        give_up = time.monotonic() + 240
        while taken("fragile") and time.monotonic() < give_up:
            time.sleep(1)
        assert taken("fragile") == 0
    finally:
        holder.kill()
        holder.wait()


def test_leases_are_kept_where_a_server_finds_them_again(server: PrefectServer, tmp_path: Path) -> None:
    make("kept", 1)
    with limited("candidates", {"candidates": "kept"}):
        leases = [path for path in (server.folder / "prefect" / "concurrency_leases").glob("*.json") if path.name != "expirations.json"]
        assert len(leases) >= 1
