"""Helpers of a worker: every item once, in order, whoever does it, whatever becomes of them."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

from flows.run.crew import Crew, crew_of
from flows.run.pool import WorkerPool

LIMIT = 120.0
"""Seconds that a healthy task may take here: starting a worker imports this module, on a busy machine."""


@pytest.fixture
def crew() -> Iterator[Crew]:
    """One helper, which has started."""
    made = Crew(1)
    while len({process for process, _ in made.spread(slowly_squared, range(4))}) < 2:
        pass
    yield made
    end_helpers()


def helpers() -> list[int]:
    """Those of this process that live."""
    return [child.pid for child in multiprocessing.active_children() if child.name == "helper" and child.pid is not None]


def end_helpers() -> None:
    for child in multiprocessing.active_children():
        child.kill()
        child.join()


def squared(number: int) -> int:
    return number**2


def slowly_squared(number: int) -> tuple[int, int]:
    time.sleep(0.05)
    return os.getpid(), number**2


def noted(work: tuple[str, int]) -> int:
    """Leaves a line for the item and who did it."""
    folder, number = work
    descriptor = os.open(Path(folder) / "done", os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(descriptor, f"{number} {os.getpid()}\n".encode())
    os.close(descriptor)
    return number


def killed_where_not(work: tuple[int, int]) -> tuple[int, int]:
    """Dies in any other process than the one that is named."""
    worker, number = work
    if os.getpid() != worker:
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.05)
    return os.getpid(), number


class Unpicklable(Exception):
    def __init__(self, one: str, two: str) -> None:
        super().__init__(f"{one} and {two}")


def failing(number: int) -> int:
    time.sleep(0.02)
    if number % 4 == 3:
        raise ValueError(f"item {number}")
    return number


def oddly_failing(number: int) -> tuple[int, int]:
    time.sleep(0.02)
    if number > 1:
        raise Unpicklable("this", f"that of {number}")
    return os.getpid(), number


def unsendable(number: int) -> object:
    time.sleep(0.02)
    return (lambda: number) if number == 2 else number


@pytest.mark.whole
def test_every_item_is_done_once_and_in_order(crew: Crew, tmp_path: Path) -> None:
    for count in (2, 3, 100, 5000):
        (tmp_path / str(count)).mkdir()
        items = [(str(tmp_path / str(count)), number) for number in range(count)]
        assert crew.spread(noted, items) == list(range(count))
        lines = [line.split() for line in (tmp_path / str(count) / "done").read_text().splitlines()]
        assert Counter(int(number) for number, _ in lines) == Counter(range(count)), "each once"
    assert {int(process) for _, process in lines} == {os.getpid(), *helpers()}, "by both"
    assert (crew.spread(squared, []), crew.spread(squared, [3])) == ([], [9])


@pytest.mark.whole
def test_the_error_is_that_of_the_first_item_that_has_one(crew: Crew) -> None:
    for _ in range(5):
        with pytest.raises(ValueError, match=r"item 3$"):
            crew.spread(failing, range(20))
    with pytest.raises((Unpicklable, RuntimeError), match=r"this and that of 2$"):
        crew.spread(oddly_failing, range(6))
    assert [number for _, number in crew.spread(slowly_squared, range(6))] == [n**2 for n in range(6)], "and nothing is left over"


@pytest.mark.whole
def test_what_cannot_be_sent_is_an_error_or_the_workers_own(crew: Crew) -> None:
    def made_by_this_process() -> None:
        while True:  # until it falls to the helper: what this process makes it need not send
            assert callable(crew.spread(unsendable, range(5))[2])

    with pytest.raises(Exception, match=r"pickle"):
        made_by_this_process()
    assert crew.spread(squared, range(5)) == [n**2 for n in range(5)]


@pytest.mark.whole
def test_what_a_lost_helper_had_claimed_is_done_and_another_takes_its_place(crew: Crew) -> None:
    before = helpers()
    done = crew.spread(killed_where_not, [(os.getpid(), number) for number in range(10)])
    assert done == [(os.getpid(), number) for number in range(10)]
    while len({process for process, _ in crew.spread(slowly_squared, range(4))}) < 2:
        pass
    assert not set(helpers()) & set(before)


@pytest.mark.whole
def test_a_helper_that_is_still_starting_is_not_waited_for() -> None:
    crew = Crew(1)
    psutil.Process(helpers()[0]).suspend()
    for round_ in range(50):
        assert crew.spread(squared, range(round_)) == [n**2 for n in range(round_)]
    psutil.Process(helpers()[0]).resume()
    while len({process for process, _ in crew.spread(slowly_squared, range(4))}) < 2:
        pass  # it finds its way through rounds that are over
    end_helpers()


def with_a_crew(folder: str) -> tuple[list[int], list[int]]:
    return crew_of(3)(noted, [(folder, number) for number in range(8)]), helpers()


@pytest.mark.whole
def test_helpers_end_with_their_worker(tmp_path: Path) -> None:
    with WorkerPool(1) as pool:
        done, left = pool.call(with_a_crew, str(tmp_path), timeout=LIMIT)
        assert (done, len(left)) == (list(range(8)), 2)
    assert not psutil.wait_procs([psutil.Process(pid) for pid in left if psutil.pid_exists(pid)], timeout=LIMIT)[1]


def test_one_process_does_without() -> None:
    assert crew_of(1)(lambda number: number + 1, [1, 2]) == [2, 3], "nothing is sent"
