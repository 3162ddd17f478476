"""Return the motions that are scored: a model's, real ones, and the controls a model has to be read against."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.decoding.draws import SeededDraws
from kinema.evaluation.counting import NetworkCounter
from kinema.evaluation.metrics.code_usage import CodeUsage
from kinema.evaluation.source import Source, Together, answer
from kinema.evaluation.stopwatch import Stopwatch
from kinema.evaluation.together import Asked, by_length
from kinema.pipeline import TextToMotion
from kinema.pipeline.arguments import BATCH
from kinema.pipeline.editing import kept_frames, paste, task_slots
from kinema.pipeline.kept import encode_kept
from kinema.text.frozen import FrozenTextEncoder
from kinema.tokenizers import MotionTokenizer
from kinema.types import Caption, Latents, MotionBatch, TextFeatures, frame_mask

UNIT = 4
"""Frames that the lengths of crops are multiples of, as `ClipDataset` cuts them (MARDM §2)."""


class RealMotion(Source):
    """Answer with the captured motion itself: the row that every table has."""

    label = "real"

    def __call__(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        """Return the batch."""
        return batch


class ShuffledCaptions(Source):
    """Answer with real motion of another caption of the batch: perfect FID, no knowledge of the text.

    Unlike the others it mixes rows: the pairing is drawn from the first row's seed.
    """

    label = "shuffled captions"

    def __call__(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        """Deal the motions along one random cycle, so that none meets its own caption."""
        size = len(batch.lengths)
        if size < 2:
            raise ValueError("captions of a batch of 1 cannot be shuffled; raise the batch size or drop the leftover")
        order = np.random.default_rng(int(seeds[0])).permutation(size)
        other = np.empty(size, dtype=np.int64)
        other[order] = np.roll(order, 1)
        rows = torch.from_numpy(other).to(batch.lengths.device)
        return answer(batch, batch.features[rows], batch.lengths[rows])


class Reconstruction(Source):
    """Answer with what a tokenizer makes of the real motion: the ceiling of every method that uses it."""

    label, reconstructs = "reconstruction", True

    def __init__(self, tokenizer: MotionTokenizer) -> None:
        self.tokenizer, space = tokenizer.eval(), tokenizer.space
        self.dims = tokenizer.representation.kind
        self.usage = None
        if space.kind == "codes":
            self.usage = CodeUsage(space.classes, space.quantizers, sync_on_compute=False)

    def __call__(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        """Encode and decode the batch."""
        latents = self.tokenizer.encode(batch)
        if self.usage is not None:
            self.usage.to(batch.features.device).update(latents)
        decoded = self.tokenizer.decode(latents)
        return answer(batch, decoded.features, decoded.lengths)

    def measured(self) -> dict[str, float]:
        """Return how many codes were used, how many never, and how evenly."""
        if self.usage is None:
            return {}
        counted = self.usage.compute()
        self.usage.reset()
        names = {"codes_used": "used", "dead_codes": "dead", "code_perplexity": "perplexity"}
        return {key: float(counted[name]) for key, name in names.items()}


class NoiseLatents(Source):
    """Answer with decoded noise of the latents' mean and deviation: plausible marginals, nothing else.

    `mean` and `std` have the latent's width.
    """

    label, multimodal = "noise latents", True

    def __init__(self, tokenizer: MotionTokenizer, mean: Float[Tensor, " c"], std: Float[Tensor, " c"]) -> None:
        self.tokenizer, self.mean, self.std = tokenizer.eval(), mean, std

    def __call__(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        """Decode one noise sequence per row, of the real length."""
        space = self.tokenizer.space
        lengths, frames = space.latents_of(batch.lengths), space.covered(batch.lengths)
        values = torch.zeros(len(lengths), int(lengths.max()), len(self.mean))
        for row, length, seed in zip(values, lengths.tolist(), seeds.tolist(), strict=True):
            # Drawn at its own length: a draw's values depend on its size.
            noise = torch.randn(length, len(self.mean), generator=torch.Generator().manual_seed(seed))
            row[:length] = noise * self.std.cpu() + self.mean.cpu()
        decoded = self.tokenizer.decode(Latents(lengths, frames, values.to(batch.features.device)))
        return answer(batch, decoded.features, decoded.lengths)


class NoiseCodes(Source):
    """Answer with decoded codes drawn one by one as often as training clips use them: plausible marginals, no more.

    `shares` holds each layer's share of every code.
    """

    label, multimodal = "noise codes", True

    def __init__(self, tokenizer: MotionTokenizer, shares: Float[Tensor, "q k"]) -> None:
        self.tokenizer, self.shares = tokenizer.eval(), shares.cpu()

    def __call__(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        """Decode one sequence of independent codes per row, of the real length."""
        space = self.tokenizer.space
        lengths, frames = space.latents_of(batch.lengths), space.covered(batch.lengths)
        size = int(lengths.max())
        layers = []
        for layer, share in enumerate(self.shares):
            logits = share.log().expand(len(lengths), size, -1)
            layers.append(SeededDraws(seeds).pick(layer, logits))
        codes = torch.stack(layers, dim=-1).to(lengths.device) * frame_mask(lengths, size)[..., None]
        decoded = self.tokenizer.decode(Latents(lengths, frames, codes=codes))
        return answer(batch, decoded.features, decoded.lengths)


@runtime_checkable
class TrainingClips(Protocol):
    """Return training clips and their captions by entry (a `PackedStore` does)."""

    def entry_captions(self, entry: int) -> list[Caption]: ...

    def frames_of(self, entry: int) -> np.ndarray: ...


class NearestTrainingCaption(Source):
    """Answer with the training clip whose caption is nearest to the prompt: what memory alone achieves.

    Nearest is by the cosine of pooled text features; the clip is cut as `trained_answer` does.
    """

    text_encoder: FrozenTextEncoder

    label = "nearest training caption"

    def __init__(
        self,
        store: TrainingClips,
        entries: Sequence[int] | np.ndarray,
        text_encoder: FrozenTextEncoder,
        *,
        unit: int = UNIT,
    ) -> None:
        self.store, self.text_encoder, self.unit = store, text_encoder, unit
        known = [(caption.text, int(entry)) for entry in entries for caption in store.entry_captions(int(entry))]
        if not known:
            raise ValueError("none of the training entries has a caption; choose a split with captions")
        self.entries = [entry for _, entry in known]
        self.keys = self._embed([text for text, _ in known])

    def __call__(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        """Look the prompts up."""
        nearest = (self._embed(batch.texts) @ self.keys.T).argmax(1).tolist()
        return trained_answer(batch, self.store, [self.entries[k] for k in nearest], self.unit)

    def _embed(self, texts: list[str], size: int = 256) -> Float[Tensor, "n c"]:
        parts = [self.text_encoder(texts[i : i + size]).pooled.float().cpu() for i in range(0, len(texts), size)]
        return F.normalize(torch.cat(parts), dim=-1)


class Generated(Together):
    """Answer with a method's motions, by the path that its users take.

    `lengths`: "real" gives the method the test clip's length (MARDM, MMM, BAD, MoMask); "predicted" leaves it to a
    generator that ends its sequences itself (T2M-GPT, AttT2M, BAMM, MotionGPT), else to the length estimator.
    `batch_size`: motions to a batch, those whose test clips are of like length.
    """

    text_encoder: FrozenTextEncoder

    multimodal = True

    def __init__(
        self,
        model: TextToMotion,
        *,
        lengths: str = "real",
        sampling: Any = None,
        label: str = "generated",
        batch_size: int = BATCH,
    ) -> None:
        if lengths not in ("real", "predicted"):
            raise ValueError(f"lengths={lengths!r}; allowed: real, predicted")
        if lengths == "predicted" and not model.knows_lengths:
            raise ValueError("lengths=predicted needs a generator that ends its sequences itself or a length estimator")
        self.model, self.lengths, self.sampling, self.label = model.eval(), lengths, sampling, label
        self.batch_size = batch_size
        self.text_encoder = model.text_encoder
        self.counter = NetworkCounter(model.generator.networks)
        self.batches = self.motions = 0
        self.took = Stopwatch(model.device)

    def answer_all(self, questions: Sequence[Asked]) -> list[MotionBatch]:
        """Generate one motion per caption."""
        return by_length(questions, self._generate, self.batch_size)

    def _generate(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        text = encode_captions(self.text_encoder, batch)
        frames = batch.lengths if self.lengths == "real" else None
        with self.took.motions(len(seeds)):
            made = self.model.sample(text, frames, seeds=seeds, sampling=self.sampling)
        self.batches, self.motions = self.batches + 1, self.motions + len(seeds)
        return answer(batch, made.features, made.lengths)

    def measured(self) -> dict[str, float]:
        """Return how often a batch calls the networks that the generator names, and a motion's rows through them."""
        counted = self.counter.take(self.batches, self.motions)
        self.batches = self.motions = 0
        return counted

    def seconds(self) -> float | None:
        """Return a motion's share of the time from text features to features, decoding included."""
        return self.took.take()


class Edited(Together):
    """Answer with the real motion of which one of BAD's four tasks is regenerated to the caption (BAD §5).

    What is kept is encoded stretch by stretch. Without `paste`, as published, kept frames are the tokenizer's
    reconstruction; with it they are the real ones.
    """

    text_encoder: FrozenTextEncoder

    def __init__(
        self,
        model: TextToMotion,
        *,
        task: str,
        paste: bool = False,
        sampling: Any = None,
        label: str = "edited",
        batch_size: int = BATCH,
    ) -> None:
        task_slots(task, torch.ones(1, dtype=torch.int64))  # an unknown task is refused before anything is computed
        model.tokenizer.space.in_time("editing")
        self.model, self.task, self.paste, self.sampling, self.label = model.eval(), task, paste, sampling, label
        self.dims = model.tokenizer.representation.kind
        self.text_encoder, self.batch_size = model.text_encoder, batch_size

    def answer_all(self, questions: Sequence[Asked]) -> list[MotionBatch]:
        """Edit every motion to its own caption."""
        return by_length(questions, self._edit, self.batch_size)

    def _edit(self, batch: MotionBatch, seeds: Int[Tensor, " b"]) -> MotionBatch:
        tokenizer = self.model.tokenizer
        keep = task_slots(self.task, tokenizer.space.latents_of(batch.lengths))
        with self.model.computing():
            known = encode_kept(tokenizer, batch, keep)
        text = encode_captions(self.text_encoder, batch)
        made = self.model.sample(text, seeds=seeds, known=known, sampling=self.sampling)
        if self.paste:
            made = paste(made, batch.features, kept_frames(known.mask, tokenizer.space))
        return answer(batch, made.features, made.lengths)

    def kept(self, lengths: Int[Tensor, " b"]) -> Bool[Tensor, "b t"]:
        """Mark the frames that the task keeps."""
        space = self.model.tokenizer.space
        return kept_frames(task_slots(self.task, space.latents_of(lengths)), space)


def encode_captions(encoder: FrozenTextEncoder, batch: MotionBatch) -> TextFeatures:
    """Encode a batch's captions; the clips' names go along."""
    text = encoder(batch.texts).to(batch.features.device)
    text.clip_ids = list(batch.clip_ids)
    return text


def trained_answer(prompt: MotionBatch, store: TrainingClips, entries: Sequence[int], unit: int = UNIT) -> MotionBatch:
    """Put training clips in the place of a batch's motions, from their first frame.

    Each is as long as the prompt's motion, or as the clip (in multiples of `unit`, as crops are) if that is shorter.
    """
    clips = [np.asarray(store.frames_of(entry)) for entry in entries]
    counts = [min(n, len(clip) // unit * unit) for n, clip in zip(prompt.lengths.tolist(), clips, strict=True)]
    features = np.zeros((len(clips), max(counts), clips[0].shape[1]), dtype=np.float32)
    for row, clip, count in zip(features, clips, counts, strict=True):
        row[:count] = clip[:count]
    device = prompt.features.device
    return answer(prompt, torch.from_numpy(features).to(device), torch.tensor(counts, device=device))
