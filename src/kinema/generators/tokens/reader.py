"""Generate codes by a token transformer that reads the tokenizer's code vectors (MMM, BAD)."""

from __future__ import annotations

from jaxtyping import Float
from torch import Tensor

from kinema.generators import TrainingLatents
from kinema.generators.tokens.generator import TokenGenerator
from kinema.generators.tokens.transformer import TokenTransformer
from kinema.tokenizers import MotionTokenizer


class CodebookReader(TokenGenerator):
    """Keep a copy of the tokenizer's codebook in a `TokenTransformer`, taken over before training."""

    transformer: TokenTransformer

    @property
    def codebook(self) -> Float[Tensor, "k d"]:
        """The tokenizer's code vectors (zeros until `set_codebook`)."""
        return self.transformer.codebook

    def set_codebook(self, codebook: Float[Tensor, "k d"]) -> None:
        """Take over the tokenizer's code vectors; call it before training."""
        self.transformer.set_codebook(codebook)

    def prepare(self, tokenizer: MotionTokenizer, latents: TrainingLatents) -> None:
        """Take over the tokenizer's code vectors."""
        if tokenizer.codebook is None:
            raise ValueError(
                f"{type(self).__name__} reads code vectors and {type(tokenizer).__name__} has none; use a tokenizer of "
                "codes"
            )
        self.set_codebook(tokenizer.codebook)
