"""Generate codes by bidirectional autoregressive diffusion (BAD): masked modelling in the order of a permutation."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.decoding.draws import SeededDraws, TokenDraws
from kinema.decoding.token_unmasking import choice, unmask_tokens
from kinema.generators.bad.sampling import BadPlan, BadSampling, plan
from kinema.generators.bad.training import BadDraws
from kinema.generators.draws import share_of
from kinema.generators.tokens.reader import CodebookReader
from kinema.generators.tokens.transformer import TokenTransformer, code_losses, with_end
from kinema.generators.tokens.words import WORDS
from kinema.masking import DIRECTIONS, hybrid_mask, lowest, masked_count, official_inference_mask, ranks
from kinema.nn.embeddings import timestep_embedding
from kinema.nn.mode import inference
from kinema.nn.transformer import initialize
from kinema.options import Classes, OneOf, OpenShare, OptionalDepth, Share, Size, checked
from kinema.registry import buildable
from kinema.types import Known, Latents, Losses, TextFeatures

FREQUENCIES = 256


@buildable
class BAD(CodebookReader):
    """Transformer over codes under a hybrid mask: bidirectional for seen tokens, causal among masked ones (BAD §2-§3).

    A random permutation gives every position its order; a masked position holds the mask token of its order and sees
    those masked tokens only whose order is its own or higher ("ge"; direction="le": or lower). `unmasked_see_masks`
    lets the other rows see all masks. `time_token` adds a condition that embeds the number of masks and the length.
    `max_replaced` and `low_mask_share` are training's: `BadDraws`. Lengths are frames // `downsample`, at most
    `max_latents`.
    """

    @checked
    def __init__(
        self,
        *,
        codebook_size: Classes,
        code_dim: Size,
        text_dim: Size,
        token_dim: Size,
        width: Size = 1024,
        heads: Size = 16,
        feedforward: Size = 4096,
        cross_layers: OptionalDepth = 2,
        base_layers: OptionalDepth = 7,
        head_layers: OptionalDepth = 9,
        dropout: OpenShare = 0.1,
        words: Annotated[str, OneOf(WORDS)] = "real",
        time_token: bool = True,
        direction: Annotated[str, OneOf(DIRECTIONS)] = "ge",
        unmasked_see_masks: bool = False,
        max_replaced: Share = 0.4,
        low_mask_share: Share = 0.1,
        max_latents: Size = 49,
        downsample: Size = 4,
        sampling: BadSampling | None = None,
    ) -> None:
        super().__init__(codebook_size=codebook_size, code_dim=code_dim, max_latents=max_latents, downsample=downsample)
        self.text_dim, self.token_dim = text_dim, token_dim if cross_layers else None
        self.sampling = sampling or BadSampling()
        self.first_mask = codebook_size + 2
        self.conditions = 1 + time_token
        self.direction = direction
        self.rules: dict[str, Any] = {
            "conditions": self.conditions,
            "direction": direction,
            "unmasked_see_masks": unmasked_see_masks,
        }
        self.training_shares = {"max_replaced": max_replaced, "low_mask_share": low_mask_share}
        self.transformer = TokenTransformer(
            codebook_size=codebook_size,
            code_dim=code_dim,
            specials=max_latents + 3,  # END, PAD, and (as published) one mask token more than there are orders
            text_dim=text_dim,
            token_dim=token_dim,
            width=width,
            heads=heads,
            feedforward=feedforward,
            cross_layers=cross_layers,
            base_layers=base_layers,
            head_layers=head_layers,
            dropout=dropout,
            words=words,
        )
        self.count_embedding = _number_embedding(width) if time_token else None
        self.length_embedding = _number_embedding(width) if time_token else None

    def forward(
        self,
        codes: Int[Tensor, "b n"],
        masked: Bool[Tensor, "b n"],
        orders: Int[Tensor, "b n"],
        lengths: Int[Tensor, " b"],
        text: TextFeatures,
        visible: Bool[Tensor, "b m m"] | None = None,
    ) -> Float[Tensor, "b m k"]:
        """Return logits at the conditions, the n positions and the END slot (m = conditions + n + 1).

        What `codes` holds at `masked` positions has no influence. `visible` (row sees column) replaces the hybrid mask
        of what is masked.
        """
        ids, real = with_end(torch.where(masked, self.first_mask + orders, codes), lengths, self.codebook_size)
        if visible is None:
            visible = hybrid_mask(F.pad(orders, (0, 1)), F.pad(masked, (0, 1)), lengths, **self.rules)
        return self.transformer(ids, text, real, self.time_token(masked, lengths), mask=visible)

    def time_token(self, masked: Bool[Tensor, "b n"], lengths: Int[Tensor, " b"]) -> Float[Tensor, "b 1 w"] | None:
        """Embed the number of masks and the length; None for a model without this condition."""
        if self.count_embedding is None or self.length_embedding is None:
            return None
        dtype = self.codebook.dtype
        count, length = (timestep_embedding(number, FREQUENCIES).to(dtype) for number in (masked.sum(dim=1), lengths))
        return (self.count_embedding(count) + self.length_embedding(length))[:, None]

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        draws: BadDraws | None = None,
    ) -> Losses:
        """Return the cross entropy of all codes, masked or not, mean per sample, then over the batch (BAD §3).

        Draws are made for the global batch, from `generator` (None: torch's own), of which this batch is the part
        `shard` = (rank, world); in eval mode no code is replaced. Dropout is torch's own. `draws` replaces them all
        (tests).
        """
        codes = self.codes(latents)
        real = latents.mask
        draws = draws or self._draw(codes, generator, shard)
        masked = lowest(draws.candidates, real, masked_count(latents.lengths, draws.ratio))
        orders = ranks(draws.order.masked_fill(~real, torch.inf))
        seen = torch.where(draws.keep, codes, draws.replacement)
        return code_losses(self(seen, masked, orders, latents.lengths, text), codes, real, self.conditions)

    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: BadSampling | None = None,
        draws: TokenDraws | None = None,
    ) -> Latents:
        """Generate codes for `frames` frames, or edit: regenerate the positions that `known.mask` leaves free.

        A sample depends on its own seed only. `frames` None takes the lengths of `known`. Kept codes come back equal,
        padding is 0. `draws` replaces what the seeds draw (tests).
        """
        steps = self.trajectory(text, frames, seeds=seeds, known=known, sampling=sampling, draws=draws)
        *_, (_, _, base) = steps
        return self.completed(base, text, seeds=seeds, known=known, sampling=sampling)

    def trajectory(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: BadSampling | None = None,
        draws: TokenDraws | None = None,
    ) -> Iterator[tuple[Bool[Tensor, "b n"], Bool[Tensor, "b m m"], Latents]]:
        """Yield what was masked, who saw whom and the codes after it, of every step of `sample`."""
        sampling, draws = sampling or self.sampling, draws or SeededDraws(seeds)
        device, request = self.codebook.device, self.request(text, frames, seeds, known)
        text, editing = text.to(device), known is not None
        planned = plan(request, sampling, draws, seeds, editing=editing, direction=self.direction)

        def predict(codes: Tensor, masked: Tensor, step: int) -> Float[Tensor, "b n k"]:
            with inference(self):
                logits = self(codes, masked, planned.orders, request.lengths, text, self.visible(planned, masked))
            return logits[:, self.conditions : -1]

        choose = choice(draws, sampling.effective_temperature)
        start = request.codes[..., 0]
        for masked, codes in unmask_tokens(start, planned.free, planned.counts, predict, choose, planned.priority):
            yield masked, self.visible(planned, masked), self.latents(codes, request.lengths)

    def visible(self, planned: BadPlan, masked: Bool[Tensor, "b n"]) -> Bool[Tensor, "b m m"]:
        """Return the attention mask of a step: that of training for what is masked now, or the published sampler's."""
        orders, free, masked = (F.pad(x, (0, 1)) for x in (planned.orders, planned.free, masked))
        if planned.official:
            return official_inference_mask(orders, free, masked, planned.lengths, **self.rules)
        return hybrid_mask(orders, masked, planned.lengths, **self.rules)

    def _draw(self, codes: Int[Tensor, "b n"], generator: torch.Generator | None, shard: tuple[int, int]) -> BadDraws:
        draws = share_of(
            lambda samples: BadDraws.draw(
                (samples, self.max_latents),
                self.codebook_size,
                **self.training_shares,
                generator=generator,
                device=codes.device,
            ),
            len(codes),
            shard,
            codes.shape[1],
        )
        draws.keep |= not self.training
        return draws


def _number_embedding(width: int) -> nn.Sequential:
    layers = nn.Sequential(nn.Linear(FREQUENCIES, width), nn.SiLU(), nn.Linear(width, width))
    initialize(layers)
    return layers
