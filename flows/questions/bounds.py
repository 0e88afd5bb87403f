"""What a question may take: time, memory, and no longer than somebody waits; and the file that its answer becomes."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, TypeVar

if TYPE_CHECKING:
    from warehouse.questions.answers import Output
    from warehouse.questions.attached import Attached
    from warehouse.tables.snapshot import Reader

T = TypeVar("T")

_GRACE = 10.0  # s; DuckDB looks up from its work at least that often, unless a single value takes it longer

_SLACK = 2**30  # B; threads and allocators reserve more addresses than they use

_LOOK = 0.05  # s; how often the end of a question that was interrupted is looked for


@dataclasses.dataclass(frozen=True)
class Bounds:
    """timeout: Seconds until a question is ended; 0 waits for ever. memory: GB that it may use."""

    timeout: float
    memory: float


def write_bounded(
    sink: BinaryIO, reader: Reader, sql: str, form: Output, most: int, bounds: Bounds, attached: Sequence[Attached] = ()
) -> int:
    """Write the answer to SQL on a snapshot into `sink`; how many rows it has. `most`: rows that are shown; 0 shows all.

    Raises:
        InputError: see `warehouse.questions.sql.ask`.
        KeyboardInterrupt: Ctrl-C; the question has ended.
    """
    from warehouse.questions.answers import write_answer
    from warehouse.questions.sql import ask

    def work(begun: Callable[[Callable[[], None]], None]) -> int:
        # Deep inside of one value DuckDB neither counts its memory nor looks at the clock, so the process has bounds of its own.
        with contextlib.ExitStack() as stack:
            stack.enter_context(_ended_after(bounds.timeout + _GRACE if bounds.timeout else None, bounds.timeout))
            stack.enter_context(_bounded_memory(int(bounds.memory * 2**30)))
            answer = stack.enter_context(
                ask(reader, sql, timeout=bounds.timeout or None, memory_mb=int(bounds.memory * 700), attached=attached, begun=begun)
            )
            rows = write_answer(answer, form, sink, most or None)
            sink.flush()
            return rows

    return _interruptible(work)


def _interruptible(work: Callable[[Callable[[Callable[[], None]], None]], T]) -> T:
    """What work gives, done in another thread: DuckDB holds up the signals of the one that it works in. `work` hands over what ends it."""
    ends: list[Callable[[], None]] = []
    done: Future[T] = Future()

    def carry_out() -> None:
        try:
            done.set_result(work(ends.append))
        except BaseException as error:
            for each in (error, error.__cause__, error.__context__):
                if each is not None:  # a connection that is held as the process ends makes DuckDB abort it
                    traceback.clear_frames(each.__traceback__)
            done.set_exception(error)
        finally:
            ends.clear()

    thread = threading.Thread(target=carry_out, daemon=True)
    with _interrupts() as heard:
        thread.start()
        try:
            heard(True)
            while not done.done():  # never for ever: a signal that comes just before the wait does not end it
                wait([done], _LOOK)
            result = done.result()
        except KeyboardInterrupt:
            heard(False)
            while not done.done():
                for end in [*ends]:  # again and again: before DuckDB begins it does not listen
                    end()
                wait([done], _LOOK)
            raise
        finally:
            thread.join()
    return result


@contextlib.contextmanager
def _interrupts() -> Iterator[Callable[[bool], None]]:
    """Let Ctrl-C wait until it is to be heard: in the middle of the start of a thread nobody could tell whether there is one."""
    is_heard = was_hit = False

    def hear(wanted: bool) -> None:
        nonlocal is_heard
        is_heard = wanted
        if wanted and was_hit:
            raise KeyboardInterrupt

    def hit(_number: int, _frame: object) -> None:
        nonlocal was_hit
        was_hit = True
        if is_heard:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield lambda wanted: None  # somebody else hears it, or nobody
        return
    signal.signal(signal.SIGINT, hit)
    try:
        yield hear
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextlib.contextmanager
def whole_file(path: Path, force: bool, lake: Path | None) -> Iterator[BinaryIO]:
    """A file that gets its name when all of it is written; nothing stays of one that is not.

    Raises:
        InputError: it is there already, lies in the lake, or cannot be made.
    """
    from schemas.errors import InputError

    target = Path(os.path.realpath(path))
    if lake is not None and target.is_relative_to(os.path.realpath(lake)):
        raise InputError(str(path), "--out", "lies in the lake, which only its own commands write to", "choose another folder")
    taken = InputError(str(path), "--out", "is there already", "choose another name, or --force")
    if target.is_dir() or (target.exists() and not force):
        raise taken
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    _leftovers.add(temporary)
    try:
        try:
            handle = open(temporary, "xb")  # noqa: SIM115  # closed below: only what goes wrong here is the folder's fault
        except OSError as error:
            raise InputError(str(path), "--out", f"cannot be made ({error.strerror or error})", "choose another folder") from error
        with handle:
            yield handle
            handle.flush()
            os.fsync(handle.fileno())
        if force:
            os.replace(temporary, target)
            return
        try:
            os.link(temporary, target)  # fails when another one was faster
        except FileExistsError:
            raise taken from None
        except OSError:  # no hard links on this file system
            os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)
        _leftovers.discard(temporary)


_leftovers: set[Path] = set()


@contextlib.contextmanager
def _ended_after(seconds: float | None, timeout: float) -> Iterator[None]:
    """End the process after so many seconds, for what cannot be interrupted."""

    def end() -> None:
        for path in _leftovers:
            path.unlink(missing_ok=True)
        print(f"metascenes: SQL: it takes longer than {timeout:g} s; ask for less, or give it more time", file=sys.stderr, flush=True)
        os._exit(2)

    timer = threading.Timer(seconds, end) if seconds else None
    if timer:
        timer.daemon = True
        timer.start()
    try:
        yield
    finally:
        if timer:
            timer.cancel()
            timer.join()


@contextlib.contextmanager
def _bounded_memory(size: int) -> Iterator[None]:
    """Let the process grow by `size` bytes at most; what would take more fails. Only where the system can say and bound it."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (ImportError, OSError):
        yield
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    most = pages * resource.getpagesize() + size + _SLACK
    limits = [limit for limit in (most, soft, hard) if limit != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(limits), hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
