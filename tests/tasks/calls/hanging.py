"""A program that hangs together with one that it began, and who of them is still there."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path


def assert_all_end(folder: Path, end: Callable[[str, float], None]) -> None:
    """Who ends a hanging program ends what it began as well.

    ``end(body, seconds)`` runs a Python program with that body, which has ``sys`` imported, and ends it after that time.
    What was begun has a pipe open for as long as it lives, so that nobody has to look for it, or to wait a certain time.
    """
    lives, ends = folder / "lives", folder / "ends"
    os.mkfifo(lives)
    child = f"import time; print('began', flush=True); time.sleep(60); open({str(ends)!r}, 'w').close()"
    begun = f"subprocess.Popen([sys.executable, '-c', {child!r}], stdout=open({str(lives)!r}, 'w'))"
    body = f"import subprocess, time\n{begun}\ntime.sleep(600)\n"
    said = ""
    for seconds in (2.0, 8.0, 32.0):  # a busy machine may take longer to begin
        reader = os.open(lives, os.O_RDONLY | os.O_NONBLOCK)
        os.set_blocking(reader, True)
        end(body, seconds)
        with open(reader) as file:
            said = file.read()  # returns when nobody has it open for writing
        if said:
            break
    assert said == "began\n"
    assert not ends.exists(), "what the program began was not ended, but came to its end"
