"""Diffuse whole sequences of frames under a text: the loss, the sampler and edits that all such methods share."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.diffusion.guidance import Predict, guided
from kinema.generators import Generator
from kinema.generators.draws import share_of
from kinema.generators.frames.denoiser import Denoiser
from kinema.generators.frames.sampling import FrameSampling, Kept, seeded_noise
from kinema.generators.frames.training import AVERAGES, FrameDraws, averaged, without_text
from kinema.generators.lengths import requested_lengths
from kinema.generators.values import check_latents
from kinema.nn.mode import inference
from kinema.nn.ranks import mean_over_ranks
from kinema.types import Known, Latents, LatentSpace, Losses, TextFeatures, frame_mask


class FrameDiffusion(Generator):
    """Diffuse frames of motion, `frame_dim` features each.

    `mask_frames` hides padding from the frames; without it a motion is the start of one of `max_frames`, in training
    and in sampling. `average` is of the loss: over each sample's frames and then samples, or over all frames alike.
    `condition_drop` is the share of texts that training drops; 0 leaves no empty text to be guided from.
    """

    def __init__(
        self,
        denoiser: Denoiser,
        process: DDPM | Flow,
        *,
        frame_dim: int,
        max_frames: int,
        condition_drop: float,
        mask_frames: bool,
        average: str,
        sampling: FrameSampling,
    ) -> None:
        super().__init__()
        if average not in AVERAGES:
            raise ValueError(f"average {average!r} is unknown; choose one of {', '.join(AVERAGES)}")
        self.space = LatentSpace("frames", frame_dim, max_frames, unit=1)
        self.denoiser, self.process, self.sampling = denoiser, process, sampling
        self.condition_drop, self.mask_frames, self.average = condition_drop, mask_frames, average
        self.check_sampling(sampling)

    def check_sampling(self, sampling: FrameSampling) -> None:
        """Refuse a solver of another process, and guidance that training gave no ground."""
        super().check_sampling(sampling)
        self.process.resolve(sampling.solver, sampling.solver_steps)
        if sampling.guidance != 1 and not self.condition_drop:
            raise ValueError(
                f"sampling.guidance is {sampling.guidance}, but condition_drop=0 gave this model no empty text to be "
                "guided from; sample with guidance=1"
            )

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
        check_latents(latents, self.space)
        x1 = latents.values.detach() * latents.mask[..., None]
        if not self.mask_frames:
            x1 = F.pad(x1, (0, 0, 0, self.space.most - x1.shape[1]))
        draws = draws or self._draw(x1, generator, shard)
        rows = averaged(
            self.errors(x1, latents.lengths, text, draws), frame_mask(latents.lengths, x1.shape[1]), self.average
        )
        return {"loss": mean_over_ranks(rows, shard[1])}

    def errors(
        self, x1: Float[Tensor, "b n c"], lengths: Int[Tensor, " b"], text: TextFeatures, draws: FrameDraws
    ) -> Float[Tensor, "b n"]:
        """Return every frame's squared error, averaged over its features; to the process a frame is a row."""
        shape = x1.shape[:2]
        condition, seen = self.denoiser.read(without_text(text, draws.condition_drop))
        real = frame_mask(lengths, shape[1]) if self.mask_frames else None

        def predict(x: Tensor, time: Tensor) -> Tensor:
            return self.denoiser(x.unflatten(0, shape), draws.time, condition, seen, real).flatten(0, 1)

        times = draws.time.repeat_interleave(shape[1])
        return self.process.loss(predict, x1.flatten(0, 1), times, draws.noise.flatten(0, 1)).unflatten(0, shape)

    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: FrameSampling | None = None,
        noise: Iterator[Float[Tensor, "b n c"]] | None = None,
    ) -> Latents:
        """Generate frames, or edit: regenerate the frames, or the features of them, that `known.mask` leaves free.

        A sample depends on its own seed only. `frames` None takes the lengths of `known`. Kept features come back
        bit-equal, padding is zero. `noise` replaces what the seeds draw: the start, then a draw per step (tests).
        """
        sampling = sampling or self.sampling
        device = next(self.parameters()).device
        lengths = requested_lengths(self.space, text, frames, seeds, known, device=device)
        longest = int(lengths.max())
        real = frame_mask(lengths, longest if self.mask_frames else self.space.most)
        shown = real if self.mask_frames else None
        drawn = real if self.mask_frames else torch.ones_like(real)
        kept = None if known is None else Kept.of(known, lengths, real, self.space.width)
        with inference(self):
            predict = self._predictor(text.to(device), shown, sampling.guidance)
            values = self.process.sample(
                predict if kept is None else kept.imputed(predict, self.process),
                noise or seeded_noise(seeds, drawn, self.space.width),
                solver=sampling.solver,
                steps=sampling.solver_steps,
                temperature=sampling.temperature,
            )
        values = values if kept is None else kept.impose(values)
        values = values.masked_fill(~real[..., None], 0.0)
        return Latents(lengths=lengths, frames=lengths, values=values[:, :longest])

    def _predictor(self, text: TextFeatures, shown: Bool[Tensor, "b n"] | None, guidance: float) -> Predict:
        """Close over what all steps share: text and empty passes in one batch, or the text alone at guidance 1."""
        condition, seen = self.denoiser.read(text)
        empty = None if guidance == 1 else self.denoiser.read(without_text(text))[0]

        def denoise(x: Tensor, time: Tensor, condition: Tensor) -> Tensor:
            copies = len(condition) // len(text.pooled)
            masks = (None if mask is None else mask.repeat(copies, 1) for mask in (seen, shown))
            return self.denoiser(x, time, condition, *masks)

        return guided(denoise, condition, empty, guidance)

    def _draw(
        self, x1: Float[Tensor, "b n c"], generator: torch.Generator | None, shard: tuple[int, int]
    ) -> FrameDraws:
        batch, frames, features = x1.shape
        drop = self.condition_drop if self.training else 0.0
        options = {"condition_drop": drop, "generator": generator, "device": x1.device}
        return share_of(
            lambda samples: FrameDraws.draw((samples, self.space.most, features), self.process, **options),
            batch,
            shard,
            frames,
        )
