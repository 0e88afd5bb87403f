"""Loops over numbers as machine code."""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import shutil
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from typing import Any

Kernels = dict[str, Callable[..., Any]]

_COMPILING = threading.RLock()


def compile_kernels(*functions: Callable[..., Any], known: Mapping[str, Callable[..., Any]] | None = None) -> Kernels:
    """Functions of one module as machine code, by name, with those of other modules that they call.

    Compiled code calls only compiled code, so functions are replaced in place in their order: callees come before callers.
    Sums are not reordered: the same numbers on every machine.

    Args:
        functions: Of one module.
        known: Kernels of other modules, put beside the functions under their names.
    """
    import numba

    with _COMPILING:  # another thread may ask for the same functions, or have replaced some of them since these were named
        _keep_apart()
        compiled = numba.njit(nogil=True, error_model="numpy")
        plain = [getattr(function, "py_func", function) for function in functions]
        names, kernels = plain[0].__globals__, dict(known or {})
        names.update(kernels)
        for function in plain:
            present = names[function.__name__]
            kernels[function.__name__] = present if hasattr(present, "py_func") else _kept(compiled(function))
            names[function.__name__] = kernels[function.__name__]
        return kernels


@cache
def _keep_apart() -> None:
    """Cache machine code in a folder of its own for every state of the modules with kernels.

    numba looks at the file of a function alone: code that calls a changed function of another module would stay in use.
    """
    import numba

    rooms = Path(__file__).parent.parent
    sources = {path.relative_to(rooms).as_posix(): path.read_bytes() for path in sorted(rooms.rglob("*.py"))}
    hasher = hashlib.sha256()
    for name, source in sources.items():
        if compile_kernels.__name__.encode() in source:
            hasher.update(name.encode() + b"\0" + source + b"\0")
    folder = Path(numba.config.CACHE_DIR or rooms / "__pycache__")  # type: ignore[attr-defined]
    own = folder / f"kernels-{hasher.hexdigest()[:16]}"
    for former in folder.glob("kernels-*") if folder.is_dir() else ():
        if former != own:
            shutil.rmtree(former, ignore_errors=True)
    numba.config.CACHE_DIR = str(own)  # type: ignore[attr-defined]


def _kept(kernel: Any) -> Any:
    """A kernel whose machine code is kept on the disk for other processes."""
    kernel._cache = _cache_of_machine_code()(kernel.py_func)
    return kernel


@cache
def _cache_of_machine_code() -> type[Any]:
    from numba.core.caching import FunctionCache

    class MachineCode(FunctionCache):
        """Of one function. Processes that save at once wait for each other: numba would give two of them one file, and one the other's."""

        def save_overload(self, sig: Any, data: Any) -> None:
            with _alone(self.cache_path):
                super().save_overload(sig, data)

    return MachineCode


@contextlib.contextmanager
def _alone(folder: str) -> Iterator[None]:
    """Nobody else works in a folder meanwhile."""
    os.makedirs(folder, exist_ok=True)
    with open(os.path.join(folder, "lock"), "wb") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
