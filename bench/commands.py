"""Commands as people give them, in processes of their own, that a benchmark may kill."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from schemas.errors import LakeError
from warehouse.lake import Lake

PATIENCE_SECONDS = 900.0
"""A process that gives no sign for so long hangs."""


class Commands:
    """Commands on a lake, each in an interpreter of its own, with a cache of their own."""

    def __init__(self, lake: Lake, cache: Path) -> None:
        self._lake, self.cache = lake, cache

    def done(self, *words: str) -> dict[str, Any]:
        """What a command answers.

        Raises:
            LakeError: it fails, or hangs.
        """
        process = self._started(words)
        try:
            out, err = process.communicate(timeout=PATIENCE_SECONDS)
        except subprocess.TimeoutExpired as error:
            process.kill()
            raise LakeError(f"{words[0]}: gave no answer in {PATIENCE_SECONDS:g} s") from error
        if process.returncode:
            raise LakeError(f"{words[0]}: exit code {process.returncode}: {(err.strip() or out.strip()).splitlines()[-1:]}")
        answer: dict[str, Any] = json.loads(out)
        return answer

    def killed(self, words: Sequence[str], is_time: Callable[[], bool]) -> int:
        """Kill a command as soon as it is time; 1 where it was killed, 0 where it was done before.

        Raises:
            LakeError: it fails by itself, or its time never comes.
        """
        process, end = self._started(words), time.monotonic() + PATIENCE_SECONDS
        while process.poll() is None and time.monotonic() < end and not is_time():
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
        _, err = process.communicate()
        if process.returncode not in (0, -signal.SIGKILL) or time.monotonic() >= end:
            raise LakeError(f"{words[0]}: exit code {process.returncode} before it was killed: {err.strip().splitlines()[-1:]}")
        return int(process.returncode == -signal.SIGKILL)

    def _started(self, words: Sequence[str]) -> subprocess.Popen[str]:
        root = str(Path(__file__).parents[1])
        around = {**os.environ, "PYTHONPATH": root, "METASCENES_CACHE": str(self.cache)}
        command = [sys.executable, "-m", "flows.cli", *words, "--lake", self._lake.address, "--json"]
        return subprocess.Popen(command, env=around, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
