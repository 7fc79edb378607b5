"""Trains the default detector from rendered photos: `python -m training.train`; see README.md beside this file."""

from __future__ import annotations

import argparse
import copy
import queue
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import torch
from rich.progress import Progress, TextColumn
from torch import Tensor, nn

from training.crops import Batch, random_batch
from training.loss import detection_loss
from training.network import Network
from training.photos import TRAINING_SEEDS, LearningSet, learning_set

MODELS = Path(__file__).parents[1] / "src" / "upwash" / "services" / "models"
SEED = 1
BATCH = 16
THREADS = 1  # two that wait for each other cost more than one on a busy machine
_LEARNING_RATE = 2e-3
_WARM_UP_SHARE = 0.05
_WRITE_EVERY = 250  # steps: what a run that is broken off leaves behind
_AVERAGE_OVER = 300  # steps: the weights that are kept are an average over the last ones
_BACKGROUND_LOGIT = -4.6  # at first every cell holds an object with probability 0.01


def main() -> None:
    """Trains for a number of steps and writes the weights."""
    arguments = _arguments()
    torch.manual_seed(SEED)
    torch.set_num_threads(THREADS)
    network = Network(arguments.cfg)
    _expect_nothing(network)
    learning = learning_set(TRAINING_SEEDS[: arguments.first], arguments.cache)
    for step, average in train(network, learning, steps=arguments.steps):
        if step % _WRITE_EVERY == 0 or step == arguments.steps:
            average.write_weights(arguments.weights, seen=step * BATCH)


def train(network: Network, learning: LearningSet, *, steps: int) -> Iterator[tuple[int, Network]]:
    """Trains the network in place; yields after each step the running average of its weights, the better ones."""
    network.train().to(memory_format=torch.channels_last)
    average = copy.deepcopy(network)
    optimizer = torch.optim.AdamW(network.parameters(), lr=_LEARNING_RATE, weight_decay=5e-4, fused=True)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, _LEARNING_RATE, total_steps=steps, pct_start=_WARM_UP_SHARE
    )
    with Progress(*Progress.get_default_columns(), TextColumn("{task.fields[loss]}")) as progress:
        bar = progress.add_task("training", total=steps, loss="")
        smooth = 0.0
        began_s = time.monotonic()
        for step, batch in enumerate(_batches(learning, steps), start=1):
            loss = _step(network, optimizer, batch)
            schedule.step()
            _blend_in(average, network, share=1 / min(step, _AVERAGE_OVER))
            smooth = loss if step == 1 else 0.98 * smooth + 0.02 * loss
            progress.update(bar, advance=1, loss=f"loss {smooth:.3f}")
            if step % 100 == 0:
                progress.console.print(f"step {step}: loss {smooth:.3f}, {time.monotonic() - began_s:.0f} s")
            yield step, average


def _step(network: Network, optimizer: torch.optim.Optimizer, batch: Batch) -> float:
    photos = torch.from_numpy(batch.crops).permute(0, 3, 1, 2).float() / 255
    with torch.autocast("cpu", torch.bfloat16):
        heads = network(photos.contiguous(memory_format=torch.channels_last))
    loss: Tensor = detection_loss(heads, torch.from_numpy(batch.boxes).float())
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), 10.0)
    optimizer.step()
    return loss.item()


def _batches(learning: LearningSet, steps: int) -> Iterator[Batch]:
    """Prepares batches in a thread beside the training, a few ahead."""
    ready: queue.Queue[Batch] = queue.Queue(maxsize=4)
    rng = np.random.default_rng(SEED)

    def prepare() -> None:
        for _ in range(steps):
            ready.put(random_batch(rng, learning, BATCH))

    threading.Thread(target=prepare, daemon=True).start()
    for _ in range(steps):
        yield ready.get()


@torch.no_grad()
def _blend_in(average: Network, network: Network, *, share: float) -> None:
    for kept, new in zip(average.state_dict().values(), network.state_dict().values(), strict=True):
        if kept.dtype.is_floating_point:
            kept.lerp_(new, share)


def _expect_nothing(network: Network) -> None:
    """Sets the heads' biases, for three anchors each, to what most of a photo shows."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d) and module.bias is not None:
            with torch.no_grad():
                module.bias.view(3, -1)[:, 4] = _BACKGROUND_LOGIT


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cfg", type=Path, default=MODELS / "solar_park.cfg")
    parser.add_argument("--weights", type=Path, default=MODELS / "solar_park.weights", help="file to write")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir(), "upwash-training"))
    parser.add_argument("--first", type=int, metavar="N", help="learn from the first photos only")
    parser.add_argument("--steps", type=int, default=2_000)
    return parser.parse_args()


if __name__ == "__main__":
    main()
