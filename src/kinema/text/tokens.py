"""Turn texts into token ids and frozen embeddings for the CLIP-style evaluator (CLIP_EVALUATOR §1)."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from kinema.files.checkpoints import read_safetensors, read_torch
from kinema.files.json import read_json
from kinema.text.clip import clip_tokenizer
from kinema.text.files import INSTALL, clip_folder, minilm_folder, require, short_hash, weights_file
from kinema.text.frozen import check_texts
from kinema.text.hashed import split_words, word_vector

KINDS = ("auto", "clip_b16", "minilm", "hashed")
REPOSITORY = "openai/clip-vit-base-patch16"
OPTION = f"its path, or use the tokens 'minilm' ({INSTALL})"
CONTEXT = 77
HASHED = (1024, 64)


@dataclass(frozen=True)
class TokenTable:
    """Hold a frozen token embedding, its positional embedding and the tokenizer that makes the ids.

    Ids are `context` long: truncated so that the end token stays, padded with 0. Calling gives them on the CPU.

    Attributes:
        end: id of the end-of-text token.
        split: gives the ids of each text, start and end token included, truncated to the context.
    """

    identity: str
    embedding: Float[Tensor, "v e"]
    positional: Float[Tensor, "l e"]
    end: int
    split: Callable[[list[str]], list[list[int]]]

    @property
    def context(self) -> int:
        """The number of ids of a text."""
        return len(self.positional)

    def __call__(self, texts: list[str]) -> Int[Tensor, "b l"]:
        ids = torch.zeros(len(texts), self.context, dtype=torch.int64)
        for row, found in zip(ids, self.split(check_texts(texts)), strict=True):
            row[: len(found)] = torch.tensor(found)
        return ids

    def end_positions(self, ids: Int[Tensor, "b l"]) -> Int[Tensor, " b"]:
        """Return the position of each text's first end token."""
        return (ids == self.end).int().argmax(1)


def clip_tokens(kind: str = "auto", path: str | Path | None = None) -> TokenTable:
    """Make a token table by name.

    Args:
        kind: "clip_b16" (CLIP ViT-B/16 from the folder or hub id `path`), "minilm" (word and position embeddings of the
            MiniLM wheel), "hashed" (random: tests) or "auto": clip_b16 where `path` is given, else minilm.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown token table {kind!r}; choose one of {', '.join(KINDS)}")
    if kind == "auto":
        kind = "minilm" if path is None else "clip_b16"
    if kind == "clip_b16":
        return _clip(path)
    if path is not None:
        raise ValueError(f"the token table {kind!r} has no path, got {str(path)!r}; remove it or use 'clip_b16'")
    return _minilm() if kind == "minilm" else _hashed()


def _clip(path: str | Path | None) -> TokenTable:
    folder = clip_folder(path, REPOSITORY, OPTION)
    config = read_json(folder / "config.json")
    prefix = "text_model.embeddings."
    tokens, positions = _read(folder, f"{prefix}token_embedding.weight", f"{prefix}position_embedding.weight")
    tokenizer = clip_tokenizer(folder, config.get("text_config", config).get("vocab_size", len(tokens)))
    # CLIP's own rule, argmax of the ids, finds the end token because it is the last of the vocabulary.
    split = functools.partial(_split, tokenizer, len(positions))
    return TokenTable(_name("clip_b16", folder), tokens, positions, len(tokens) - 1, split)


def _minilm() -> TokenTable:
    folder = minilm_folder()
    tokens, positions = _read(folder, "embeddings.word_embeddings.weight", "embeddings.position_embeddings.weight")
    transformers = require("transformers", "the MiniLM tokens")
    tokenizer = transformers.AutoTokenizer.from_pretrained(folder, local_files_only=True)
    split = functools.partial(_split, tokenizer, CONTEXT)
    return TokenTable(_name("minilm", folder), tokens, positions[:CONTEXT].clone(), tokenizer.sep_token_id, split)


def _hashed() -> TokenTable:
    """Hash words to the ids 2 .. V-2; 1 starts a text, V-1 ends it."""
    size, width = HASHED
    embedding = torch.from_numpy(np.stack([word_vector(f"token {i}", width) for i in range(size)]))
    positional = torch.from_numpy(np.stack([word_vector(f"position {i}", width) for i in range(CONTEXT)]))
    return TokenTable(f"hashed-{size}x{width}", embedding * 0.02, positional * 0.02, size - 1, _hashed_ids)


def _hashed_ids(texts: list[str]) -> list[list[int]]:
    end = HASHED[0] - 1
    ids = [[2 + int(abs(word_vector(w, 1)[0]) * 1e6) % (end - 2) for w in split_words(text)] for text in texts]
    return [[1, *found[: CONTEXT - 2], end] for found in ids]


def _split(tokenizer: Any, context: int, texts: list[str]) -> list[list[int]]:
    return tokenizer(texts, truncation=True, max_length=context)["input_ids"]


def _name(kind: str, folder: Path) -> str:
    return f"{kind}_tokens-{short_hash(weights_file(folder))}"


def _read(folder: Path, *names: str) -> list[Tensor]:
    """Read tensors by name from a weights file without the rest of the model."""
    file = weights_file(folder)
    if file.suffix == ".bin":
        state = read_torch(file)
        if missing := [name for name in names if not isinstance(state.get(name), Tensor)]:
            raise ValueError(f"{file} holds no {', '.join(missing)}; give the weights of a CLIP model")
        return [state[name].float().clone() for name in names]
    state, _ = read_safetensors(file, *names)
    return [state[name].float() for name in names]
