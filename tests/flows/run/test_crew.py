"""Helpers of a worker: every item once, in order, whoever does it, whatever becomes of them."""

from __future__ import annotations

import errno
import multiprocessing
import os
import signal
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import psutil
import pytest

from flows.run import crew as crew_module
from flows.run.crew import Crew, crew_of
from flows.run.parts import place_of
from flows.run.pool import WorkerPool

LIMIT = 120.0
"""Seconds that something healthy may take here: starting a helper imports this module, on a busy machine."""

pytestmark = pytest.mark.timeout(600)


@pytest.fixture
def crew() -> Iterator[Crew]:
    before = set(helpers())
    yield Crew(work_seconds=0)
    for child in multiprocessing.active_children():
        if child.name == "helper" and child.pid not in before:
            child.kill()
            child.join()


def helpers() -> list[int]:
    """Those of this process that live."""
    return [child.pid for child in multiprocessing.active_children() if child.name == "helper" and child.pid is not None]


def appear(paths: list[Path]) -> None:
    until = time.monotonic() + LIMIT
    while not all(path.exists() for path in paths):
        assert time.monotonic() < until, "nobody else took a part"
        time.sleep(0.005)


def together(work: tuple[str, int, int]) -> tuple[int, int]:
    """Says that it has begun, and waits for `count` processes that have: an item for each is done by all of them."""
    folder, number, count = work
    (Path(folder) / f"begun{number}").touch()
    if number < count:
        appear([Path(folder) / f"begun{other}" for other in range(count)])
    return os.getpid(), number**2


def all_take_part(crew: Crew, folder: Path, count: int = 2, items: int = 8) -> set[int]:
    """The processes that did the items, `count` at least."""
    folder.mkdir()
    done = crew.spread(together, [(str(folder), number, count) for number in range(items)], count - 1)
    assert [value for _, value in done] == [number**2 for number in range(items)]
    return {process for process, _ in done}


def squared(number: int) -> int:
    return number**2


def noted(work: tuple[str, int]) -> int:
    """Leaves a line for the item and who did it."""
    folder, number = work
    descriptor = os.open(Path(folder) / "done", os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(descriptor, f"{number} {os.getpid()}\n".encode())
    os.close(descriptor)
    return number


def killed_where_not(work: tuple[int, str, int]) -> tuple[int, int]:
    """Dies in any other process than the one that is named, which waits for that at first."""
    worker, folder, number = work
    (Path(folder) / f"{number}").touch()
    if os.getpid() != worker:
        os.kill(os.getpid(), signal.SIGKILL)
    appear([Path(folder) / f"{other}" for other in range(2)])
    return os.getpid(), number


class Unpicklable(Exception):
    def __init__(self, one: str, two: str) -> None:
        super().__init__(f"{one} and {two}")


def failing(work: tuple[str, int]) -> int:
    """Items 3, 7, ... fail; the first two wait for each other."""
    folder, number = work
    together((folder, number, 2))
    if number % 4 == 3:
        raise ValueError(f"item {number}")
    return number


def failing_there(work: tuple[int, str, int]) -> int:
    worker, folder, number = work
    together((folder, number, 2))
    if os.getpid() != worker:
        raise ValueError("there")
    return number


def telling_more_than_can_be_sent(work: tuple[int, str, int]) -> int:
    worker, folder, number = work
    together((folder, number, 2))
    if os.getpid() != worker:
        raise Unpicklable("this", "that")
    return number


def telling_a_cause(work: tuple[int, str, int]) -> int:
    worker, folder, number = work
    together((folder, number, 2))
    if os.getpid() != worker:
        raise ValueError("away") from ConnectionResetError("gone")
    return number


def failing_here(work: tuple[int, str, int]) -> bytes:
    """Fails in the worker; elsewhere it makes more than any pipe holds."""
    worker, folder, number = work
    together((folder, number, 2))
    if os.getpid() == worker:
        raise ValueError("here")
    return bytes(3_000_000)


def unsendable_elsewhere(work: tuple[int, str, int]) -> object:
    worker, folder, number = work
    together((folder, number, 2))
    return number if os.getpid() == worker else threading.Lock()


def with_a_process(work: tuple[str, int]) -> tuple[int, int]:
    """What a process of its own makes of the item."""
    folder, number = work
    together((folder, number, 2))
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return os.getpid(), pool.apply(squared, (number,))


@pytest.mark.whole
@pytest.mark.parametrize("count", [2, 3])
def test_every_item_is_done_once_and_in_order(crew: Crew, tmp_path: Path, count: int) -> None:
    assert all_take_part(crew, tmp_path / "all", count) == {os.getpid(), *helpers()}
    for size in (2, 3, 100, 5000):
        (tmp_path / str(size)).mkdir()
        items = [(str(tmp_path / str(size)), number) for number in range(size)]
        assert crew.spread(noted, items, count - 1) == list(range(size))
        lines = [line.split() for line in (tmp_path / str(size) / "done").read_text().splitlines()]
        assert Counter(int(number) for number, _ in lines) == Counter(range(size)), "each once"
    assert (crew.spread(squared, [], 1), crew.spread(squared, [3], 1)) == ([], [9])


def test_no_helper_is_started_for_less_than_two_items(crew: Crew) -> None:
    before = helpers()
    assert (crew.spread(squared, [3], 5), crew.spread(squared, range(9), 0)) == ([9], [n**2 for n in range(9)])
    assert helpers() == before
    assert crew_of(1)(lambda number: number + 1, [1, 2]) == [2, 3], "nothing is sent"


@pytest.mark.whole
def test_the_error_is_that_of_the_first_item_that_has_one(crew: Crew, tmp_path: Path) -> None:
    places = set()
    for turn in range(8):
        (tmp_path / str(turn)).mkdir()
        with pytest.raises(ValueError, match=r"item 3$") as caught:
            crew.spread(failing, [(str(tmp_path / str(turn)), number) for number in range(20)], 1)
        places.add(place_of(caught.value))
    assert len(places) == 1, "whoever did it"
    assert places.pop().startswith("tests/flows/run/test_crew.py:")
    with pytest.raises(ValueError, match=r"^there\b") as elsewhere:
        crew.spread(failing_there, [(os.getpid(), str(tmp_path), number) for number in range(6)], 1)
    assert "in failing_there" in "".join(elsewhere.value.__notes__)
    assert len(all_take_part(crew, tmp_path / "after")) == 2, "nothing is left over"


@pytest.mark.whole
def test_nobody_stays_busy_with_what_nobody_reads(crew: Crew, tmp_path: Path) -> None:
    """After an error of the worker a helper still has its part to tell."""
    for turn in range(3):
        (tmp_path / str(turn)).mkdir()
        with pytest.raises(ValueError, match=r"^here$"):
            crew.spread(failing_here, [(os.getpid(), str(tmp_path / str(turn)), number) for number in range(4)], 1)
    before = helpers()
    assert len(all_take_part(crew, tmp_path / "after")) == 2
    assert helpers() == before, "the same one"


@pytest.mark.whole
@pytest.mark.parametrize("function", [unsendable_elsewhere, telling_more_than_can_be_sent, telling_a_cause])
def test_what_cannot_be_sent_as_it_is_is_done_by_the_worker(crew: Crew, tmp_path: Path, function: Callable[..., Any]) -> None:
    """What decides whether a stage is tried again, an error's kind and cause, is that of an item the worker did."""
    assert crew.spread(function, [(os.getpid(), str(tmp_path), number) for number in range(5)], 1) == list(range(5))
    assert len(all_take_part(crew, tmp_path / "after")) == 2


class Unreadable:
    """Cannot be read in another process."""

    def __reduce__(self) -> tuple[Any, ...]:
        return read_in, (os.getpid(),)


def read_in(process: int) -> str:
    if os.getpid() != process:
        raise ImportError("no such module here")
    return "item"


def is_item(item: Any) -> bool:
    return isinstance(item, Unreadable)


@pytest.mark.whole
def test_orders_that_no_helper_can_read_start_none_for_ever(crew: Crew) -> None:
    seen: set[int] = set()
    for _ in range(40):
        assert crew.spread(is_item, [Unreadable() for _ in range(4)], 1) == [True] * 4
        seen |= set(helpers())
        for child in multiprocessing.active_children():
            child.join(1.0)
    assert 1 <= len(seen) <= 4


@pytest.mark.whole
def test_where_none_can_be_started_the_worker_does_all(crew: Crew, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Any) -> None:
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))

    monkeypatch.setattr(multiprocessing.get_context("spawn").Process, "start", full)
    for _ in range(5):
        assert crew.spread(squared, range(10), 2) == [n**2 for n in range(10)]


def is_warm(crew: Crew, folder: Path) -> bool:
    return len(all_take_part(crew, folder)) == 2


class Clock:
    """A second passes each time that somebody looks."""

    def __init__(self) -> None:
        self._now = 0

    def monotonic(self) -> int:
        self._now += 1
        return self._now


def test_a_worker_with_little_to_do_starts_no_helper() -> None:
    crew, before = Crew(work_seconds=float("inf")), helpers()
    for count in range(20):
        assert crew.spread(squared, range(count), 3) == [n**2 for n in range(count)]
    assert helpers() == before
    with pytest.raises(ValueError, match="int"):
        crew.spread(int, ["1", "x", "y"], 1)


def test_helpers_start_once_a_worker_has_worked_for_so_long(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(crew_module, "time", Clock())
    crew, shared = Crew(work_seconds=5), []
    monkeypatch.setattr(crew, "_shared", lambda function, items, count: shared.append((list(items), count)) or [*map(function, items)])
    for items in ([1, 2], [3, 4], [5, 6, 7, 8], [9], [10, 11]):
        assert crew.spread(squared, items, 3) == [n**2 for n in items]
    assert shared == [([6, 7, 8], 2), ([10, 11], 1)]


@pytest.mark.whole
def test_a_helper_that_has_started_takes_part_in_every_round(crew: Crew, tmp_path: Path) -> None:
    """An order that comes before what there is to claim would find nothing, and be done."""
    assert all(is_warm(crew, tmp_path / str(turn)) for turn in range(40))


@pytest.mark.whole
def test_a_helper_that_nobody_asks_ends_and_another_one_helps_next(tmp_path: Path) -> None:
    crew = Crew(idle_seconds=0.05, work_seconds=0)
    before = set(helpers())
    for turn in range(5):  # more often than helpers may be lost
        assert is_warm(crew, tmp_path / str(turn))
        until = time.monotonic() + LIMIT
        while set(helpers()) - before:
            assert time.monotonic() < until, "it stays"
            time.sleep(0.01)


@pytest.mark.whole
def test_what_a_lost_helper_had_claimed_is_done_and_another_takes_its_place(crew: Crew, tmp_path: Path) -> None:
    for turn in range(2):
        (tmp_path / str(turn)).mkdir()
        done = crew.spread(killed_where_not, [(os.getpid(), str(tmp_path / str(turn)), number) for number in range(10)], 1)
        assert done == [(os.getpid(), number) for number in range(10)]
    assert len(all_take_part(crew, tmp_path / "after")) == 2
    (tmp_path / "last").mkdir()
    crew.spread(killed_where_not, [(os.getpid(), str(tmp_path / "last"), number) for number in range(10)], 1)
    before = helpers()
    assert crew.spread(squared, range(10), 1) == [n**2 for n in range(10)], "work that takes every helper along goes on without"
    assert helpers() == before


@pytest.mark.whole
def test_a_helper_that_is_still_starting_is_not_waited_for(crew: Crew, tmp_path: Path) -> None:
    before = set(helpers())
    crew.spread(squared, range(2), 1)
    (starting,) = set(helpers()) - before
    psutil.Process(starting).suspend()
    try:
        for count in range(50):
            assert crew.spread(squared, range(count), 1) == [n**2 for n in range(count)]
    finally:
        psutil.Process(starting).resume()
    assert all_take_part(crew, tmp_path / "after") == {os.getpid(), starting}, "it finds its way through rounds that are over"


@pytest.mark.whole
def test_of_several_threads_one_has_the_helpers(crew: Crew) -> None:
    with ThreadPoolExecutor(4) as threads:
        for done in threads.map(lambda turn: crew.spread(squared, range(turn, turn + 200), 1), range(40)):
            assert done == [n**2 for n in range(int(done[0] ** 0.5), int(done[0] ** 0.5) + 200)]


@pytest.mark.whole
def test_helpers_may_have_processes_of_their_own(crew: Crew, tmp_path: Path) -> None:
    done = crew.spread(with_a_process, [(str(tmp_path), number) for number in range(3)], 1)
    assert ([value for _, value in done], len({process for process, _ in done})) == ([0, 1, 4], 2)


def with_a_crew(folder: str) -> tuple[list[int], list[int]]:
    multiprocessing.current_process().daemon = False
    crew_module._own.append(Crew(work_seconds=0))
    return crew_of(3)(noted, [(folder, number) for number in range(8)]), helpers()


@pytest.mark.whole
def test_helpers_end_with_their_worker(tmp_path: Path) -> None:
    with WorkerPool(1) as pool:
        done, left = pool.call(with_a_crew, str(tmp_path), timeout=LIMIT)
        assert (done, len(left)) == (list(range(8)), 2)
    until = time.monotonic() + LIMIT
    while any(psutil.pid_exists(pid) for pid in left):
        assert time.monotonic() < until, "they stay"
        time.sleep(0.05)
