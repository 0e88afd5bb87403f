"""Answers that other annotation tools exported: whose they are, which of them holds, and what is left out."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from datetime import datetime

from schemas.errors import InputError
from tasks.annotation.batch import AnnotationBatch, AnnotatorAnswer

LONGEST_NAME = 100
"""Characters of an annotator's name, as in `batch.schema.json`."""

LONGEST_SECONDS = 86_400.0
"""A day, as in `batch.schema.json`: a page that was left open for longer measured nothing."""

SLOTS = tuple(str(slot) for slot in range(1, 11))
NONE = "none"
"""What candidates are called in the tools, and that none of them fits."""


@dataclasses.dataclass(frozen=True)
class Accounts:
    """Who is who: names of annotators by what a tool calls them, and who answered where it calls them nothing or by a number."""

    names: Mapping[str, str]
    unnamed: str | None = None


@dataclasses.dataclass(frozen=True)
class ExportedAnswer:
    """An answer as a tool exported it.

    `accounts`: what the tool calls who gave it, the most telling first. `choice` and `ranking` are slots. `where` is its place in the
    export; `object_field`, `account_field` and `time_field` are those of what it answers for, of who gave it and of when.
    """

    batch_id: str
    scene_id: str
    instance_id: str
    accounts: tuple[str, ...]
    answered_at: datetime
    choice: int | None
    ranking: tuple[int, ...]
    seconds: float | None
    where: str
    object_field: str
    account_field: str
    time_field: str


@dataclasses.dataclass(frozen=True)
class ExportedBatch:
    """The answers that are taken from an export, and what is not, a line each."""

    batch: AnnotationBatch
    left_out: tuple[str, ...]


def accounts_of(values: Sequence[str]) -> Accounts:
    """Who is who, from texts `NAME` and `ACCOUNT=NAME`.

    Raises:
        InputError: a name cannot be one, or two are given for one account.
    """
    names: dict[str, str] = {}
    for value in values:
        account, _, name = value.rpartition("=")
        account, name = account.strip(), name.strip()
        if not name or not name.isprintable() or len(name) > LONGEST_NAME:
            raise InputError("--annotator", repr(value[:60]), "is no name", f"give NAME or ACCOUNT=NAME, up to {LONGEST_NAME} letters")
        if names.setdefault(account, name) != name:
            problem = f"{account or 'who has no name'} is {names[account]!r} and {name!r}"
            raise InputError("--annotator", repr(value[:60]), problem, "give ACCOUNT=NAME for each of them")
    return Accounts({account: name for account, name in names.items() if account}, names.get(""))


def ranking_of(choice: int | None, after: Sequence[int], file: str, field: str) -> tuple[int, ...]:
    """A ranking that begins with the choice, from the candidates that come after it; they may begin with the choice themselves.

    Raises:
        InputError: a candidate is in it twice.
    """
    if not after:
        return ()
    ranking = tuple(after) if choice is None or after[0] == choice else (choice, *after)
    repeated = next((slot for slot in ranking if ranking.count(slot) > 1), None)
    if repeated is not None:
        raise InputError(file, field, f"ranks candidate {repeated} twice", "rank every candidate once, after the choice")
    return ranking


def exported_batch(
    answers: Sequence[ExportedAnswer], left_out: Sequence[str], file: str, accounts: Accounts, tool: str, is_dated: bool = True
) -> ExportedBatch:
    """The batch that exported answers are. Of one annotator's answers for an object the last one holds, earlier ones are left out.

    `is_dated`: every answer has a time of its own, and not that of the export.

    Raises:
        InputError: there is none, they are of several batches, nobody can tell whose one is or which of two holds, or `accounts` has
            somebody who gave none.
    """
    lines = list(left_out)
    if not answers:
        raise InputError(file, "answers", f"none can be taken{': ' + lines[0] if lines else ''}", "export answers with a choice")
    batch_id = answers[0].batch_id
    for answer in answers:
        if answer.batch_id != batch_id:
            problem = f"is of batch {answer.batch_id!r}, and {answers[0].object_field} of {batch_id!r}"
            raise InputError(file, answer.object_field, problem, "export every batch for itself")
    last: dict[tuple[str, str, str], tuple[ExportedAnswer, AnnotatorAnswer]] = {}
    for answer, name in zip(answers, _annotators(answers, file, accounts), strict=True):
        seconds = answer.seconds
        if seconds is not None and seconds > LONGEST_SECONDS:
            lines.append(f"{answer.where}: its time of {seconds:.0f} s, which is more than a day")
            seconds = None
        row = AnnotatorAnswer(
            answer.scene_id, answer.instance_id, name, answer.answered_at, answer.choice, None, None, answer.ranking, file, answer.where,
            seconds=seconds, tool=tool,
        )  # fmt: skip
        key = (answer.scene_id, answer.instance_id, name)
        before = last.get(key)
        if before is not None:
            lines.append(_outdated(before[0], answer, name, file))
        if before is None or answer.answered_at > before[0].answered_at:
            last[key] = (answer, row)
    return ExportedBatch(AnnotationBatch(batch_id, tuple(row for _, row in last.values()), is_dated), tuple(lines))


def _annotators(answers: Sequence[ExportedAnswer], file: str, accounts: Accounts) -> list[str]:
    """Whose each answer is."""
    names, used = [], set()
    unnamed: ExportedAnswer | None = None
    for answer in answers:
        account = next((account for account in answer.accounts if account in accounts.names), None)
        if account is not None:
            used.add(account)
            names.append(accounts.names[account])
            continue
        own = next((account for account in answer.accounts if not account.isdigit()), None)
        if own is None and accounts.unnamed is None:
            who = f"says no more of who answered than {answer.accounts[0]!r}" if answer.accounts else "does not say who answered"
            remedy = f"--annotator {answer.accounts[0]}=NAME" if answer.accounts else "--annotator NAME"
            raise InputError(file, answer.account_field, who, f"give {remedy}")
        if own is None:
            unnamed = unnamed or answer
            if answer.accounts != unnamed.accounts:
                problem = f"is {_called(answer)}, and {unnamed.account_field} is {_called(unnamed)}: one name is not enough"
                raise InputError(file, answer.account_field, problem, "give --annotator ACCOUNT=NAME for each of them")
        names.append(own or str(accounts.unnamed))
    known = ", ".join(sorted({account for answer in answers for account in answer.accounts[:1]})[:10]) or "nobody by a name"
    absent = sorted(set(accounts.names) - used)
    if absent:
        raise InputError("--annotator", absent[0], f"gave no answer in {file}, which has {known}", "correct it, or leave it out")
    if accounts.unnamed is not None and unnamed is None:
        problem = f"is not needed: {file} says who answered ({known})"
        raise InputError("--annotator", accounts.unnamed, problem, "leave it out, or give ACCOUNT=NAME to change a name")
    return names


def _called(answer: ExportedAnswer) -> str:
    return repr(answer.accounts[0]) if answer.accounts else "empty"


def _outdated(first: ExportedAnswer, second: ExportedAnswer, name: str, file: str) -> str:
    """Say which of two answers of one annotator for one object does not hold.

    Raises:
        InputError: one cannot tell, as they differ and are of the same time.
    """
    if first.answered_at == second.answered_at and (first.choice, first.ranking) != (second.choice, second.ranking):
        problem = f"is that of {first.where}, too, in which {name} answers otherwise for {first.scene_id} {first.instance_id}"
        raise InputError(file, second.time_field, problem, "leave out the one that does not hold")
    older, newer = (first, second) if second.answered_at > first.answered_at else (second, first)
    return f"{older.where}: {name} answers for {older.scene_id} {older.instance_id} in {newer.where}, too, and no earlier"
