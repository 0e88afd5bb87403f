"""A generator that is a program: TripoSR, TRELLIS and others in environments of their own, called by a command line (specs B.2)."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar

from schemas.budget import BUDGET
from schemas.errors import InputError
from schemas.files import read_file
from schemas.machine.scratch import temporary_folder
from tasks.calls.command import CommandFailed, filled, run_command, words_of
from tasks.candidates.assets import MadeAsset
from tasks.candidates.generation.generated import GeneratorInput, GeneratorSettings, generated
from tasks.candidates.provider import CandidateProvider
from tasks.containers import GLB_MAGIC
from tasks.settings import Positive

if TYPE_CHECKING:
    from tasks.candidates.request import CandidateRequest

WHERE = "candidates.slots"
"""The settings, as errors name them."""

PLACES = ("image", "prompt", "out", "seed", "folder")
"""What stands in braces in a command line: a PNG file, the text, the GLB file to write, the seed, and the folder of both files."""


@dataclasses.dataclass(frozen=True)
class Commanded(GeneratorSettings):
    """What a program makes that is called for every instance."""

    kind: ClassVar[str] = "commanded"
    command: str = ""  # a command line with {image}, {prompt}, {out} and {seed}; quoted as a shell has it, but none runs it
    output: str = ""  # pattern of the GLB in {folder} where the program chooses the name itself: output/0/mesh.glb
    timeout_seconds: Positive = 900.0  # on a large card a minute; loading the weights takes as long
    version: str = "1"  # goes up when the same answer would make another asset


def _offer(request: CandidateRequest, config: Commanded) -> MadeAsset:
    """What the program makes for an instance."""
    return generated(request, config, config.kind, config.version, lambda asked, begun: made(asked, config, begun), command=config.command)


def made(asked: GeneratorInput, config: Commanded, begun: Callable[[], None]) -> bytes:
    """The GLB that a program writes.

    Raises:
        InputError: the command is none, it fails, takes too long, or writes no GLB.
    """
    words = words_of(config.command, PLACES, WHERE)
    with temporary_folder() as folder:
        out = folder / "model.glb"
        if asked.picture is not None:
            (folder / "image.png").write_bytes(asked.picture)
        values = {
            "image": str(folder / "image.png"), "prompt": asked.text, "out": str(out), "seed": str(asked.seed), "folder": str(folder),
        }  # fmt: skip
        begun()
        try:
            run_command(filled(words, values), folder, config.timeout_seconds)
        except CommandFailed as error:
            raise InputError(WHERE, words[0], str(error), "run it by hand to see more") from error
        files = sorted(folder.glob(config.output)) if config.output else [out]
        if not files or not files[0].is_file():
            raise InputError(WHERE, words[0], f"wrote no {config.output or 'GLB to {out}'}", "let it write there, or say `output`")
        return read_file(files[0], files[0].name, BUDGET.asset_bytes, magic=GLB_MAGIC)


def _label(config: Commanded) -> str:
    return f"{config.kind}:{config.model}" if config.model else config.kind


COMMANDED = CandidateProvider(name="commanded", config=Commanded, offer=_offer, label=_label)
