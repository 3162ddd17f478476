"""Cache what a frozen tokenizer makes of every crop a clip can have (at most twelve), so that none is encoded twice.

Continuous latents are kept as float32, codes as int32; of latents that are drawn their moments, which are no costlier
to keep than latents and spare the encoder, so that every step draws anew.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import torch

from kinema.atomic import new_folder
from kinema.data.datasets import ClipDataset
from kinema.files.arrays import Wanted, map_npy, read_npy
from kinema.files.json import read_json
from kinema.files.kinds import DamagedError, refuse
from kinema.runs.console import console
from kinema.seeds import training_seed
from kinema.tokenizers import MotionTokenizer
from kinema.tokenizers.posterior import PosteriorTokenizer, draw
from kinema.types import Latents, MotionBatch

BATCH = 64
"""Crops that are encoded at once."""

META = {"dim": int, "discrete": bool, "drawn": bool | None}
FIX = "the latents are made again"


class LatentCache:
    """Look the latents of a batch up by its crops; memory-mapped, shared by all workers and ranks.

    MARDM §12.8: crops cannot be cut from one encoding of the clip, since the encoder sees the clip's ends.
    """

    def __init__(self, folder: Path) -> None:
        meta = read_json(folder / "meta.json", META, fix=FIX)
        self.dim, self.discrete, self.drawn = meta["dim"], meta["discrete"], bool(meta.get("drawn"))
        kind = np.dtype(np.int32 if self.discrete else np.float32)
        self.values = map_npy(folder / "values.npy", Wanted(kind, (None, self.dim)), fix=FIX)
        keys = read_npy(folder / "keys.npy", Wanted(np.dtype(np.int64), (None, 3)), fix=FIX)
        self.offsets = read_npy(folder / "offsets.npy", Wanted(np.dtype(np.int64), (len(keys) + 1,)), fix=FIX)
        if self.offsets[0] != 0 or self.offsets[-1] != len(self.values) or (np.diff(self.offsets) < 0).any():
            raise refuse(folder / "offsets.npy", f"does not divide the {len(self.values)} latents", FIX)
        self.rows = {tuple(key): i for i, key in enumerate(keys.tolist())}

    def __call__(
        self, batch: MotionBatch, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Latents:
        """Gather the latents of a batch of crops, zero beyond their lengths, or draw them from their moments."""
        rows = [self.rows[crop] for crop in batch.crops]
        counts = self.offsets[np.array(rows) + 1] - self.offsets[rows]
        values = np.zeros((len(rows), int(counts.max()), self.dim), np.int64 if self.discrete else np.float32)
        for i, row in enumerate(rows):
            piece = self.values[self.offsets[row] : self.offsets[row + 1]]
            values[i, : len(piece)] = piece
        device = batch.lengths.device
        found, lengths = torch.from_numpy(values).to(device), torch.from_numpy(counts).to(device)
        latents = Latents(lengths=lengths, frames=batch.lengths, **{"codes" if self.discrete else "values": found})
        return draw(latents, generator, shard) if self.drawn else latents

    def range(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the least and greatest value of each latent dimension; of drawn latents, of their means."""
        width = self.dim // 2 if self.drawn else self.dim
        low, high = np.full(width, np.inf, np.float32), np.full(width, -np.inf, np.float32)
        for start in range(0, len(self.values), 65536):
            block = self.values[start : start + 65536, :width]
            low, high = np.minimum(low, block.min(0)), np.maximum(high, block.max(0))
        return torch.from_numpy(low), torch.from_numpy(high)

    @classmethod
    def ensure(
        cls, folder: Path, tokenizer: MotionTokenizer, clips: list[ClipDataset], device: torch.device | str
    ) -> LatentCache:
        """Encode all crops of the data sets once, in a fixed order; the caller holds the tokenizer run's lock.

        An interrupted attempt is thrown away by the next, and so is a cache that is damaged.
        """
        if folder.exists():
            try:
                return cls(folder)
            except (DamagedError, FileNotFoundError) as error:
                console.print(f"[yellow]note[/]      {error!s}")
                shutil.rmtree(folder)  # who reads it still has the old files open
        with new_folder(folder, sole=True) as staging:
            cls._write(staging, tokenizer, clips, device)
        return cls(folder)

    @staticmethod
    @torch.no_grad()
    def _write(folder: Path, tokenizer: MotionTokenizer, clips: list[ClipDataset], device: torch.device | str) -> None:
        crops = [(int(e), s, n) for data in clips for e in data.entries for s, n in data.crops(int(e))]
        store = clips[0].store
        # Crops of one length go together: no padding, and a result that does not depend on the neighbours' lengths.
        order = sorted(range(len(crops)), key=lambda i: (crops[i][2], i))
        counts = np.array([tokenizer.space.latents_of(n) for _, _, n in crops])
        offsets = np.concatenate([[0], np.cumsum(counts)])
        tokenizer = tokenizer.to(device).eval()
        keep = tokenizer.moments if isinstance(tokenizer, PosteriorTokenizer) else tokenizer.encode
        values = None
        start = 0
        while start < len(order):
            frames = crops[order[start]][2]
            chunk = [i for i in order[start : start + BATCH] if crops[i][2] == frames]
            features = np.stack([store.frames_of(crops[i][0])[crops[i][1] : crops[i][1] + frames] for i in chunk])
            motion = MotionBatch(
                torch.from_numpy(features).to(device), torch.full((len(chunk),), frames, device=device)
            )
            latents = keep(motion)
            discrete = latents.codes is not None
            encoded = latents.content.cpu().numpy()
            if values is None:
                shape, kind = (int(offsets[-1]), encoded.shape[-1]), np.int32 if discrete else np.float32
                values = np.lib.format.open_memmap(folder / "values.npy", "w+", kind, shape)
                _claim(folder / "values.npy")
            for i, row in zip(chunk, encoded, strict=True):
                values[offsets[i] : offsets[i + 1]] = row
            start += len(chunk)
        if values is None:
            raise ValueError("there is no crop to encode; the corpus has no clip of a usable length")
        values.flush()
        np.save(folder / "keys.npy", np.array(crops, np.int64))
        np.save(folder / "offsets.npy", offsets.astype(np.int64))
        meta = {
            "dim": int(values.shape[1]),
            "discrete": values.dtype == np.int32,
            "drawn": isinstance(tokenizer, PosteriorTokenizer),
            "crops": len(crops),
        }
        (folder / "meta.json").write_text(json.dumps(meta))


def _claim(file: Path) -> None:
    """Take a mapped file's room at once: on a full disk, writing to the map would end the process without a word."""
    if sys.platform == "linux":
        with file.open("r+b") as opened:
            os.posix_fallocate(opened.fileno(), 0, os.fstat(opened.fileno()).st_size)


class EncodeEachTime:
    """Encode every batch anew: frames as they are, and latents that are drawn in some other way than from moments."""

    def __init__(
        self, tokenizer: MotionTokenizer, clips: list[ClipDataset] | None = None, device: torch.device | str = "cpu"
    ) -> None:
        self.tokenizer, self.clips, self.device = tokenizer.to(device).eval(), clips or [], device

    @torch.no_grad()
    def __call__(
        self, batch: MotionBatch, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Latents:
        """Encode the batch without gradients; what is drawn comes from `generator`, on every rank something else.

        How such a tokenizer draws is its own: of a global batch's draws nobody can give it a share.
        """
        rank, world = shard
        if generator is not None and world > 1 and not self.tokenizer.deterministic:
            seed = int(torch.randint(2**62, (), generator=generator, device=generator.device))
            generator = torch.Generator(generator.device).manual_seed(training_seed(seed, rank))
        return self.tokenizer.encode(batch.to(self.device), generator=generator)

    @torch.no_grad()
    def range(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the least and greatest value of each latent dimension over the whole clips, nothing drawn."""
        low, high = torch.tensor(torch.inf), torch.tensor(-torch.inf)
        for data in self.clips:
            for entry in data.entries:
                features = torch.from_numpy(np.array(data.store.frames_of(int(entry))))[None].to(self.device)
                lengths = torch.tensor([features.shape[1]], device=self.device)
                content = self.tokenizer.encode(MotionBatch(features, lengths)).content[0].cpu()
                low, high = torch.minimum(low, content.amin(0)), torch.maximum(high, content.amax(0))
        return low, high


def latent_source(
    folder: Path, tokenizer: MotionTokenizer, clips: list[ClipDataset], device: torch.device | str
) -> LatentCache | EncodeEachTime:
    """Choose where a tokenizer's latents come from: looked up if they or their moments are the same and no copies.

    A cache of every crop's frames would be many times the corpus (31 GB for HumanML3D).
    """
    cacheable = tokenizer.deterministic or isinstance(tokenizer, PosteriorTokenizer)
    if tokenizer.copies or not cacheable:
        return EncodeEachTime(tokenizer, clips, device)
    return LatentCache.ensure(folder, tokenizer, clips, device)
