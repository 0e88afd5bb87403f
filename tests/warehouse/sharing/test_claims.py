"""Claims and presence: a scene has one living holder at a time, and what the dead held is free at once."""

from __future__ import annotations

import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from tests.conftest import REPOSITORY
from tests.services import environment_of, s3_server
from tests.warehouse.sharing.claim_load import SCENES
from tests.whole_scenes import stage_whole_scene
from warehouse.lake import Lake
from warehouse.sharing.claims import FOLDER, Claims, claims_of, dead_claims, path_of, sweep_claims
from warehouse.sharing.presence import LiveRun, Presence, dead_runs, runs_of, sweep_runs
from warehouse.sharing.writer import this_writer
from warehouse.storage.files import LocalStorage, Storage, storage_at
from warehouse.storage.locks import locked
from warehouse.upkeep.backup import backup
from warehouse.upkeep.erasure import erase

pytestmark = pytest.mark.whole

HERE_DEAD = f"{this_writer().machine}-999999-1-1"
ELSEWHERE = "ffffffff-12-34-1"
RUNNERS = 3


@contextlib.contextmanager
def started(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """A process of tests/warehouse/sharing/claim_load.py, killed at the end."""
    command = [sys.executable, "-m", "tests.warehouse.sharing.claim_load", *map(str, arguments)]
    process = subprocess.Popen(command, cwd=REPOSITORY, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=dict(os.environ))
    try:
        yield process
    finally:
        process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()


def said(process: subprocess.Popen[str], ask: bool = False) -> dict[str, Any]:
    """What a holding process says of itself."""
    assert process.stdin is not None
    assert process.stdout is not None
    if ask:
        process.stdin.write("\n")
        process.stdin.flush()
    return dict(json.loads(process.stdout.readline()))


def put_claim(storage: Storage, scene: str, token: str, seconds: float) -> bytes:
    """The claim of a process that is not there, or of another machine; it expires in so many seconds."""
    fields = {"token": token, "host": "other", "expires": time.time() + seconds, "life": 60, "scene_id": scene, "since": 1.0}
    storage.write(path_of(scene), json.dumps(fields).encode())
    return storage.read(path_of(scene))


@pytest.fixture(scope="module")
def bucket() -> Iterator[str]:
    """A bucket of moto's server."""
    with s3_server() as s3, environment_of(s3):
        s3.make_bucket("claims")
        yield "s3://claims"


@pytest.fixture(params=["folder", pytest.param("s3", marks=pytest.mark.s3)])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Of a lake that is not there yet: in a folder, and in a bucket."""
    if request.param == "folder":
        return str(tmp_path / "lake")
    return f"{request.getfixturevalue('bucket')}/{tmp_path.name}"


class Claimers(RuleBasedStateMachine):
    """Several runs of one process claim, give back, leave and come again, beside the dead and those elsewhere."""

    def storage(self) -> Storage:
        self.folder = Path(tempfile.mkdtemp(prefix="claims-"))
        return storage_at(self.folder)

    @initialize()
    def begin(self) -> None:
        self.place = self.storage()
        self.runs: dict[int, Claims] = {}
        self.owner: dict[str, object] = {}  # of every scene that is held: a run, or "elsewhere"
        self.dead: set[str] = set()

    @rule(number=st.integers(0, RUNNERS - 1))
    def enter(self, number: int) -> None:
        if number not in self.runs:
            self.runs[number] = Claims(self.place).__enter__()

    @rule(number=st.integers(0, RUNNERS - 1))
    def leave(self, number: int) -> None:
        if number in self.runs:
            self.runs.pop(number).__exit__(None, None, None)
            self.owner = {scene: owner for scene, owner in self.owner.items() if owner != number}

    @precondition(lambda self: self.runs)
    @rule(number=st.integers(0, RUNNERS - 1), scene=st.sampled_from(SCENES))
    def claim(self, number: int, scene: str) -> None:
        number = sorted(self.runs)[number % len(self.runs)]
        assert self.runs[number].claim(scene) is (self.owner.get(scene, number) == number)
        self.owner.setdefault(scene, number)
        self.dead.discard(scene)

    @precondition(lambda self: self.runs)
    @rule(number=st.integers(0, RUNNERS - 1), scene=st.sampled_from(SCENES))
    def release(self, number: int, scene: str) -> None:
        number = sorted(self.runs)[number % len(self.runs)]
        self.runs[number].release(scene)
        if self.owner.get(scene) == number:
            del self.owner[scene]

    @rule(scene=st.sampled_from(SCENES), token=st.sampled_from([HERE_DEAD, ELSEWHERE]), is_over=st.booleans())
    def die(self, scene: str, token: str, is_over: bool) -> None:
        if scene not in self.owner:
            put_claim(self.place, scene, token, -1 if is_over else 999)
            self.dead.discard(scene)
            if token == ELSEWHERE and not is_over:
                self.owner[scene] = "elsewhere"
            else:
                self.dead.add(scene)

    @rule()
    def sweep(self) -> None:
        sweep_claims(self.place)
        self.dead.clear()

    @rule(number=st.integers(0, RUNNERS - 1), scene=st.sampled_from(SCENES))
    def steal(self, number: int, scene: str) -> None:
        """A run was away for too long: its claim is somebody else's. Its next renewal tells."""
        if self.owner.get(scene) == number:
            put_claim(self.place, scene, ELSEWHERE, 999)
            self.owner[scene] = "elsewhere"
            claims = self.runs[number]
            hold = claims._holds[scene]
            assert not hold.renew()
            claims._lose(scene, hold)
            assert scene in claims.lost()

    @invariant()
    def one_holder_each(self) -> None:
        if not hasattr(self, "place"):
            return
        assert set(claims_of(self.place)) == set(self.owner)
        for number, claims in self.runs.items():
            assert claims.held() == {scene for scene, owner in self.owner.items() if owner == number}
            assert not claims.held() & claims.lost()
        assert {claim.scene_id for claim in dead_claims(self.place).values()} == self.dead
        assert set(self.place.names(FOLDER)) == {path_of(scene).rpartition("/")[2] for scene in self.dead | set(self.owner)}

    def teardown(self) -> None:
        for claims in getattr(self, "runs", {}).values():
            claims.__exit__(None, None, None)
        if hasattr(self, "folder"):
            shutil.rmtree(self.folder)


TestClaimers = Claimers.TestCase
TestClaimers.settings = settings(max_examples=25, stateful_step_count=30, deadline=None)


@pytest.mark.s3
def test_claimers_meet_in_a_bucket(bucket: str) -> None:
    from hypothesis.stateful import run_state_machine_as_test

    class InBucket(Claimers):
        number = 0

        def storage(self) -> Storage:
            InBucket.number += 1
            return storage_at(f"{bucket}/state{InBucket.number}")

    run_state_machine_as_test(InBucket, settings=settings(max_examples=4, stateful_step_count=20, deadline=None))


def test_threads_of_many_runs_never_hold_a_scene_twice(address: str) -> None:
    lake = Lake.open(address)
    inside: dict[str, int] = dict.fromkeys(SCENES, 0)
    breaches, total = [], 0
    lock = threading.Lock()

    def work(seed: int) -> None:
        nonlocal total
        draw = random.Random(seed)
        with lake.claims() as claims:
            for _ in range(20):
                scene = draw.choice(SCENES)
                if claims.claim(scene):
                    with lock:
                        inside[scene] += 1
                        total += 1
                        if inside[scene] > 1:
                            breaches.append(scene)
                    time.sleep(0.001)
                    with lock:
                        inside[scene] -= 1
                    claims.release(scene)

    threads = [threading.Thread(target=work, args=(seed,)) for seed in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert breaches == []
    assert total >= 20
    assert lake.claimed() == {}
    assert lake.storage.names(FOLDER) == []


@pytest.mark.slow
def test_processes_that_are_killed_at_random_never_hold_a_scene_twice(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    lake.claims()
    locks = tmp_path / "locks"
    locks.mkdir()
    draw = random.Random(0)
    with contextlib.ExitStack() as stack:
        processes = [stack.enter_context(started("work", lake.address, locks, seed, 6)) for seed in range(3)]
        doomed = stack.enter_context(started("work", lake.address, locks, 99, 60))
        for seed in range(4):
            time.sleep(0.8 + draw.random())
            doomed.send_signal(signal.SIGKILL)
            doomed.wait()
            doomed = stack.enter_context(started("work", lake.address, locks, 100 + seed, 60))
        output = [process.communicate()[0].split() for process in processes]
        doomed.kill()
        doomed.wait()
    assert all(words[0] == "held:" and int(words[1]) > 0 for words in output), output
    assert lake.claimed() == {}, "all are done or dead"
    lake.sweep()
    assert lake.storage.names(FOLDER) == []


def test_claims_of_a_killed_process_are_free_at_once(address: str) -> None:
    with started("hold", address, 60, "", *SCENES[:2]) as process:
        assert said(process)["claimed"] == [True, True]
        lake = Lake.open(address)
        held = lake.claimed()
        assert {scene: claim.is_gone for scene, claim in held.items()} == dict.fromkeys(SCENES[:2], False)
        assert all(str(process.pid) in claim.token and abs(claim.since - time.time()) < 60 for claim in held.values())
        with lake.claims() as claims:
            assert not claims.claim(SCENES[0])
            process.send_signal(signal.SIGKILL)
            process.wait()
            assert lake.claimed() == {}
            assert claims.claim(SCENES[0])
            lake.sweep()
            assert claims.held() == set(lake.claimed()) == {SCENES[0]}, "the dead one's other claim was swept, ours was not"
            assert len(lake.storage.names(FOLDER)) == 1


def test_claims_of_another_machine_are_respected_until_they_run_out(address: str) -> None:
    lake = Lake.open(address)
    with lake.claims() as claims:
        there = put_claim(lake.storage, SCENES[0], ELSEWHERE, 600.0)
        assert not claims.claim(SCENES[0])
        sweep_claims(lake.storage)
        assert lake.storage.read(path_of(SCENES[0])) == there
        put_claim(lake.storage, SCENES[0], ELSEWHERE, -0.1)
        assert claims.claim(SCENES[0])
        assert claims.held() == {SCENES[0]}


@pytest.mark.slow
def test_a_run_that_was_stopped_for_too_long_finds_its_scene_lost(address: str) -> None:
    life = 6.0
    with started("hold", address, life, "ffffffff", SCENES[0], SCENES[1]) as process:
        assert said(process)["claimed"] == [True, True]
        lake = Lake.open(address)
        first = lake.claimed()
        while any(claim.expires <= first[scene].expires for scene, claim in lake.claimed().items()):
            time.sleep(0.05)
        with lake.claims() as claims:
            assert not claims.claim(SCENES[0]), "it was renewed meanwhile"
            assert len(lake.live_runs()) == 1
            with locked(lake.storage.folder) if isinstance(lake.storage, LocalStorage) else contextlib.nullcontext():
                process.send_signal(signal.SIGSTOP)  # not while it holds the folder's lock: that would stop everybody
                time.sleep(0.05)
            while lake.claimed() or lake.live_runs():
                time.sleep(0.05)
            assert claims.claim(SCENES[0])
            lake.storage.remove(path_of(SCENES[1]))
            process.send_signal(signal.SIGCONT)
            while (told := said(process, ask=True)) != {"held": [], "lost": SCENES[:2]}:
                assert told["held"] == [], "what was not renewed in time does not count as ours, whoever has it"
                time.sleep(0.05)
            while not lake.live_runs():  # until it has told that it is at work again
                time.sleep(0.05)
            assert process.stdin is not None
            process.stdin.close()
            assert process.wait() == 0
            assert claims.held() == set(lake.claimed()) == {SCENES[0]}, "somebody else's claim is not given back"
            assert lake.live_runs() == []


def test_a_claim_is_renewed_and_given_back_when_the_run_ends_in_an_error(address: str) -> None:
    lake = Lake.open(address)

    def run() -> None:
        with lake.claims(life=12.0) as claims:
            assert claims.claim(SCENES[0])
            first = lake.claimed()[SCENES[0]]
            while (second := lake.claimed()[SCENES[0]]).expires <= first.expires:
                time.sleep(0.05)
            assert (second.since, second.token) == (first.since, first.token)
            assert claims.held() == {SCENES[0]}
            raise KeyError("a bug")

    with pytest.raises(KeyError, match="a bug"):
        run()
    assert lake.claimed() == {}


class Distant(LocalStorage):
    """A folder behind a wire on which a write is answered once sixteen are under way."""

    together: threading.Barrier | None = None

    def swap(self, path: str, data: bytes | None, tag: str) -> bool:
        if self.together is not None:
            self.together.wait()
        return super().swap(path, data, tag)


def test_many_claims_on_a_distant_store_are_renewed_sixteen_at_a_time(tmp_path: Path) -> None:
    (tmp_path / "lake").mkdir()
    storage, names = Distant(tmp_path / "lake"), [f"scannet/scene{number:04d}_00" for number in range(64)]
    with Claims(storage, life=12.0) as claims:
        assert all(claims.claim(name) for name in names)
        first = claims_of(storage)
        storage.together = threading.Barrier(16)
        while any(claim.expires <= first[name].expires for name, claim in claims_of(storage).items()):
            time.sleep(0.05)
        storage.together.abort()  # the next round fails, and is let go
        storage.together = None
        assert set(claims_of(storage)) == set(names)


class Forgetful(LocalStorage):
    """A folder behind a wire that loses the answers of some writes: they are made, and their writer does not hear of it."""

    losses = 0

    def create(self, path: str, data: bytes) -> bool:
        made = super().create(path, data)
        self._lose()
        return made

    def swap(self, path: str, data: bytes | None, tag: str) -> bool:
        made = super().swap(path, data, tag)
        self._lose()
        return made

    def _lose(self) -> None:
        if self.losses:
            self.losses -= 1
            raise ConnectionError("no answer")


def test_a_write_whose_answer_was_lost_is_ours_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "lake").mkdir()
    storage, life = Forgetful(tmp_path / "lake"), 12.0
    with Claims(storage, life=life) as claims:
        storage.losses = 1
        with pytest.raises(ConnectionError):
            claims.claim(SCENES[0])
        assert claims.claim(SCENES[0])
        storage.losses = 1
        first = claims_of(storage)[SCENES[0]].expires
        while storage.losses or claims_of(storage)[SCENES[0]].expires < first + 0.5 * life:
            time.sleep(0.02)
        assert claims.held() == {SCENES[0]}
        assert claims.lost() == set()
    assert claims_of(storage) == {}


def test_what_is_no_claim_is_left_alone_and_long_names_are_told_apart(address: str) -> None:
    lake = Lake.open(address)
    scenes = [f"demo/{'x' * 200}{tail}" for tail in "ab"]
    with lake.claims() as one, lake.claims() as two:
        assert (one.claim(scenes[0]), two.claim(scenes[0]), two.claim(scenes[1])) == (True, False, True)
        lake.storage.write(f"{FOLDER}/notes.txt", b"mine")
        lake.storage.write(f"{FOLDER}/demo.json", b"{}")
        lake.sweep()
        assert set(lake.claimed()) == set(scenes)
    assert lake.storage.names(FOLDER) == ["demo.json", "notes.txt"]


def test_erasing_a_scene_takes_its_claim_away_and_backups_have_none(tmp_path: Path) -> None:
    lake = Lake.open(tmp_path / "lake")
    for number, scene in enumerate(SCENES[:2]):
        stage_whole_scene(lake, scene, "x", at=number, shared=number)
    lake.commit()
    dead = put_claim(lake.storage, SCENES[2], HERE_DEAD, 999)
    with lake.claims(life=9.0) as claims, lake.presence({"workers": 1}):
        assert claims.claim(SCENES[0])
        assert claims.claim(SCENES[1])
        backup(lake, tmp_path / "backup")
        assert not {FOLDER, "runs"} & set(storage_at(tmp_path / "backup").folders(""))
        done = erase(lake, SCENES[0])
        assert done.proof is not None
        assert done.proof.hits == ()
        assert set(lake.claimed()) == {SCENES[1]}
        while claims.lost() != {SCENES[0]}:
            time.sleep(0.02)
        assert claims.held() == {SCENES[1]}
    assert dead
    assert dead_claims(lake.storage) == {}, "the dead one's was swept with the files of the dead"


def test_a_run_tells_of_itself_while_it_lives(address: str) -> None:
    lake = Lake.open(address)
    with lake.presence({"workers": 3, "runner": "dask", "scans": "s3://scans", "scenes": 7, "left": {"capture": 7}}) as presence:
        assert lake.exists
        (run,) = lake.live_runs()
        assert (run.workers, run.runner, run.scans, run.scenes, dict(run.left)) == (3, "dask", "s3://scans", 7, {"capture": 7})
        assert run.token.startswith(str(this_writer()))
        assert run == presence.run
        for done in range(1, 50):
            presence.tell({"done": done, "left": {"capture": 7 - done % 7}, "seconds_done": 1.5 * done})
        while lake.live_runs()[0].done != 49:
            time.sleep(0.05)
        (run,) = lake.live_runs()
        assert run == presence.run
        assert (run.workers, run.seconds_done) == (3, 73.5), "what was not told again stays"
        with pytest.raises(TypeError, match="dnoe"):
            presence.tell({"dnoe": 1})
        with lake.presence() as other:
            assert [one.token for one in lake.live_runs()] == [presence.run.token, other.run.token]
            lake.sweep()
            assert len(lake.live_runs()) == 2
    assert lake.live_runs() == []
    assert lake.storage.names("runs") == []


def test_a_killed_run_is_not_at_work_any_more(address: str) -> None:
    with started("hold", address, 60, "", SCENES[0]) as process:
        token = said(process)["token"]
        lake = Lake.open(address)
        (run,) = lake.live_runs()
        assert isinstance(run, LiveRun)
        assert (run.token, run.scenes) == (token, 1)
        process.send_signal(signal.SIGKILL)
        process.wait()
        assert lake.live_runs() == []
        assert len(lake.storage.names("runs")) == 1
        assert [one.token for one in dead_runs(lake.storage).values()] == [token]
        sweep_runs(lake.storage)
        assert lake.storage.names("runs") == []


def test_a_run_that_does_not_rest_is_written_every_few_seconds_only(tmp_path: Path) -> None:
    (tmp_path / "lake").mkdir()
    written = []

    class Counted(LocalStorage):
        def write(self, path: str, data: bytes, lasting: bool = True) -> None:
            written.append(path)
            super().write(path, data, lasting)

    storage = Counted(tmp_path / "lake")
    with Presence(storage, pause=0.2) as presence:
        begun, told = time.monotonic(), 0
        while told < 500 or len(written) < 3:
            told += 1
            presence.tell({"done": told})
            time.sleep(0.001)
        assert len(written) <= 2 + (time.monotonic() - begun) / 0.2, "however often it is told"
        while runs_of(storage)[0].done != told:  # the last word is written, too
            time.sleep(0.02)
        quiet = len(written)
        time.sleep(0.5)
        assert len(written) == quiet, "nothing new, nothing written"


class Away(LocalStorage):
    """A folder behind a wire that can be cut."""

    is_cut = False

    def swap(self, path: str, data: bytes | None, tag: str) -> bool:
        if self.is_cut:
            raise ConnectionError("no answer")
        return super().swap(path, data, tag)


@pytest.mark.slow
def test_what_could_not_be_given_back_stops_the_next_run_of_the_same_process_for_one_life_only(tmp_path: Path) -> None:
    (tmp_path / "lake").mkdir()
    storage, life = Away(tmp_path / "lake"), 6.0
    claims = Claims(storage, life=life).__enter__()
    assert claims.claim(SCENES[0])
    storage.is_cut = True
    with pytest.raises(ConnectionError):
        claims.__exit__(None, None, None)
    storage.is_cut = False
    with Claims(storage, life=life) as again:
        assert not again.claim(SCENES[0])
        while not again.claim(SCENES[0]):
            time.sleep(0.05)
    assert claims_of(storage) == {}
