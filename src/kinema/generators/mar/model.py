"""Generate latents by masked autoregression: a transformer sees the known ones, a diffusion MLP samples the next."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.decoding.unmasking import Draws, SampleDraws, UnmaskingStep, unmask
from kinema.diffusion.ddpm import DDPM
from kinema.diffusion.flow import Flow
from kinema.diffusion.guidance import guided
from kinema.generators import Generator, TrainingLatents
from kinema.generators.draws import share_of
from kinema.generators.lengths import requested_lengths
from kinema.generators.mar.sampling import MarSampling, plan, start
from kinema.generators.mar.training import MASK_RATIOS, MarDraws, corrupt, training_mask
from kinema.generators.texts import beside, check_guidance, without_words
from kinema.generators.values import check_latents
from kinema.nn.diffusion_mlp import DiffusionMLP
from kinema.nn.embeddings import sinusoidal_positions
from kinema.nn.mode import inference
from kinema.nn.modulation import AdaLNBlock
from kinema.nn.ranks import mean_over_ranks
from kinema.nn.rows import Rows
from kinema.nn.words import Words
from kinema.options import Depth, OneOf, OpenShare, OptionalDepth, Share, Size, checked
from kinema.registry import buildable
from kinema.tokenizers import MotionTokenizer
from kinema.types import Known, Latents, LatentSpace, Losses, TextFeatures

MASK_LENGTHS = ("padded", "own")


@buildable
class MARDM(Generator):
    """Masked autoregressive transformer with a per-latent diffusion MLP (MARDM §4-§6).

    `process` is a `DDPM` or a `Flow`. The training mask counts positions of `max_latents` ("padded", as published) or
    of each sample's own length ("own"). Lengths are frames // `downsample`, at most `max_latents`.
    """

    latent_min: Float[Tensor, " c"]
    latent_max: Float[Tensor, " c"]

    @checked
    def __init__(
        self,
        *,
        latent_dim: Size,
        text_dim: Size,
        process: DDPM | Flow,
        width: Size = 1024,
        feedforward: Size = 4096,
        layers: Depth = 1,
        heads: Size = 16,
        dropout: OpenShare = 0.2,
        condition_drop: Share = 0.1,
        mlp_width: Size = 1792,
        mlp_depth: Depth = 16,
        batch_multiplier: Size = 4,
        max_latents: Size = 49,
        downsample: Size = 4,
        mask_length: Annotated[str, OneOf(MASK_LENGTHS)] = "padded",
        mask_ratio: Annotated[str, OneOf(MASK_RATIOS)] = "cosine",
        noise_share: Share = 0.1,
        mask_share: Share = 0.88,
        token_dim: Size | None = None,
        null_tokens: OptionalDepth = 0,
        sampling: MarSampling | None = None,
    ) -> None:
        super().__init__()
        self.text_dim, self.token_dim = text_dim, token_dim
        self.condition_drop = condition_drop
        self.batch_multiplier = batch_multiplier
        self.space = LatentSpace("continuous", latent_dim, max_latents, downsample)
        self.mask_length, self.mask_ratio = mask_length, mask_ratio
        self.corruption = {"noise_share": noise_share, "mask_share": mask_share}
        self.sampling = sampling or MarSampling()
        self.process = process
        self.check_sampling(self.sampling)
        self.mask_latent = nn.Parameter(torch.zeros(latent_dim))
        self.input_projection = nn.Linear(latent_dim, width)
        self.text_projection = nn.Linear(text_dim, width)
        self.words = None if token_dim is None else Words(token_dim, width, null_tokens)
        self.dropout = nn.Dropout(dropout)
        self.blocks = nn.ModuleList(
            AdaLNBlock(width, heads, feedforward, dropout, cross=token_dim is not None) for _ in range(layers)
        )
        self.reset_parameters()
        self.mlp = DiffusionMLP(latent_dim, width, mlp_width, mlp_depth)
        self.register_buffer("latent_min", torch.full((latent_dim,), -torch.inf))
        self.register_buffer("latent_max", torch.full((latent_dim,), torch.inf))

    @property
    def networks(self) -> dict[str, nn.Module]:
        """The diffusion MLP, by its last layer, whose row is a latent, and the transformer, whose row is a motion."""
        return {"denoiser": self.mlp.final, "transformer": self}

    def reset_parameters(self) -> None:
        """Initialise the transformer: Linears N(0, 0.02), biases and modulations 0. The MLP has its own rule."""
        words = () if self.words is None else self.words.modules()
        for module in (self.input_projection, self.text_projection, *words, *self.blocks.modules()):
            if isinstance(module, nn.Linear):
                nn.init.normal_(module.weight, std=0.02)
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        for name, parameter in self.blocks.named_parameters():
            if ".modulation." in name:
                nn.init.zeros_(parameter)
        if self.words is not None:
            self.words.reset_parameters()
            for block in self.blocks:
                if isinstance(block, AdaLNBlock):
                    block.close()

    def prepare(self, tokenizer: MotionTokenizer, latents: TrainingLatents) -> None:
        """Keep the range of the latents of training and validation."""
        self.set_latent_range(*latents.range())

    def check_sampling(self, sampling: MarSampling) -> None:
        """Refuse a solver of another process, and guidance that training gave no ground."""
        super().check_sampling(sampling)
        self.process.resolve(sampling.solver, sampling.solver_steps, sampling.solver_grid)
        check_guidance(self.condition_drop, guidance=sampling.guidance)

    def set_latent_range(self, minimum: Float[Tensor, " c"], maximum: Float[Tensor, " c"]) -> None:
        """Keep the range of latents per channel, for `clip_latents`; call it before training."""
        if not (minimum <= maximum).all():
            raise ValueError("the latents' minimum exceeds their maximum; pass (minimum, maximum) per channel")
        self.latent_min.copy_(minimum)
        self.latent_max.copy_(maximum)

    def forward(
        self,
        latents: Float[Tensor, "b n c"],
        text: TextFeatures,
        real: Bool[Tensor, "b n"],
        last: Bool[Tensor, "b n"] | None = None,
    ) -> Float[Tensor, "b n w"]:
        """Return each position's condition for the diffusion MLP, zero at padding, which `real` tells.

        Positions in `last` go behind the others inside the blocks (pseudo-reordering). A text without words and with a
        zero vector is the empty condition.
        """
        condition = self.text_projection(text.pooled)
        context, words = (None, None) if self.words is None else self._read(text)
        x = self.input_projection(latents)
        x = self.dropout(x + sinusoidal_positions(x.shape[1], x.shape[2], x.device).to(x.dtype))
        if last is not None:
            order = last.int().argsort(dim=1, stable=True)
            x, real = _take(x, order), real.gather(1, order)
        rows = Rows(real)
        x = rows.pack(x)
        for block in self.blocks:
            x = block(x, rows, condition, context, words)
        return rows.pad(x) if last is None else _take(rows.pad(x), order.argsort(dim=1))

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        draws: MarDraws | None = None,
    ) -> Losses:
        """Return the diffusion loss of the masked latents (MARDM §4).

        Draws are made for the global batch, from `generator` (None: torch's own), of which this batch is the part
        `shard` = (rank, world); the mean is over the masked rows of all ranks, so that ranks together equal one
        process. Dropout is torch's own. `draws` replaces them all (tests).
        """
        values, real = check_latents(latents, self.space), latents.mask
        x1 = values.detach() * real[:, :, None]
        draws = draws or self._draw(x1, generator, shard)
        mask, shown = self._corrupted(x1, real, latents.lengths, draws)
        z = self(shown, without_words(text, draws.condition_drop), real)
        rows = self._diffusion_loss(x1[mask], z[mask], draws.diffusion_time[mask], draws.diffusion_noise[mask])
        return {"loss": mean_over_ranks(rows, shard[1])}

    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: MarSampling | None = None,
        draws: Draws | None = None,
    ) -> Latents:
        """Generate latents for `frames` frames, or edit: regenerate the positions that `known.mask` leaves free.

        A sample depends on its own seed only. `frames` None takes the lengths of `known`. The result stands for whole
        latents, frames // downsample * downsample frames; kept latents come back bit-equal, padding is zero. `draws`
        replaces what the seeds draw (tests).
        """
        states = self.trajectory(text, frames, seeds=seeds, known=known, sampling=sampling, draws=draws)
        *_, (_, latents) = states
        return latents

    def trajectory(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: MarSampling | None = None,
        draws: Draws | None = None,
    ) -> Iterator[tuple[UnmaskingStep | None, Latents]]:
        """Yield the latents at the start and after every unmasking step of `sample`."""
        sampling = sampling or self.sampling
        device = self.mask_latent.device
        lengths = requested_lengths(self.space, text, frames, seeds, known, device=device)
        latents, free = start(self.space, lengths, known, sampling)
        draws = draws or SampleDraws(seeds, lengths, len(self.mask_latent), device)
        predict = self._predictor(text.to(device), latents.mask, draws, sampling)
        yield None, latents
        steps = plan(draws.order(), free, sampling)
        for step, values in unmask(latents.content, self.mask_latent.detach(), steps, predict):
            yield step, replace(latents, values=values)

    def _predictor(
        self, text: TextFeatures, real: Tensor, draws: Draws, sampling: MarSampling
    ) -> Callable[[UnmaskingStep, Tensor, tuple[Tensor, Tensor]], Float[Tensor, "m c"]]:
        """Close over what all steps share: text and empty passes in one batch, or the text alone at guidance 1."""
        clip = self._latent_range() if sampling.clip_latents else None
        passes = 1 if sampling.guidance == 1 else 2
        if passes == 2:
            text, real = beside(text, without_words(text)), torch.cat((real, real))

        def denoise(x: Tensor, time: Tensor, condition: Tensor) -> Tensor:
            return self.mlp.denoise(x, self.mlp.embed_time(time), condition)

        def predict(step: UnmaskingStep, latents: Tensor, where: tuple[Tensor, Tensor]) -> Float[Tensor, "m c"]:
            last = step.masked.to(real.device).repeat(passes, 1) if sampling.pseudo_reorder else None
            with inference(self):
                z = self(latents.repeat(passes, 1, 1), text, real, last).unflatten(0, (passes, -1))
                condition = self.mlp.embed_condition(z[:, *where])
                return self.process.sample(
                    guided(denoise, condition[0], condition[-1], sampling.guidance),
                    draws.noise(step.index, step.sampled),
                    solver=sampling.solver,
                    steps=sampling.solver_steps,
                    grid=sampling.solver_grid,
                    temperature=sampling.temperature,
                    clip=clip,
                )

        return predict

    def _read(self, text: TextFeatures) -> tuple[Float[Tensor, "l w"], Rows]:
        """Project the words, those of all texts behind each other."""
        assert self.words is not None  # who reads has them
        projected, seen = self.words(text)
        words = Rows(seen)
        return words.pack(projected), words

    def _corrupted(
        self, x1: Float[Tensor, "b n c"], real: Bool[Tensor, "b n"], lengths: Int[Tensor, " b"], draws: MarDraws
    ) -> tuple[Bool[Tensor, "b n"], Float[Tensor, "b n c"]]:
        """Return which latents are predicted, and what the transformer sees."""
        if self.mask_ratio == "all":
            return real, torch.where(real[..., None], self.mask_latent, x1)
        counted = lengths if self.mask_length == "own" else lengths.new_tensor([self.space.most])
        mask = training_mask(draws, real, counted)
        return mask, corrupt(x1, mask, self.mask_latent, draws)

    def _draw(
        self, latents: Float[Tensor, "b n c"], generator: torch.Generator | None, shard: tuple[int, int]
    ) -> MarDraws:
        batch, positions, channels = latents.shape
        return share_of(
            lambda samples: MarDraws.draw(
                (samples, self.space.most, channels),
                self.process,
                repeats=self.batch_multiplier,
                **self.corruption,
                condition_drop=self.condition_drop if self.training else 0.0,
                generator=generator,
                device=latents.device,
            ),
            batch,
            shard,
            positions,
        )

    def _latent_range(self) -> tuple[Tensor, Tensor]:
        if not (self.latent_min.isfinite().all() and self.latent_max.isfinite().all()):
            raise ValueError(
                "clip_latents needs the range of the training latents, which this model does not hold; "
                "call set_latent_range(minimum, maximum) before training, or sample with clip_latents=False"
            )
        return self.latent_min, self.latent_max

    def _diffusion_loss(
        self, x1: Float[Tensor, "m c"], z: Float[Tensor, "m w"], time: Tensor, noise: Float[Tensor, "m k c"]
    ) -> Float[Tensor, " mk"]:
        """Return the loss of every masked row, once per time and noise."""
        repeats = noise.shape[1]
        condition = self.mlp.embed_condition(z).repeat_interleave(repeats, dim=0)
        return self.process.loss(
            lambda x, t: self.mlp.denoise(x, self.mlp.embed_time(t), condition),
            x1.repeat_interleave(repeats, dim=0),
            time.flatten(),
            noise.flatten(0, 1),
        )


def _take(x: Float[Tensor, "b n w"], order: Int[Tensor, "b n"]) -> Float[Tensor, "b n w"]:
    return x.gather(1, order[:, :, None].expand_as(x))
