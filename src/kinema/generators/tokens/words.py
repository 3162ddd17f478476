"""Say which words of a text a generator may look at."""

from __future__ import annotations

from jaxtyping import Bool, Float
from torch import Tensor

from kinema.types import TextFeatures

WORDS = ("real", "all")
"""Real words only, or all 77 positions of CLIP as the published weights saw them (COMMON §6)."""


def visible_words(text: TextFeatures, words: str) -> tuple[Float[Tensor, "b l t"], Bool[Tensor, "b l"] | None]:
    """Return the words' features and the mask of the visible ones, None where all are.

    Raises ValueError for features without words, and for words="all" where some are padding: a batch's own padding
    would make a sample depend on its neighbours.
    """
    if text.tokens is None:
        raise ValueError(
            "this generator attends to words, but the text features hold the pooled vector alone; encode the text "
            "with token features (reads_tokens: true), or build the generator with cross_layers=0"
        )
    if words == "all" and text.token_mask is not None:
        if not text.token_mask.all():
            raise ValueError(
                "words='all' reads all positions, but these text features are padded to the batch's longest text; use "
                "text=clip_b32_77, or words='real'"
            )
        return text.tokens, None
    return text.tokens, text.token_mask
