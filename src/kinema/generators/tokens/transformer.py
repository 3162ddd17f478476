"""Predict all codes of a sequence at once: the bidirectional token transformer that MMM and BAD share."""

from __future__ import annotations

from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.generators.tokens.words import WORDS, visible_words
from kinema.nn.embeddings import sinusoidal_positions
from kinema.nn.rows import Rows
from kinema.nn.transformer import TransformerBlock, initialize, run
from kinema.options import OneOf, checked
from kinema.types import Losses, TextFeatures


class TokenTransformer(nn.Module):
    """Embed codes by the tokenizer's frozen codebook, attend to words, then to each other (MMM, BAD §2).

    Ids below `codebook_size` are codes; the `specials` ids from there on (END, PAD, then masks) have learned rows of
    `code_dim`. The text's sentence vector and further condition tokens stand before the sequence. words="real" attends
    to real words only, "all" to the padding too (as published: CLIP's 77 positions, unmasked).
    """

    codebook: Float[Tensor, "k d"]

    @checked
    def __init__(
        self,
        *,
        codebook_size: int,
        code_dim: int,
        specials: int,
        text_dim: int,
        token_dim: int,
        width: int = 1024,
        heads: int = 16,
        feedforward: int = 4096,
        cross_layers: int = 2,
        base_layers: int = 7,
        head_layers: int = 9,
        dropout: float = 0.1,
        words: Annotated[str, OneOf(WORDS)] = "real",
    ) -> None:
        super().__init__()
        self.words = words
        self.special = nn.Embedding(specials, code_dim)
        self.input_projection = nn.Linear(code_dim, width)
        self.text_projection = nn.Linear(text_dim, width)
        self.word_projection = nn.Linear(token_dim, width) if cross_layers else None
        self.cross_blocks = nn.ModuleList(
            TransformerBlock(width, heads, feedforward, dropout, cross=True) for _ in range(cross_layers)
        )
        self.base_blocks, self.head_blocks = (
            nn.ModuleList(TransformerBlock(width, heads, feedforward, dropout) for _ in range(layers))
            for layers in (base_layers, head_layers)
        )
        self.norm = nn.LayerNorm(width)
        self.head = nn.Linear(width, codebook_size, bias=False)
        initialize(self)
        self.register_buffer("codebook", torch.zeros(codebook_size, code_dim))

    def set_codebook(self, codebook: Float[Tensor, "k d"]) -> None:
        """Take over the tokenizer's codebook (a copy, never trained); call it before training."""
        if codebook.shape != self.codebook.shape:
            raise ValueError(
                f"the tokenizer's codebook is {tuple(codebook.shape)}, this generator was built for "
                f"{tuple(self.codebook.shape)}; set codebook_size and code_dim to the tokenizer's"
            )
        self.codebook.copy_(codebook)

    def forward(
        self,
        ids: Int[Tensor, "b n"],
        text: TextFeatures,
        real: Bool[Tensor, "b n"],
        extra: Float[Tensor, "b e w"] | None = None,
        mask: Bool[Tensor, "b m m"] | None = None,
    ) -> Float[Tensor, "b m k"]:
        """Return logits at every position of [sentence, extra..., ids], m = 1 + e + n; zero at ids that aren't `real`.

        `mask` says which row sees which column (None: each all of them); none sees padding. Sinusoids are added to the
        ids before the words are attended to (if they are), and again to the whole sequence (MMM, BAD §2).
        """
        x = self.embed(ids)
        if self.word_projection is not None:
            x = self._attend_to_words(_with_positions(x), Rows(real), text, self.word_projection)
        sentence = self.text_projection(text.pooled)[:, None]
        x = torch.cat((sentence, x) if extra is None else (sentence, extra, x), dim=1)
        rows = Rows.behind(x.shape[1] - ids.shape[1], real)
        x = run((*self.base_blocks, *self.head_blocks), rows.pack(_with_positions(x)), mask, rows=rows)
        return rows.pad(self.head(self.norm(x)))

    def embed(self, ids: Int[Tensor, "b n"]) -> Float[Tensor, "b n w"]:
        """Project codebook rows and learned rows."""
        return self.input_projection(F.embedding(ids, torch.cat((self.codebook, self.special.weight))))

    def _attend_to_words(
        self, x: Float[Tensor, "b n w"], rows: Rows, text: TextFeatures, project: nn.Linear
    ) -> Float[Tensor, "b n w"]:
        features, seen = visible_words(text, self.words)
        words, x = project(features), rows.pack(x)
        for block in self.cross_blocks:
            x = block(x, seen, words, rows=rows)
        return rows.pad(x)


def with_end(
    ids: Int[Tensor, "b n"], lengths: Int[Tensor, " b"], codebook_size: int
) -> tuple[Int[Tensor, "b n1"], Bool[Tensor, "b n1"]]:
    """Append a slot; write END after each sample's ids and PAD past it. Also give the mask of what may be seen."""
    slots = torch.arange(ids.shape[1] + 1, device=ids.device)
    end = lengths[:, None]
    ids = torch.where(slots < end, F.pad(ids, (0, 1)), codebook_size + (slots > end).long())
    return ids, slots <= end


def code_losses(
    logits: Float[Tensor, "b m k"], codes: Int[Tensor, "b n"], real: Bool[Tensor, "b n"], conditions: int = 1
) -> Losses:
    """Average cross entropy and accuracy over each sample's real positions, then over samples (MMM; BAD §3.7).

    Logits are those of `conditions` tokens, the n positions and the END slot.
    """
    logits, target = logits[F.pad(real, (conditions, 1))], codes[real]
    weight = (real / (len(real) * real.sum(dim=1, keepdim=True)))[real]
    entropy = F.cross_entropy(logits.float(), target, reduction="none")
    hits = (logits.argmax(-1) == target).float()
    return {"loss": (weight * entropy).sum(), "accuracy": (weight * hits).sum()}


def _with_positions(x: Float[Tensor, "b n w"]) -> Float[Tensor, "b n w"]:
    return x + sinusoidal_positions(x.shape[1], x.shape[2], x.device).to(x.dtype)
