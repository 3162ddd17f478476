"""Build what a generator retrieves from: the training split's captions, their features and their motions (ReMoDiffuse)."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
from omegaconf import DictConfig

from kinema.data.store import PackedStore
from kinema.experiments.stages.base import Stage, Summary, dims
from kinema.runs.folder import RunFolder

if TYPE_CHECKING:
    from kinema.generators.remodiffuse import RetrievalDatabase
    from kinema.text.frozen import FrozenTextEncoder
    from kinema.tokenizers import MotionTokenizer

CHUNK = 256
"""Texts that are read from the cache at once."""


class RetrievalStage(Stage):
    """Build the database, of the method's text features and its tokenizer's frames; nothing is fitted."""

    name = "retrieval"
    node = "generator.retrieval"
    needs = ("tokenizer",)
    needed_by = ("generator",)
    reads = ("text",)

    def label(self, cfg: DictConfig) -> str:
        """Name the method that retrieves, and its dims."""
        return f"{cfg.generator.name}_retrieval-{dims(cfg)}"

    def check(self, cfg: DictConfig, store: PackedStore) -> None:
        """Check that the training split has as many captions as neighbours are retrieved."""
        from kinema.data.datasets import ClipDataset

        count, wanted = int(_rows(store, ClipDataset(store, "train").entries)["captions"].sum()), self._wanted(cfg)
        if count < wanted:
            raise ValueError(
                f"corpus {store.name!r} has {count} captions in its training split, fewer than the {wanted} neighbours "
                "that are retrieved; use a larger corpus or a smaller generator.model.neighbours"
            )

    def make(self, cfg: DictConfig, store: PackedStore, needs: dict[str, RunFolder], folder: RunFolder) -> Summary:
        """Encode captions and motions, and write them."""
        from kinema.devices import find_device
        from kinema.experiments.instantiate import encode_captions, read_model, text_encoder
        from kinema.runs import weights
        from kinema.runs.parts import write_text_encoder

        started, device = time.monotonic(), find_device(cfg.trainer.accelerator)
        (tokenizer_name,) = self.needs
        tokenizer = read_model(needs[tokenizer_name].path, tokenizer_name)
        text = encode_captions(text_encoder(cfg, device), store, "train")
        database = build_database(store, text, tokenizer, max_frames=self.config(cfg).max_frames)
        meta = {"part": self.name, "label": folder.path.name, "corpus": store.hash, "text": text.identity}
        assert database.spec is not None
        weights.save(
            database, database.spec, folder.weights, **meta, representation=tokenizer.representation.identity()
        )
        write_text_encoder(folder.path, cfg.text.name, cfg.text.path)
        return Summary(round(time.monotonic() - started, 1), device=str(device))

    def _wanted(self, cfg: DictConfig) -> int:
        return int(cfg.generator.model.neighbours)


def build_database(
    store: PackedStore, text: FrozenTextEncoder, tokenizer: MotionTokenizer, *, max_frames: int
) -> RetrievalDatabase:
    """Build the database of the entries that training sees; of a motion it holds at most `max_frames` frames."""
    import torch

    from kinema.data.datasets import ClipDataset
    from kinema.generators.remodiffuse import RetrievalDatabase

    entries = ClipDataset(store, "train").entries
    rows = _rows(store, entries)
    clips, clip_of = np.unique(rows["clip"], return_inverse=True)
    frames = [_encoded(tokenizer, store.clip_frames(int(clip))) for clip in clips]
    first = np.concatenate([[0], np.cumsum([len(values) for values in frames])[:-1]])
    starts = first[clip_of] + rows["offset"] - store.clips["offset"][rows["clip"]]
    families: dict[str, int] = {}
    names = [_unmirrored(store, int(clip)) for clip in clips]
    family = np.array([families.setdefault(name, len(families)) for name in names])
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


def _rows(store: PackedStore, entries: np.ndarray) -> np.ndarray:
    return store.entries[entries]


def _unmirrored(store: PackedStore, clip: int) -> str:
    """Name a clip, and its mirror image alike."""
    name = store.clip_name(clip)
    return name[1:] if store.clips[clip]["mirrored"] else name


def _encoded(tokenizer: MotionTokenizer, features: np.ndarray):
    import torch

    from kinema.types import MotionBatch

    motion = MotionBatch(torch.from_numpy(np.array(features))[None], torch.tensor([len(features)]))
    return tokenizer.encode(motion).content[0]


def _features(text: FrozenTextEncoder, texts: list[str]):
    """Return pooled vectors, and each text's own token features."""
    import torch

    pooled, tokens = [], []
    for start in range(0, len(texts), CHUNK):
        found = text(texts[start : start + CHUNK]).to("cpu")
        if found.tokens is None or found.token_mask is None:
            raise ValueError("retrieval reads token features, and these texts have none; set generator.reads_tokens=true")
        pooled.append(found.pooled.float())
        tokens += [row[seen] for row, seen in zip(found.tokens.float(), found.token_mask, strict=True)]
    return torch.cat(pooled), tokens
