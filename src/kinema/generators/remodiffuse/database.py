"""Hold the captions and motions that are retrieved from, and find the nearest of them exactly (ReMoDiffuse §2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import torch
from jaxtyping import Bool, Float, Int, UInt8
from torch import Tensor, nn
from torch.nn import functional as F

from kinema.options import Number, Size, checked
from kinema.registry import buildable
from kinema.types import frame_mask


@dataclass(frozen=True)
class Neighbours:
    """Hold the `k` neighbours of each sample: motions and their texts' token features, zero past their lengths."""

    motions: Float[Tensor, "b k t d"]
    lengths: Int[Tensor, "b k"]
    tokens: Float[Tensor, "b k l c"]
    token_lengths: Int[Tensor, "b k"]


@buildable
class RetrievalDatabase(nn.Module):
    """Hold what captions and motions of a training split are searched by, and themselves; nothing of it is trained.

    A row of `captions` is a text and an entry. Equal texts are held once (`keys`, of length 1, and the `tokens` of all,
    each text's up to its `token_ends`), and so is each clip: entries are views of `frames`, from `starts` on.
    `families` are equal for entries of one clip and of its mirror image; `names` are the entries' names, a line each.
    The arguments are the sizes of all that.
    """

    keys: Float[Tensor, "u c"]
    tokens: Float[Tensor, "m k"]
    token_ends: Int[Tensor, " u"]
    frames: Float[Tensor, "f d"]
    starts: Int[Tensor, " e"]
    lengths: Int[Tensor, " e"]
    families: Int[Tensor, " e"]
    captions: Int[Tensor, "n 2"]
    names: UInt8[Tensor, " s"]

    spec: dict[str, Any] | None = None

    @checked
    def __init__(
        self,
        *,
        texts: Number,
        text_dim: Size,
        tokens: Number,
        token_dim: Size,
        frames: Number,
        frame_dim: Size,
        entries: Number,
        captions: Number,
        names: Number,
    ) -> None:
        super().__init__()
        self.text_dim, self.token_dim, self.frame_dim = text_dim, token_dim, frame_dim
        for name, shape in {
            "keys": (texts, text_dim),
            "tokens": (tokens, token_dim),
            "frames": (frames, frame_dim),
        }.items():
            self.register_buffer(name, torch.zeros(shape))
        for name in ("starts", "lengths", "families"):
            self.register_buffer(name, torch.zeros(entries, dtype=torch.long))
        self.register_buffer("token_ends", torch.zeros(texts, dtype=torch.long))
        self.register_buffer("captions", torch.zeros(captions, 2, dtype=torch.long))
        self.register_buffer("names", torch.zeros(names, dtype=torch.uint8))

    @classmethod
    def holding(
        cls,
        *,
        pooled: Float[Tensor, "u c"],
        tokens: Sequence[Float[Tensor, "_ k"]],
        frames: Float[Tensor, "f d"],
        starts: Int[Tensor, " e"],
        lengths: Int[Tensor, " e"],
        families: Int[Tensor, " e"],
        captions: Int[Tensor, "n 2"],
        names: Sequence[str],
    ) -> RetrievalDatabase:
        """Make a database of its content: `pooled` and `tokens` per text, the rest as the class says."""
        content = {
            "keys": F.normalize(pooled, dim=-1),
            "tokens": torch.cat(list(tokens)),
            "token_ends": torch.tensor([len(rows) for rows in tokens]).cumsum(0),
            "frames": frames,
            "starts": starts,
            "lengths": lengths,
            "families": families,
            "captions": captions,
            "names": torch.tensor(list("\n".join(names).encode()), dtype=torch.uint8),
        }
        sizes = {
            "texts": len(pooled),
            "text_dim": pooled.shape[1],
            "tokens": len(content["tokens"]),
            "token_dim": content["tokens"].shape[1],
            "frames": len(frames),
            "frame_dim": frames.shape[1],
            "entries": len(starts),
            "captions": len(captions),
            "names": len(content["names"]),
        }
        with torch.device("meta"):
            database = cls(**sizes)
        database.load_state_dict(content, assign=True)
        database.spec = {"_target_": f"{cls.__module__}.{cls.__name__}", **sizes}
        return database

    def __deepcopy__(self, memo: dict[int, Any]) -> RetrievalDatabase:
        """Be shared by the copies of a model that has it beside it: it is large, and never changes."""
        return self

    @cached_property
    def family_of(self) -> dict[str, int]:
        """The family of each entry, by its name."""
        names = bytes(self.names.tolist()).decode().split("\n")
        return dict(zip(names, self.families.tolist(), strict=True))

    def scores(
        self, pooled: Float[Tensor, "b c"], lengths: Int[Tensor, " b"], *, length_weight: float = 0.1
    ) -> Float[Tensor, "b n"]:
        """Score every caption: cosine * exp(-length_weight |l_i - l| / max(l_i, l)), ReMoDiffuse §2.

        Captions of one text and one length have equal scores, to the bit. Raises ValueError for other text features.
        """
        if pooled.shape[1] != self.text_dim:
            raise ValueError(
                f"this database is searched by text features of {self.text_dim} numbers, not of {pooled.shape[1]}; use "
                "the text encoder that it was built with"
            )
        text, entry = self.captions.unbind(1)
        cosine = (F.normalize(pooled.to(self.keys), dim=-1) @ self.keys.T)[:, text]
        own, asked = self.lengths[entry], lengths.to(entry)[:, None]
        return cosine * torch.exp(-length_weight * (own - asked).abs() / torch.maximum(own, asked))

    def same_length(self, lengths: Int[Tensor, " b"]) -> Bool[Tensor, "b n"]:
        """Find the captions of motions of exactly these lengths."""
        return self.lengths[self.captions[:, 1]] == lengths.to(self.lengths)[:, None]

    def same_clip(self, clip_ids: Sequence[str]) -> Bool[Tensor, "b n"]:
        """Find the captions of these entries' clips: their own, their parts' and their mirror images'."""
        families = torch.tensor([self.family_of.get(name, -1) for name in clip_ids], device=self.families.device)
        return self.families[self.captions[:, 1]] == families[:, None]

    def gather(self, rows: Int[Tensor, "b k"]) -> Neighbours:
        """Return the motions and the token features of captions."""
        text, entry = self.captions[rows].unbind(-1)
        first = F.pad(self.token_ends, (1, 0))[text]
        counts, lengths = self.token_ends[text] - first, self.lengths[entry]
        motions = _pieces(self.frames, self.starts[entry], lengths)
        return Neighbours(motions, lengths, _pieces(self.tokens, first, counts), counts)


def best(scores: Float[Tensor, "b n"], count: int, excluded: Bool[Tensor, "b n"] | None = None) -> Int[Tensor, "b k"]:
    """Return the columns of the `count` greatest scores of each row, the lowest column first among equal ones.

    Raises ValueError where `excluded` leaves fewer.
    """
    found = []
    scores = scores.clone() if excluded is None else scores.masked_fill(excluded, -torch.inf)
    for _ in range(count):
        value, column = scores.max(dim=1, keepdim=True)
        found.append(column)
        scores.scatter_(1, column, -torch.inf)
    if value.isneginf().any():
        raise ValueError(
            f"fewer than {count} captions are left to retrieve from once a sample's own are excluded; give a larger "
            "corpus, or a smaller generator.model.neighbours"
        )
    return torch.cat(found, dim=1)


def _pieces(rows: Float[Tensor, "f d"], starts: Int[Tensor, "b k"], counts: Int[Tensor, "b k"]) -> Tensor:
    """Cut stretches out of rows, padded with zeros to the longest."""
    size = int(counts.max())
    real = frame_mask(counts.flatten(), size).unflatten(0, counts.shape)
    index = starts[..., None] + torch.arange(size, device=rows.device)
    return rows[index.clamp(max=len(rows) - 1)] * real[..., None]
