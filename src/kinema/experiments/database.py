"""Build what a generator retrieves from: the training split's captions, their features and their motions."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from kinema.data.datasets import ClipDataset
from kinema.data.store import PackedStore
from kinema.generators.remodiffuse import RetrievalDatabase
from kinema.text.frozen import FrozenTextEncoder
from kinema.tokenizers import MotionTokenizer
from kinema.types import MotionBatch

CHUNK = 256
"""Texts that are read from the cache at once."""


def build_database(
    store: PackedStore, text: FrozenTextEncoder, tokenizer: MotionTokenizer, *, max_frames: int
) -> RetrievalDatabase:
    """Build the database of the entries that training sees; of a motion it holds at most `max_frames` frames."""
    entries = ClipDataset(store, "train").entries
    rows = store.entries[entries]
    clips, clip_of = np.unique(rows["clip"], return_inverse=True)
    frames = [_encoded(tokenizer, store.clip_frames(int(clip))) for clip in clips]
    first = np.concatenate([[0], np.cumsum([len(values) for values in frames])[:-1]])
    starts = first[clip_of] + rows["offset"] - store.clips["offset"][rows["clip"]]
    families: dict[str, int] = {}
    family = np.array([families.setdefault(_unmirrored(store, int(clip)), len(families)) for clip in clips])
    captions = [(c.text, i) for i, entry in enumerate(entries) for c in store.entry_captions(int(entry))]
    texts = {string: i for i, string in enumerate(dict.fromkeys(string for string, _ in captions))}
    pooled, tokens = _features(text, list(texts))
    return RetrievalDatabase.holding(
        pooled=pooled,
        tokens=tokens,
        frames=torch.cat(frames),
        starts=torch.from_numpy(starts.astype(np.int64)),
        lengths=torch.from_numpy(np.minimum(rows["frames"], max_frames).astype(np.int64)),
        families=torch.from_numpy(family[clip_of].astype(np.int64)),
        captions=torch.tensor([(texts[string], entry) for string, entry in captions]),
        names=[store.entry_name(int(entry)) for entry in entries],
    )


def _unmirrored(store: PackedStore, clip: int) -> str:
    """Name a clip, and its mirror image alike."""
    name = store.clip_name(clip)
    return name[1:] if store.clips[clip]["mirrored"] else name


def _encoded(tokenizer: MotionTokenizer, features: np.ndarray) -> Float[Tensor, "t d"]:
    motion = MotionBatch(torch.from_numpy(np.array(features))[None], torch.tensor([len(features)]))
    return tokenizer.encode(motion).content[0]


def _features(text: FrozenTextEncoder, texts: list[str]) -> tuple[Float[Tensor, "u c"], list[Float[Tensor, "_ k"]]]:
    """Return pooled vectors, and each text's own token features."""
    pooled, tokens = [], []
    for start in range(0, len(texts), CHUNK):
        found = text(texts[start : start + CHUNK]).to("cpu")
        if found.tokens is None or found.token_mask is None:
            raise ValueError("retrieval reads token features, and these texts have none; set reads_tokens: true")
        pooled.append(found.pooled.float())
        tokens += [row[seen] for row, seen in zip(found.tokens.float(), found.token_mask, strict=True)]
    return torch.cat(pooled), tokens
