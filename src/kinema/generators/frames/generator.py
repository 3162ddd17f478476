"""Diffuse whole sequences, of frames or latents, under a text: the loss, the sampler and edits that methods share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, cast

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.diffusion.guidance import Predict, guided
from kinema.diffusion.noise import sequence_noise
from kinema.generators import Generator
from kinema.generators.draws import share_of
from kinema.generators.frames.denoiser import Denoiser
from kinema.generators.frames.sampling import DiffusionSampling, FrameSampling, Kept
from kinema.generators.frames.training import FrameDraws
from kinema.generators.lengths import requested_lengths
from kinema.generators.texts import check_guidance, repeated, without_text
from kinema.generators.values import check_latents
from kinema.nn.mode import inference
from kinema.nn.ranks import mean_over_ranks
from kinema.types import Known, Latents, LatentSpace, Losses, TextFeatures, frame_mask

Average = Callable[[Float[Tensor, "b n c"], Bool[Tensor, "b n"]], Float[Tensor, " m"]]
"""Turn the errors of features, and the mask of real frames, into rows whose mean is the loss."""


class SequenceDiffusion(Generator):
    """Diffuse the whole of a motion at once: all its frames, or the latents that stand for it.

    `mask_frames` hides padding from the frames; without it a motion is the start of one of `space.most`, in training
    and in sampling. `average` makes the rows of the loss: `per_sequence` or `per_frame`. `condition_drop` is the share
    of texts that training drops; 0 leaves no empty text to be guided from. A training step denoises each motion from
    `batch_multiplier` draws of time, noise and dropped text. `draws_type` is what a step draws.
    """

    draws_type: type[FrameDraws] = FrameDraws

    def __init__(
        self,
        denoiser: Denoiser,
        process: DDPM | Flow,
        *,
        space: LatentSpace,
        condition_drop: float,
        mask_frames: bool,
        average: Average,
        sampling: DiffusionSampling,
        batch_multiplier: int = 1,
    ) -> None:
        super().__init__()
        self.batch_multiplier = batch_multiplier
        self.space, self.width = space, cast(int, space.width)  # None is for codes
        self.denoiser, self.process, self.sampling = denoiser, process, sampling
        self.condition_drop, self.mask_frames, self.average = condition_drop, mask_frames, average
        self.check_sampling(sampling)

    @property
    def networks(self) -> dict[str, nn.Module]:
        """The denoiser; a row is a motion."""
        return {"denoiser": self.denoiser}

    def check_sampling(self, sampling: DiffusionSampling) -> None:
        """Refuse a solver of another process, and guidance that training gave no ground."""
        super().check_sampling(sampling)
        self.process.resolve(sampling.solver, sampling.solver_steps, sampling.solver_grid)
        check_guidance(self.condition_drop, guidance=sampling.guidance)

    def without_text(self, text: TextFeatures, drop: Bool[Tensor, " b"] | None = None) -> TextFeatures:
        """Take the text away from the samples in `drop` (None: from all); by default its features become zero."""
        return without_text(text, drop)

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        draws: FrameDraws | None = None,
    ) -> Losses:
        """Return the squared error of the prediction, averaged over features and over frames that are no padding.

        Draws are made for the global batch, from `generator` (None: torch's own), of which this batch is the part
        `shard` = (rank, world). Dropout is torch's own. `draws` replaces what is drawn (tests).
        """
        x1 = check_latents(latents, self.space).detach() * latents.mask[..., None]
        lengths, x1, text = self._repeated(latents.lengths, x1, text)
        if not self.mask_frames:
            x1 = F.pad(x1, (0, 0, 0, self.space.most - x1.shape[1]))
        draws = draws or self._draw(x1, generator, shard)
        real = frame_mask(lengths, x1.shape[1])
        rows = self.average(self.errors(x1, text, draws, real), real)
        return {"loss": mean_over_ranks(rows, shard[1])}

    def _repeated(self, lengths: Tensor, x1: Tensor, text: TextFeatures) -> tuple[Tensor, Tensor, TextFeatures]:
        if not self.training or self.batch_multiplier == 1:
            return lengths, x1, text
        lengths, x1 = (value.repeat_interleave(self.batch_multiplier, dim=0) for value in (lengths, x1))
        return lengths, x1, repeated(text, self.batch_multiplier)

    def errors(
        self, x1: Float[Tensor, "b n c"], text: TextFeatures, draws: FrameDraws, real: Bool[Tensor, "b n"]
    ) -> Float[Tensor, "b n c"]:
        """Return the squared error of every feature of every frame."""
        condition, seen = self.denoiser.read(self.without_text(text, draws.condition_drop))
        shown = real if self.mask_frames else None
        return self.process.errors(
            lambda x, time: self.denoiser(x, time, condition, seen, shown), x1, draws.time, draws.noise
        )

    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: Any | None = None,
        noise: Iterator[Float[Tensor, "b n c"]] | None = None,
    ) -> Latents:
        """Generate, or edit: regenerate the frames, or the features of them, that `known.mask` leaves free.

        A sample depends on its own seed only. `frames` None takes the lengths of `known`. Kept features come back
        bit-equal, padding is zero. `noise` replaces what the seeds draw: the start, then a draw per step (tests).
        """
        if known is not None:
            self.space.in_time("keeping a part of a motion")
        sampling = sampling or self.sampling
        device = next(self.parameters()).device
        lengths = requested_lengths(self.space, text, frames, seeds, known, device=device)
        longest = int(lengths.max())
        real = frame_mask(lengths, longest if self.mask_frames else self.space.most)
        shown = real if self.mask_frames else None
        drawn = real.sum(dim=1) if self.mask_frames else torch.full_like(lengths, self.space.most)
        kept = None if known is None else Kept.of(known, lengths, real, self.width)
        with inference(self):
            values = self.solved(
                text.to(device),
                noise or sequence_noise(seeds, drawn, self.width, device),
                shown=shown,
                seeds=seeds,
                known=None if kept is None else (kept.values, kept.mask),
                sampling=sampling,
            )
        values = values if kept is None else kept.impose(values)
        values = values.masked_fill(~real[..., None], 0.0)
        counted = self.space.frames_of(lengths) if frames is None else frames.to(device)
        return Latents(lengths=lengths, frames=counted, values=values[:, :longest])

    def solved(
        self,
        text: TextFeatures,
        noise: Iterator[Float[Tensor, "b n c"]],
        *,
        shown: Bool[Tensor, "b n"] | None,
        seeds: Int[Tensor, " b"],
        known: tuple[Float[Tensor, "b n c"], Bool[Tensor, "b n c"]] | None,
        sampling: DiffusionSampling,
    ) -> Float[Tensor, "b n c"]:
        """Take noise to motion by the diffusion process; what is `known` (values, mask) is held on the way."""
        return self.process.sample(
            self._predictor(text, shown, sampling, seeds),
            noise,
            solver=sampling.solver,
            steps=sampling.solver_steps,
            grid=sampling.solver_grid,
            temperature=sampling.temperature,
            known=known,
            holding=sampling.holding,
            renewal=sampling.renewal,
        )

    def _predictor(
        self,
        text: TextFeatures,
        shown: Bool[Tensor, "b n"] | None,
        sampling: DiffusionSampling,
        seeds: Int[Tensor, " b"],
    ) -> Predict:
        """Close over what all steps share: text and empty passes in one batch, or the text alone at guidance 1."""
        condition, seen = self.denoiser.read(text)
        empty, unseen = (None, None) if sampling.guidance == 1 else self.denoiser.read(self.without_text(text))
        scale = 1.0 if empty is None else sampling.weights().along(self.process.progress)

        def denoise(x: Tensor, time: Tensor, condition: Tensor) -> Tensor:
            copies = len(condition) // len(text.pooled)
            words = torch.cat((seen, unseen)) if copies == 2 and seen is not None and unseen is not None else seen
            return self.denoiser(x, time, condition, words, None if shown is None else shown.repeat(copies, 1))

        return guided(denoise, condition, empty, scale)

    def _draw(
        self, x1: Float[Tensor, "b n c"], generator: torch.Generator | None, shard: tuple[int, int]
    ) -> FrameDraws:
        batch, frames, features = x1.shape
        drop = self.condition_drop if self.training else 0.0
        return share_of(
            lambda samples: self.draws_type.draw(
                (samples, self.space.most, features),
                self.process,
                condition_drop=drop,
                generator=generator,
                device=x1.device,
            ),
            batch,
            shard,
            frames,
        )


class FrameDiffusion(SequenceDiffusion):
    """Diffuse frames of motion, `frame_dim` features each and at most `max_frames`."""

    def __init__(
        self,
        denoiser: Denoiser,
        process: DDPM | Flow,
        *,
        frame_dim: int,
        max_frames: int,
        condition_drop: float,
        mask_frames: bool,
        average: Average,
        sampling: FrameSampling,
    ) -> None:
        super().__init__(
            denoiser,
            process,
            space=LatentSpace("frames", frame_dim, max_frames, unit=1),
            condition_drop=condition_drop,
            mask_frames=mask_frames,
            average=average,
            sampling=sampling,
        )
