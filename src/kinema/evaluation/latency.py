"""Time how long a method takes from sentences to motions, part by part (MARDM, Table A3; METRICS, AIT)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch

from kinema.devices import synchronize
from kinema.evaluation.counting import NetworkCounter
from kinema.pipeline import TextToMotion

PARTS = ("text", "generation", "decoding")


@dataclass(frozen=True)
class Latency:
    """Hold the seconds that one batch took, by part, and how often it called each of the generator's networks."""

    motions: int
    seconds: dict[str, float]
    calls: dict[str, float]

    @property
    def total(self) -> float:
        """The seconds from the sentences to the motions' features."""
        return sum(self.seconds.values())


@torch.inference_mode()
def measure_latency(
    model: TextToMotion,
    texts: Sequence[str],
    frames: Sequence[int],
    *,
    batch: int,
    warmup: int = 2,
    sampling: Any = None,
    seed: int = 0,
) -> list[Latency]:
    """Time whole batches of sentences of given lengths; what doesn't fill one is left out, `warmup` batches come first.

    Loading is not timed; encoding the text and decoding are. The device is waited for around each part. Raises
    ValueError for fewer texts than a batch.
    """
    if len(texts) < batch:
        raise ValueError(f"{len(texts)} texts do not fill a batch of {batch}; give more texts or a smaller batch")
    model.eval()
    counter, found = NetworkCounter(model.generator.networks), []
    starts = range(0, len(texts) - batch + 1, batch)
    for number, start in enumerate([*[0] * warmup, *starts]):
        rows = slice(start, start + batch)
        latency = _time(model, list(texts[rows]), torch.tensor(frames[rows]), seed + start, sampling, counter)
        if number >= warmup:
            found.append(latency)
    return found


def _time(
    model: TextToMotion, texts: list[str], frames: torch.Tensor, seed: int, sampling: Any, counter: NetworkCounter
) -> Latency:
    seeds, size = torch.arange(seed, seed + len(texts)), len(texts)
    counter.take(1, size)
    clock = _Clock(model.device)
    text = model.text_encoder(texts)
    clock.lap("text")
    latents = model.sample_latents(text, frames, seeds=seeds, sampling=sampling)
    clock.lap("generation")
    model.decode(latents)
    clock.lap("decoding")
    calls = {k.removesuffix("_calls"): v for k, v in counter.take(1, size).items() if k.endswith("_calls")}
    return Latency(size, clock.seconds, calls)


class _Clock:
    """Measure one part after the other, each with all that the device was asked to do in it."""

    def __init__(self, device: torch.device) -> None:
        self.device, self.seconds = device, dict[str, float]()
        synchronize(device)
        self.last = time.perf_counter()

    def lap(self, name: str) -> None:
        synchronize(self.device)
        now = time.perf_counter()
        self.seconds[name], self.last = now - self.last, now
