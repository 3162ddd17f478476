"""Build the networks of Guo et al.'s evaluator (T2M_EVALUATOR §2); attribute names are the published keys."""

from __future__ import annotations

import torch
from jaxtyping import Float, Int
from torch import Tensor, nn
from torch.nn.utils.rnn import pack_padded_sequence

POS_CLASSES = 15


class MovementEncoder(nn.Module):
    """Encode normalised motion (b, t, d) into movement codes (b, t // 4, latent_dim)."""

    def __init__(self, inputs: int, width: int, latent_dim: int, dropout: float = 0.2) -> None:
        super().__init__()
        self.main = nn.Sequential(
            *(nn.Conv1d(inputs, width, 4, 2, 1), nn.Dropout(dropout), nn.LeakyReLU(0.2)),
            *(nn.Conv1d(width, latent_dim, 4, 2, 1), nn.Dropout(dropout), nn.LeakyReLU(0.2)),
        )
        self.out_net = nn.Linear(latent_dim, latent_dim)
        self.apply(_xavier)

    def forward(self, motion: Float[Tensor, "b t d"]) -> Float[Tensor, "b n c"]:
        """Encode; a tail of fewer than four frames has no code of its own."""
        return self.out_net(self.main(motion.mT).mT)


class MovementDecoder(nn.Module):
    """Decode movement codes (b, n, latent_dim) to normalised motion (b, 4n, d); used by the pre-training only."""

    def __init__(self, latent_dim: int, width: int, outputs: int) -> None:
        super().__init__()
        self.main = nn.Sequential(
            *(nn.ConvTranspose1d(latent_dim, width, 4, 2, 1), nn.LeakyReLU(0.2)),
            *(nn.ConvTranspose1d(width, outputs, 4, 2, 1), nn.LeakyReLU(0.2)),
        )
        self.out_net = nn.Linear(outputs, outputs)
        self.apply(_xavier)

    def forward(self, codes: Float[Tensor, "b n c"]) -> Float[Tensor, "b t d"]:
        """Decode."""
        return self.out_net(self.main(codes.mT).mT)


class SequenceEncoder(nn.Module):
    """Summarise sequences of given lengths by a bidirectional GRU with a learned initial state."""

    def __init__(self, inputs: int, hidden: int, embedding: int) -> None:
        super().__init__()
        self.input_emb = nn.Linear(inputs, hidden)
        self.output_net = nn.Sequential(
            *(nn.Linear(2 * hidden, hidden), nn.LayerNorm(hidden), nn.LeakyReLU(0.2), nn.Linear(hidden, embedding))
        )
        self.apply(_xavier)
        self.gru = nn.GRU(hidden, hidden, batch_first=True, bidirectional=True)
        self.hidden = nn.Parameter(torch.randn(2, 1, hidden))

    def forward(self, sequence: Float[Tensor, "b n c"], lengths: Int[Tensor, " b"]) -> Float[Tensor, "b e"]:
        """Embed, in the order given."""
        # enforce_sorted=False sorts inside and undoes it: the published code returns batches sorted by length.
        packed = pack_padded_sequence(self.input_emb(sequence), lengths.cpu(), batch_first=True, enforce_sorted=False)
        start = self.hidden.expand(-1, len(sequence), -1).contiguous()
        final = self.gru(packed, start)[1]
        return self.output_net(torch.cat([final[0], final[1]], dim=-1))


class WordEncoder(SequenceEncoder):
    """Embed captions given as word vectors and one-hot word classes."""

    def __init__(self, word_width: int, hidden: int, embedding: int) -> None:
        super().__init__(word_width, hidden, embedding)
        self.pos_emb = nn.Linear(POS_CLASSES, word_width)
        self.pos_emb.apply(_xavier)

    def embed(
        self, words: Float[Tensor, "b l w"], classes: Float[Tensor, "b l 15"], lengths: Int[Tensor, " b"]
    ) -> Float[Tensor, "b e"]:
        """Embed, in the order given."""
        return self(words + self.pos_emb(classes), lengths)


def _xavier(module: nn.Module) -> None:
    if isinstance(module, nn.Linear | nn.Conv1d | nn.ConvTranspose1d):
        nn.init.xavier_normal_(module.weight)
        if module.bias is not None:
            nn.init.zeros_(module.bias)
