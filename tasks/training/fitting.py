"""Fitting a network to what an objective asks of it: one loop for all learned systems, which goes on to the same bytes after a kill.

Lightning Fabric owns what is hard and not ours: device, precision, and several devices or machines. The loop itself is written here. A
trainer that owns it keeps the place in the data, in the random generators and in its callbacks as state of its own, which is the same
after a resume only as far as every one of them saves it. Here a batch, and all that is drawn in a step, is a function of (seed, step):
the number of the step, the weights and the optimizer's moments are the whole state, and on a CPU the weights are the same bit for bit
whether training was killed or not, and whoever loaded the batches.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol

from pydantic import Field

from tasks.models import identity_json
from tasks.settings import LISTED, Config, Count, Natural, NonNegative, Positive
from tasks.training.checkpoints import forget, keep, newest
from tasks.training.devices import check_installed, fabric_for, quiet_torch, seed_of, seeded
from tasks.training.trained import Diverged, StepLoss
from tasks.weights import to_safetensors

__all__ = [
    "Fitted", "FittingConfig", "Objective", "check_installed", "fit", "forget", "learning_rate_at", "seed_of", "seeded", "weights_of",
]  # fmt: skip

if TYPE_CHECKING:
    from torch import Tensor, nn

Decay = Annotated[float, Field(ge=0, lt=1)]
Betas = Annotated[tuple[Decay, Decay], LISTED]


@dataclasses.dataclass(frozen=True)
class FittingConfig(Config):
    """How a network is fitted: AdamW, a linear warmup, then half a cosine."""

    steps: Count = 1000  # a small network sees some tens of thousands of examples
    learning_rate: Positive = 1e-3  # the peak; usual for AdamW on small networks from scratch
    warmup_steps: Natural = 50  # AdamW's moments mean little before some tens of steps
    final_learning_rate: NonNegative = 1e-5  # a hundredth of the peak: the last steps settle
    weight_decay: NonNegative = 0.05  # of matrices alone; biases, norms and scales are left
    betas: Betas = (0.9, 0.98)  # a second moment over some fifty steps follows the short schedules here
    eps: Positive = 1e-8  # AdamW's own
    clip_norm: Positive = 1.0  # of the gradients; one odd batch does not undo many steps
    averaging: Decay = 0.0  # how much of the mean of weights stays in a step; 0: no mean, as a falling step size averages, too
    checkpoint_steps: Count = 100  # a kill costs at most these; changes no weight
    validate_steps: Count = 100  # how often held-out examples are looked at, to keep the best weights
    record_steps: Count = 10  # a point of the loss curve is the mean of these
    device: Literal["auto", "cpu", "cuda"] = "auto"  # the graphics card where there is one
    precision: Literal["32", "bf16-mixed"] = "32"  # the other one is for cards; on a CPU it is slower
    threads: Count = 1  # of torch on a CPU: sums are in another order with others, so that it is a part of what weights follow from
    workers: Natural = 0  # processes that make batches while others are learned from; change no weight

    idle: ClassVar[tuple[str, ...]] = ("workers", "checkpoint_steps")


class Objective(Protocol):
    """What a network is asked to be good at. Picklable: devices and processes that load get copies of it."""

    def batch(self, step: int) -> Any:
        """Examples of a step, from 0: picklable CPU tensors, in tuples, lists or dictionaries; a pure function of (seed, step).

        What is drawn is drawn from a generator that is seeded by these. It may be called in another process.
        """

    def loss(self, module: nn.Module, batch: Any) -> tuple[Tensor, dict[str, float]]:
        """What is minimized, and parts of it for the curve. Calls the module itself, not methods of it, so that devices are in step."""

    def validate(self, module: nn.Module) -> float | None:
        """How good the network is on examples that are held out of training, higher is better; None where nobody looks.

        The module is on its device and in evaluation; nothing is drawn and no gradient taken.
        """


@dataclasses.dataclass(frozen=True)
class Fitted:
    """What came of fitting. state_dict: The best weights, of the step `best_step`, on the CPU; with `averaging` those of the mean, which
    are also what is validated. seconds: Of all beginnings [s].

    validation: What the best weights reached; None where nobody looked, so that the last are the best.
    """

    state_dict: Mapping[str, Tensor]
    steps: tuple[StepLoss, ...]
    best_step: int
    validation: float | None
    device: str
    seconds: float


def weights_of(state_dict: Mapping[str, Tensor], half: bool = False) -> bytes:
    """Tensors by name as safetensors; with `half` all floats in half precision, which is what small shipped models have."""
    import torch

    arrays = {}
    for name, tensor in state_dict.items():
        value = tensor.detach().cpu()
        if value.is_floating_point():
            value = value.half() if half else value.float() if value.dtype == torch.bfloat16 else value
        arrays[name] = value.numpy()
    return to_safetensors(arrays)


def learning_rate_at(step: int, config: FittingConfig) -> float:
    """Step size in a step, from 0: it rises for `warmup_steps`, then falls as half a cosine, to the final one in the last step."""
    if step < config.warmup_steps:
        return config.learning_rate * (step + 1) / config.warmup_steps
    share = (step + 1 - config.warmup_steps) / max(config.steps - config.warmup_steps, 1)
    low, high = min(config.final_learning_rate, config.learning_rate), config.learning_rate
    return low + (high - low) * 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0)))


def decay_at(step: int, decay: float) -> float:
    """How much of the mean of weights stays after a step, from 0: less at first, so that what was drawn is soon forgotten."""
    return min(decay, (1.0 + step) / (10.0 + step))


def fit(
    module: nn.Module,
    objective: Objective,
    config: FittingConfig,
    *,
    seed: int,
    checkpoints: MutableMapping[str, bytes],
    key: str,
    report: Callable[[int, int, str], None],
) -> Fitted:
    """Fit a network, going on from the newest checkpoint of `key` where there is one.

    `module` holds its initial weights, which the caller seeded (`seeded`); parameters that need no gradient are left alone and are in
    no checkpoint. Two checkpoints are kept, the last one also when all is done, until `forget`. Where several processes are at it
    (`torchrun`, `fabric run`), each takes batches of its own, `step * processes + rank`, and all return the same.

    Raises:
        InputError: torch is not installed, or the device is not there.
        Diverged: the loss is no finite number any more.
    """
    check_installed()
    import torch

    with quiet_torch(config):
        fabric = fabric_for(config)
        fabric.launch()
        run = _Run(module, config, seed, fabric)
        mark = f"{identity_json(config)}|{seed}|{fabric.world_size}"
        run.resume(newest(checkpoints, key, mark) if fabric.is_global_zero else None)
        clock = time.perf_counter()
        for batch in _loader(objective, config, seed, run.step, fabric):
            run.advance(objective, fabric.to_device(batch), clock)
            clock = time.perf_counter()
            is_last = run.step == config.steps
            if run.step % config.validate_steps == 0 or is_last:
                run.validate(objective)
                run.seconds, clock = run.seconds + time.perf_counter() - clock, time.perf_counter()
            if (run.step % config.checkpoint_steps == 0 or is_last) and fabric.is_global_zero:
                keep(checkpoints, key, run.step, run.state(mark))
            report(run.step, config.steps, f"loss {run.losses[-1][0]:.4g}")
        fabric.barrier()
        name = "cpu" if fabric.device.type == "cpu" else torch.cuda.get_device_name(fabric.device)
        return run.fitted(name if fabric.world_size == 1 else f"{fabric.world_size} x {name}")


class _Run:
    """The state of a fit: what a checkpoint holds, and no more."""

    def __init__(self, module: nn.Module, config: FittingConfig, seed: int, fabric: Any) -> None:
        import torch

        self.config, self.seed, self.fabric, self.plain = config, seed, fabric, module
        learned = [parameter for parameter in module.parameters() if parameter.requires_grad]
        decayed = [parameter for parameter in learned if parameter.ndim >= 2]
        plain = [parameter for parameter in learned if parameter.ndim < 2]
        groups = [{"params": decayed, "weight_decay": config.weight_decay}, {"params": plain, "weight_decay": 0.0}]
        optimizer = torch.optim.AdamW([group for group in groups if group["params"]], lr=0.0, betas=config.betas, eps=config.eps)
        self.module, self.optimizer = fabric.setup(module, optimizer)
        self.frozen = {name for name, parameter in module.named_parameters() if not parameter.requires_grad}
        self.step, self.seconds = 0, 0.0
        self.losses: list[tuple[float, dict[str, float], float, float]] = []
        self.validations: dict[int, float] = {}
        self.best: dict[str, Tensor] = {}
        self.best_step = 0
        self.mean: dict[str, Tensor] = self._learned() if config.averaging else {}

    def advance(self, objective: Objective, batch: Any, clock: float) -> None:
        """One step on a batch; `clock`: when the wait for it began."""
        import torch

        rate = learning_rate_at(self.step, self.config)
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.module.train()
        torch.manual_seed(seed_of(self.seed, "step", self.step, self.fabric.global_rank))
        loss, parts = objective.loss(self.module, batch)
        value = float(loss.detach())
        if not math.isfinite(value):
            raise Diverged("training", "loss", f"is {value} in step {self.step}", "lower learning_rate, or raise warmup_steps")
        self.fabric.backward(loss)
        self.fabric.clip_gradients(self.module, self.optimizer, max_norm=self.config.clip_norm, error_if_nonfinite=False)
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        self._average()
        seconds = time.perf_counter() - clock
        self.losses.append((value, {name: float(part) for name, part in parts.items()}, rate, seconds))
        self.seconds += seconds
        self.step += 1

    def validate(self, objective: Objective) -> None:
        """Look at what is held out, and keep the weights if they are the best so far."""
        import torch

        clock = time.perf_counter()
        self.plain.eval()
        with torch.no_grad(), seeded(self.seed, "validation"), self._averaged():
            value = objective.validate(self.plain)
        if value is not None and math.isfinite(value):
            if value > max(self.validations.values(), default=-math.inf):
                self.best, self.best_step = self._result(), self.step
            self.validations[self.step] = float(value)
        self.seconds += time.perf_counter() - clock

    def state(self, mark: str) -> bytes:
        """The checkpoint."""
        import torch

        facts = {
            "mark": mark, "step": self.step, "losses": self.losses, "validations": list(self.validations.items()),
            "best_step": self.best_step, "seconds": self.seconds,
        }  # fmt: skip
        file = io.BytesIO()
        tensors = {"weights": self._weights(), "mean": self.mean, "best": self.best, "optimizer": self.optimizer.state_dict()}
        torch.save({"facts": json.dumps(facts), **tensors}, file)
        return file.getvalue()

    def resume(self, read: tuple[dict[str, Any], dict[str, Any]] | None) -> None:
        """Take up what a checkpoint holds; of several processes that of the first."""
        read = self.fabric.broadcast(read)
        if read is None:
            return
        facts, tensors = read
        self.plain.load_state_dict({**self._frozen(), **tensors["weights"]})
        self.optimizer.load_state_dict(tensors["optimizer"])
        self.mean = {name: tensor.to(self.fabric.device) for name, tensor in tensors["mean"].items()}
        self.best, self.best_step = tensors["best"], facts["best_step"]
        self.step, self.seconds = facts["step"], facts["seconds"]
        self.losses = [(loss, parts, rate, seconds) for loss, parts, rate, seconds in facts["losses"]]
        self.validations = dict(facts["validations"])

    def fitted(self, device: str) -> Fitted:
        """What came of it."""
        weights = self.best if self.validations else self._result()
        best_step = self.best_step if self.validations else self.step
        state = {name: tensor.detach().cpu().clone() for name, tensor in {**self._frozen(), **weights}.items()}
        ordered = {name: state[name] for name in self.plain.state_dict()}
        return Fitted(ordered, self._curve(), best_step, self.validations.get(best_step), device, self.seconds)

    def _average(self) -> None:
        """Take the weights of a step into their mean; what is counted is taken as it is."""
        import torch

        decay = decay_at(self.step, self.config.averaging)
        with torch.no_grad():
            for name, tensor in self._learned().items() if self.mean else ():
                mean = self.mean[name]
                mean.copy_(decay * mean + (1.0 - decay) * tensor if mean.is_floating_point() else tensor)

    @contextlib.contextmanager
    def _averaged(self) -> Iterator[None]:
        """The network has the mean of its weights inside, where there is one."""
        last = self._learned() if self.mean else {}
        self.plain.load_state_dict(self.mean, strict=False)
        try:
            yield
        finally:
            self.plain.load_state_dict(last, strict=False)

    def _learned(self) -> dict[str, Tensor]:
        """A copy of all that is learned or counted, where it is."""
        return {name: tensor.detach().clone() for name, tensor in self.plain.state_dict().items() if name not in self.frozen}

    def _result(self) -> dict[str, Tensor]:
        """Weights that are validated and given back, on the CPU."""
        return {name: tensor.cpu().clone() for name, tensor in self.mean.items()} if self.mean else self._weights()

    def _weights(self) -> dict[str, Tensor]:
        """A copy of all that is learned or counted, on the CPU."""
        return {name: tensor.detach().cpu().clone() for name, tensor in self.plain.state_dict().items() if name not in self.frozen}

    def _frozen(self) -> dict[str, Tensor]:
        return {name: tensor for name, tensor in self.plain.state_dict().items() if name in self.frozen}

    def _curve(self) -> tuple[StepLoss, ...]:
        """Means over `record_steps` steps each; the last point has what is left."""
        points, size = [], self.config.record_steps
        for first in range(0, len(self.losses), size):
            part = self.losses[first : first + size]
            last = first + len(part)
            names = sorted({name for _, parts, _, _ in part for name in parts})
            means = {name: _mean([parts[name] for _, parts, _, _ in part if name in parts]) for name in names}
            looked = [value for step, value in self.validations.items() if first < step <= last]
            points.append(
                StepLoss(
                    step=last, loss=_mean([loss for loss, *_ in part]), parts=means, learning_rate=part[-1][2],
                    seconds=math.fsum(seconds for *_, seconds in part), validation=looked[-1] if looked else None,
                )
            )  # fmt: skip
        return tuple(points)


def _mean(values: list[float]) -> float:
    return math.fsum(values) / len(values)


class _Batches:
    """Batches by step, as torch's loader asks for them, here or in its processes: made with one thread and a generator of their own."""

    def __init__(self, objective: Objective, seed: int) -> None:
        self._objective, self._seed = objective, seed

    def __getitem__(self, step: int) -> Any:
        import torch

        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            with torch.random.fork_rng(devices=[]):
                torch.manual_seed(seed_of(self._seed, "batch", step))
                return self._objective.batch(step)
        finally:
            torch.set_num_threads(threads)


def _loader(objective: Objective, config: FittingConfig, seed: int, first: int, fabric: Any) -> Any:
    """Batches of the steps from `first` on, in order; of several processes those of this one."""
    import torch
    from torch.utils.data import DataLoader

    steps = [step * fabric.world_size + fabric.global_rank for step in range(first, config.steps)]
    return DataLoader(
        _Batches(objective, seed),  # type: ignore[arg-type]
        batch_size=None,
        sampler=steps,
        num_workers=min(config.workers, len(steps)),
        multiprocessing_context="spawn" if config.workers and steps else None,  # a fork inherits threads' locks, but not the threads
        generator=torch.Generator().manual_seed(seed_of(seed, "loader")),
    )
