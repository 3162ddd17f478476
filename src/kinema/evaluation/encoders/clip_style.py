"""Contrast motion and text by cosine: MARDM's CLIP-style evaluator (CLIP_EVALUATOR §1-§4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Self

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.evaluation.encoders.base import TextMotionEvaluator, caption_keys, false_negatives, symmetric_cross_entropy
from kinema.motion.representation import Representation
from kinema.nn.ranks import gather
from kinema.options import Classes, Depth, OpenShare, Size, checked
from kinema.registry import buildable
from kinema.types import Caption, Losses, MotionBatch

MAX_POSITIONS = 2000


class MotionTransformer(nn.Module):
    """Summarise normalised motion by a learned query token in front of the frames."""

    positions: Float[Tensor, "l c"]

    def __init__(self, inputs: int, width: int, embedding: int, layers: nn.TransformerEncoder, dropout: float) -> None:
        super().__init__()
        self.query_token = nn.Parameter(torch.randn(1, width))
        self.embed_motion = nn.Linear(inputs, width)
        self.dropout = nn.Dropout(dropout)
        self.transformer = layers
        self.out_ln = nn.LayerNorm(width)
        self.out = nn.Linear(width, embedding)
        self.register_buffer("positions", sinusoids(MAX_POSITIONS, width), persistent=False)

    def forward(self, motion: Float[Tensor, "b t d"], mask: Bool[Tensor, "b t"]) -> Float[Tensor, "b e"]:
        """Embed; padded frames are no keys, the query always is one."""
        if motion.shape[1] >= MAX_POSITIONS:
            raise ValueError(f"motion of {motion.shape[1]} frames is too long; at most {MAX_POSITIONS - 1} are allowed")
        query = self.query_token.expand(len(motion), 1, -1)
        sequence = torch.cat([query, self.embed_motion(motion)], dim=1)
        sequence = self.dropout(sequence + self.positions[: sequence.shape[1]])
        padding = F.pad(~mask, (1, 0), value=False)
        return self.out(self.out_ln(self.transformer(sequence, src_key_padding_mask=padding)[:, 0]))


class TextTransformer(nn.Module):
    """Summarise token embeddings at the end-of-text position, with neither causal nor padding mask."""

    def __init__(self, token_width: int, width: int, embedding: int, layers: nn.TransformerEncoder) -> None:
        super().__init__()
        # CLIP's 512 fits the published width, so that the published weights need no projection.
        self.project = nn.Linear(token_width, width) if token_width != width else nn.Identity()
        self.transformer = layers
        self.text_ln = nn.LayerNorm(width)
        self.out = nn.Linear(width, embedding)

    def forward(self, tokens: Float[Tensor, "b l k"], ends: Int[Tensor, " b"]) -> Float[Tensor, "b e"]:
        """Embed."""
        states = self.text_ln(self.transformer(self.project(tokens)))
        return self.out(states[torch.arange(len(states), device=states.device), ends])


@buildable
class ContrastiveEvaluator(TextMotionEvaluator):
    """Embed motion and text on the unit sphere; CLIP-score is their cosine.

    `attach` gives the token table: ids, end positions, the frozen token embedding and its positions. With
    `vocabulary` (its size) the module owns frozen copies of the two instead, as the published checkpoints do; attaching
    a table fills them if nothing was loaded. `mask_duplicates` leaves out negatives whose caption says the same.
    """

    token_embedding: Float[Tensor, "v k"] | None
    token_positions: Float[Tensor, "l k"] | None

    @checked
    def __init__(
        self,
        representation: Representation,
        *,
        token_width: Size = 512,
        width: Size = 512,
        layers: Depth = 8,
        heads: Size = 8,
        feedforward: Size = 1024,
        dropout: OpenShare = 0.2,
        embedding: Size = 512,
        mask_duplicates: bool = False,
        vocabulary: Classes | None = None,
        context: Size = 77,
    ) -> None:
        super().__init__(representation, {})
        self.mask_duplicates = mask_duplicates
        self.token_width = token_width

        def encoder() -> nn.TransformerEncoder:
            layer = nn.TransformerEncoderLayer(width, heads, feedforward, dropout, "gelu", batch_first=True)
            return nn.TransformerEncoder(layer, layers, enable_nested_tensor=False)

        self.motion_encoder = MotionTransformer(representation.width, width, embedding, encoder(), dropout)
        self.text_encoder = TextTransformer(token_width, width, embedding, encoder())
        self.logit_scale = nn.Parameter(torch.tensor(math.log(1 / 0.07)))
        sizes = None if vocabulary is None else (vocabulary, context)
        for name, size in zip(("token_embedding", "token_positions"), sizes or (None, None), strict=True):
            self.register_buffer(name, None if size is None else torch.zeros(size, token_width))

    def attach(self, vocabulary: Any) -> Self:
        """Hold the token table beside the module; its width must be `token_width`."""
        if vocabulary.embedding.shape[1] != self.token_width:
            found = vocabulary.embedding.shape[1]
            raise ValueError(
                f"the token table {vocabulary.identity} has width {found}, this evaluator was built with "
                f"token_width={self.token_width}; set token_width={found}"
            )
        table, positions = self.token_embedding, self.token_positions
        if table is not None and positions is not None and not table.any():
            table.copy_(vocabulary.embedding)
            positions.copy_(vocabulary.positional)
        return super().attach(vocabulary)

    def embed_motion(self, batch: MotionBatch) -> Float[Tensor, "b e"]:
        """Embed motions, in the order given; normalised."""
        motion = self.representation.normalize(batch.features, batch.lengths)
        return F.normalize(self.motion_encoder(motion, batch.mask), dim=-1)

    def embed_text(self, captions: Sequence[Caption]) -> Float[Tensor, "b e"]:
        """Embed whole captions, in the order given; normalised."""
        table, device = self.vocabulary, self.logit_scale.device
        ids = table([caption.text for caption in captions])
        ends = table.end_positions(ids).to(device)
        return F.normalize(self.text_encoder(self._tokens(ids), ends), dim=-1)

    def loss(
        self, batch: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Return the symmetric cross entropy over the batch of all ranks.

        `shard` = (rank, ranks that share the batch); each of them computes the whole loss from gathered embeddings.
        There is nothing to draw from `generator`.
        """
        motion, text = (gather(x, shard[1]) for x in (self.embed_motion(batch), self.embed_text(batch.captions)))
        logits = self.logit_scale.exp() * motion @ text.T
        if self.mask_duplicates:
            keys = gather(caption_keys(batch.texts, text.device), shard[1])
            logits = logits.masked_fill(false_negatives(keys), -torch.inf)
        return {"loss": symmetric_cross_entropy(logits), "logit_scale": self.logit_scale.detach().exp()}

    @torch.no_grad()
    def _tokens(self, ids: Int[Tensor, "b l"]) -> Float[Tensor, "b l k"]:
        """Look up frozen embeddings and add frozen positions."""
        table, positions = self.token_embedding, self.token_positions
        if table is None or positions is None:
            table, positions = self.vocabulary.embedding, self.vocabulary.positional
        # The table stays where it is (it may be large); only the rows in use move.
        rows = F.embedding(ids.to(table.device).long(), table) + positions[: ids.shape[1]]
        return rows.to(self.logit_scale.device, torch.float32)


def sinusoids(length: int, width: int) -> Float[Tensor, "l c"]:
    """Make interleaved sine and cosine positions, base 10000."""
    frequency = torch.exp(torch.arange(0, width, 2) * (-math.log(10000.0) / width))
    angle = torch.arange(length)[:, None] * frequency
    return torch.stack([angle.sin(), angle.cos()], dim=-1).flatten(1)[:, :width]
