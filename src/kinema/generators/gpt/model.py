"""Generate tokens from left to right with a causal transformer: T2M-GPT, and AttT2M with attention to words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.decoding.autoregressive import decode_left_to_right
from kinema.decoding.draws import TokenDraws
from kinema.generators.draws import share_of
from kinema.generators.gpt.sampling import GptSampling
from kinema.generators.gpt.training import GptDraws, corrupt
from kinema.generators.tokens.generator import TokenGenerator
from kinema.generators.tokens.targets import per_sample, targets
from kinema.generators.tokens.words import WORDS, visible_words
from kinema.nn.attention import KeyValueCache
from kinema.nn.embeddings import sinusoidal_positions
from kinema.nn.mode import inference
from kinema.nn.ranks import mean_over_ranks
from kinema.nn.rows import Rows
from kinema.nn.transformer import TransformerBlock, initialize, run
from kinema.options import Classes, Depth, KeptShare, OneOf, OpenShare, OptionalDepth, Size, checked
from kinema.registry import buildable
from kinema.types import Known, Latents, Losses, TextFeatures

FALLBACK = 1
"""The one code of a motion whose first token is END, as published (T2M-GPT, Sampling)."""

Words = tuple[Float[Tensor, "b l w"], Bool[Tensor, "b l"]]
"""Projected word features and the mask of those that may be seen."""


@buildable
class T2MGPT(TokenGenerator):
    """Predict the next of [text, token 1, ..., token L, END] with pre-norm causal blocks (T2M-GPT; COMMON §5).

    `cross_layers` > 0 makes it AttT2M: before they join the sequence, the token embeddings (without positions) attend
    to the text's words, token i (from 0) to words 0..i only, as published. `words="real"` hides the padding of the
    words, "all" lets it be seen (published weights saw all 77 positions). `layers` counts the published base and head
    together (9 + 9). `pkeep` is the share of input tokens that training doesn't replace by random codes; -1 draws one
    share per batch.
    """

    predicts_length = True

    @checked
    def __init__(
        self,
        *,
        codebook_size: Classes,
        text_dim: Size,
        token_dim: Size | None = None,
        width: Size = 1024,
        feedforward: Size = 4096,
        layers: Depth = 18,
        cross_layers: OptionalDepth = 0,
        heads: Size = 16,
        dropout: OpenShare = 0.1,
        pkeep: KeptShare = 0.5,
        words: Annotated[str, OneOf(WORDS)] = "real",
        max_latents: Size = 49,
        downsample: Size = 4,
        sampling: GptSampling | None = None,
    ) -> None:
        super().__init__(codebook_size=codebook_size, max_latents=max_latents, downsample=downsample)
        self.text_dim, self.token_dim = text_dim, token_dim if cross_layers else None
        if cross_layers and token_dim is None:
            raise ValueError(f"cross_layers={cross_layers} need token_dim, the width of the text's word features")
        self.end, self.pad = codebook_size, codebook_size + 1
        self.pkeep = pkeep
        self.words = words
        self.sampling = sampling or GptSampling()
        self.token_embedding = nn.Embedding(codebook_size + 2, width)
        self.text_projection = nn.Linear(text_dim, width)
        self.word_projection = nn.Linear(token_dim, width) if cross_layers and token_dim is not None else None
        self.cross_blocks = nn.ModuleList(
            TransformerBlock(width, heads, feedforward, dropout, cross=True) for _ in range(cross_layers)
        )
        self.blocks = nn.ModuleList(TransformerBlock(width, heads, feedforward, dropout) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.head = nn.Linear(width, codebook_size + 1, bias=False)
        initialize(self)

    def forward(
        self, ids: Int[Tensor, "b n"], text: TextFeatures, real: Bool[Tensor, "b m"] | None = None
    ) -> Float[Tensor, "b m k"]:
        """Return m = n + 1 positions' logits of codes and END: position 0 is the text and predicts token 0.

        They are zero where `real` says that nothing is to be predicted.
        """
        x = self.text_projection(text.pooled)[:, None]
        if ids.shape[1]:
            x = torch.cat((x, self._embed(ids, self._words(text), real=None if real is None else real[:, 1:])), dim=1)
        x = x + sinusoidal_positions(x.shape[1], x.shape[2], x.device).to(x.dtype)
        rows = Rows.of(x, real)
        lower = _lower(x.shape[1], x.shape[1], x.device)[None]
        return rows.pad(self._logits(run(self.blocks, rows.pack(x), lower, rows=rows)))

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
        draws: GptDraws | None = None,
    ) -> Losses:
        """Return the cross-entropy of each sample's codes and END, averaged per sample, then over samples.

        In training the inputs are corrupted by draws for the global batch, from `generator` (None: torch's own), of
        which this is the part `shard` = (rank, world); in eval mode they are as they are. Dropout is torch's own.
        `draws` replaces what is drawn (tests).
        """
        codes = self.codes(latents)
        wanted = targets(codes, latents.lengths, self.end, self.pad)
        ids = wanted[:, :-1]
        if draws is None and self.training:
            draws = self._draw(len(ids), generator, shard)
        if draws is not None:
            ids = corrupt(ids, draws)
        logits = self(ids, text, wanted != self.pad)
        entropy = F.cross_entropy(logits.mT, wanted, ignore_index=self.pad, reduction="none")
        hits = (logits.argmax(-1) == wanted).float()
        loss, accuracy = (mean_over_ranks(per_sample(v, latents.lengths), shard[1]) for v in (entropy, hits))
        return {"loss": loss, "accuracy": accuracy}

    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: GptSampling | None = None,
        draws: TokenDraws | None = None,
    ) -> Latents:
        """Generate the tokens of `frames` frames (END excluded), or with None until END, at most max_latents.

        A motion that would end before it begins is a single token of code 1, as published. The codes of `known` stay
        in their places and set the lengths where `frames` is None; each token sees what lies before it only, so that
        a kept code has no influence on the free ones to its left. A sample depends on its own seed only. `draws`
        replaces what the seeds draw (tests).
        """
        sampling = sampling or self.sampling
        request = self.request(text, frames, seeds, known)
        classes = self.codebook_size + request.open_end
        with inference(self):
            predict = self._predictor(text.to(self.head.weight.device), request.keep.shape[1], sampling.cache)
            codes, lengths = decode_left_to_right(
                lambda step, ids: sampling.narrow(predict(step, ids)[:, :classes]),
                request.codes[..., 0],
                request.lengths,
                draws or sampling.draws(seeds),
                keep=request.keep,
                end=self.end if request.open_end else None,
            )
        codes[:, 0] = codes[:, 0].masked_fill(lengths == 0, FALLBACK)
        lengths = lengths.clamp(min=1)
        base = self.latents(codes[:, : int(lengths.max())], lengths)
        return self.completed(base, text, seeds=seeds, known=known, sampling=sampling)

    def _words(self, text: TextFeatures) -> Words | None:
        """Project the words, for models that read them, and say which may be seen."""
        if self.word_projection is None:
            return None
        features, real = visible_words(text, self.words)
        if real is None:
            real = torch.ones(features.shape[:2], dtype=torch.bool, device=features.device)
        return self.word_projection(features), real

    def _embed(
        self,
        ids: Int[Tensor, "b n"],
        words: Words | None,
        start: int = 0,
        caches: Sequence[KeyValueCache] | None = None,
        real: Bool[Tensor, "b n"] | None = None,
    ) -> Float[Tensor, "b n w"]:
        """Embed tokens from `start` on; token i attends to words 0..i, of which caches hold those before `start`."""
        x = self.token_embedding(ids)
        if words is None:
            return x
        features, seen = words
        end = start + ids.shape[1]
        lower = _lower(end, min(end, seen.shape[1]), x.device)[start:]
        mask = lower & seen[:, None, :end]
        if caches:
            for block, cache in zip(self.cross_blocks, caches, strict=True):
                x = block(x, mask, features[:, start:end], cache)
            return x
        rows = Rows.of(x, real)
        x = rows.pack(x)
        for block in self.cross_blocks:
            x = block(x, mask, features[:, start:end], rows=rows)
        return rows.pad(x)

    def _logits(self, x: Float[Tensor, "*n w"]) -> Float[Tensor, "*n k"]:
        return self.head(self.norm(x))

    def _predictor(
        self, text: TextFeatures, size: int, cache: bool
    ) -> Callable[[int, Int[Tensor, "b n"]], Float[Tensor, "b k"]]:
        """Return the logits of a slot from the tokens before it: all of them anew, or the last one on top of caches.

        Token i sees the words 0..i, so that the cross-attention's caches grow by a word a token.
        """
        if not cache:
            return lambda step, ids: self(ids[:, :step], text)[:, -1]
        words = self._words(text)
        positions = sinusoidal_positions(size, self.head.in_features, text.pooled.device)
        own = [KeyValueCache(size) for _ in self.blocks]
        cross = [KeyValueCache(words[1].shape[1]) for _ in self.cross_blocks] if words else None

        def predict(step: int, ids: Int[Tensor, "b n"]) -> Float[Tensor, "b k"]:
            if step:
                x = self._embed(ids[:, step - 1 : step], words, step - 1, cross)
            else:
                x = self.text_projection(text.pooled)[:, None]
            return self._logits(run(self.blocks, x + positions[step].to(x.dtype), caches=own))[:, 0]

        return predict

    def _draw(self, batch: int, generator: torch.Generator | None, shard: tuple[int, int]) -> GptDraws:
        device = self.head.weight.device

        def draw(samples: int) -> GptDraws:
            shape = (samples, self.max_latents)
            return GptDraws.draw(
                shape, codebook_size=self.codebook_size, pkeep=self.pkeep, generator=generator, device=device
            )

        return share_of(draw, batch, shard)


def _lower(rows: int, columns: int, device: torch.device) -> Bool[Tensor, "r c"]:
    """Make the mask that lets row i see columns 0..i."""
    return torch.ones(rows, columns, dtype=torch.bool, device=device).tril()
