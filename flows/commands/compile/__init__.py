"""`metascenes compile`: the machine code of a run, made before its first scene."""

from __future__ import annotations

import json
import time

import click

from flows.commands.options import json_option, workers_option
from schemas.wording import counted


@click.command("compile", short_help="Compile what runs compute with, once for this machine.")
@workers_option
@json_option
def command(workers: int, as_json: bool) -> None:
    """Compile the loops that runs compute with, once for this machine and version.

    Without it, each worker does so as it comes to them, which makes the first scene a minute longer. For images of containers, and
    before many workers start at once. The code lies in NUMBA_CACHE_DIR, else beside the
    package, else in your cache folder.

    Example: metascenes compile
    """
    from flows.progress import Progress
    from flows.run.fingerprints import code_fingerprint
    from flows.run.pool import spread_over
    from tasks.kernels.ahead import compile_ahead, signatures
    from tasks.pipeline import MODULES

    clock, kernels = time.perf_counter(), signatures()
    for module in MODULES.values():  # what every plan asks for; it is remembered
        code_fingerprint(module)
    with Progress("compiling", len(kernels)) as progress:
        made = sum(spread_over(workers, lambda _done, _of: progress.advance())(compile_ahead, kernels))
    seconds = time.perf_counter() - clock
    if as_json:
        print(json.dumps({"kernels": len(kernels), "compiled": made, "seconds": seconds}))
    else:
        print(f"{counted(len(kernels), 'kernel')}: {made} compiled, {len(kernels) - made} there before, {seconds:.0f} s")
