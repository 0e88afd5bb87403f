"""`make fuzz`: inputs for every reader of files of others, and a table of what came of them and what the worst took."""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.fuzzing.campaign import Campaign, Record
from tests.fuzzing.targets import targets


def main(arguments: Sequence[str] | None = None) -> int:
    """Fuzz. Exit code 1: an input failed; 2: there is no such target."""
    parser = argparse.ArgumentParser(prog="make fuzz", description=__doc__)
    parser.add_argument("--targets", default="", help="only those whose name begins so, separated by commas, in that order")
    parser.add_argument("--count", type=int, default=0, help="inputs for each, instead of 10,000 (1,000 where whole stages run)")
    parser.add_argument("--minutes", type=float, default=24 * 60, help="stop after so many; the same command goes on where it stopped")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1, help="targets at once")
    parser.add_argument("--out", type=Path, default=Path("fuzz"), help="folder for records and inputs that failed")
    parser.add_argument("--fresh", action="store_true", help="begin anew")
    parser.add_argument("--json", action="store_true", help="the table as JSON")
    parser.add_argument("--list", action="store_true", help="only say what there is")
    told = parser.parse_args(arguments)
    wanted = [word.strip() for word in told.targets.split(",") if word.strip()]
    found = {name: one for word in wanted or [""] for name, one in targets().items() if name.startswith(word)}
    if not found:
        print(f"no target begins with {' or '.join(wanted)}: there are {', '.join(targets())}", file=sys.stderr)
        return 2
    counts = {name: told.count or one.count for name, one in found.items()}
    if told.list:
        print("\n".join(f"{name:<22}{count:>8}" for name, count in counts.items()))
        return 0
    campaign = Campaign(told.out, counts, told.seed, told.fresh)
    campaign.run(told.jobs, told.minutes, lambda record: print(_line(record), file=sys.stderr, flush=True))
    records = list(campaign.records.values())
    print(json.dumps([dataclasses.asdict(one) for one in records], indent=1) if told.json else as_table(records))
    for record in records:
        for failure in record.failures.values():
            print(f"{record.name}: {failure.times} times: {failure.error[:160]} ({failure.where})", file=sys.stderr)
    return int(any(record.failed for record in records))


def as_table(records: Sequence[Record]) -> str:
    """What came of every target."""
    head = f"{'reader':<22}{'inputs':>8}{'of':>8}{'read':>8}{'refused':>9}{'failed':>8}{'worst s':>9}{'worst MB':>10}{'minutes':>9}"
    return "\n".join([head, *(_line(record) for record in records)])


def _line(record: Record) -> str:
    counts = f"{record.inputs:>8}{record.wanted:>8}{record.read:>8}{record.refused:>9}{record.failed:>8}"
    return f"{record.name:<22}{counts}{record.seconds:>9.2f}{record.bytes / 1e6:>10.0f}{record.clock / 60:>9.1f}"


if __name__ == "__main__":
    sys.exit(main())
