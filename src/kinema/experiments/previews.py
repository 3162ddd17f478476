"""Draw what a model makes while it trains: of the same few validation clips every time."""

from __future__ import annotations

import numpy as np
import torch
from omegaconf import DictConfig

from kinema.atomic import write_json, write_text
from kinema.data.collate import collate
from kinema.data.datasets import ClipDataset, Item
from kinema.data.store import PackedStore
from kinema.evaluation.metrics.code_usage import CodeUsage
from kinema.experiments.figures.code_usage import count
from kinema.experiments.watching import Watched
from kinema.generators import Generator
from kinema.motion.recovery import recover_joints
from kinema.motion.view.html import page, save_html, viewer_fragment
from kinema.motion.view.video import save_mp4
from kinema.pipeline import TextToMotion
from kinema.tokenizers import MotionTokenizer
from kinema.training.record import Record
from kinema.types import Motion, MotionBatch


class MotionSamples:
    """Draw motions of a generator for a few validation captions."""

    def __init__(self, cfg: DictConfig, store: PackedStore, record: Record, watched: Watched) -> None:
        self.record, self.watched = record, watched
        self.seed, self.films = cfg.seed, cfg.callbacks.sample_films
        clips = ClipDataset(store, "val")
        size = min(cfg.callbacks.sample_prompts, len(clips))
        entries = [int(clips.entries[i * len(clips) // size]) for i in range(size)]
        self.texts = [store.entry_captions(entry)[0].text for entry in entries]
        self.frames = [int(store.entries["frames"][entry]) for entry in entries]
        self.pipeline: TextToMotion | None = None

    def __call__(self, model: Generator, step: int) -> dict[str, float]:
        """Write a page of players, and films; of no captions, nothing."""
        if not self.texts:
            return {}
        if self.pipeline is None:  # the model is the same object every time, only its weights are new
            self.pipeline = self.watched.pipeline(model)
        frames = [min(n, self.pipeline.max_frames) for n in self.frames]
        motions = self.pipeline.generate(self.texts, frames, seed=self.seed)
        save_html(motions, self.record.sample(step, ".html"), f"Step {step}")
        save_films(motions[: self.films], self.record, step)
        return {}


class Reconstructions:
    """Draw validation clips beside what a tokenizer makes of them; of one with codes, count those of all such clips."""

    def __init__(self, cfg: DictConfig, store: PackedStore, record: Record) -> None:
        self.store, self.record = store, record
        self.prompts, self.films = cfg.callbacks.sample_prompts, cfg.callbacks.sample_films

    @torch.no_grad()
    def __call__(self, model: MotionTokenizer, step: int) -> dict[str, float]:
        """Write a page of players, films of the reconstructions, and the counts of codes; of no clips, nothing."""
        chosen = self._chosen(model)
        if not chosen:
            return {}
        device = next(model.parameters()).device
        real = self._clips(chosen).to(device)
        made = model.decode(model.encode(real))
        captured, rebuilt = (self._motions(batch, real.clip_ids) for batch in (real, made))
        pairs = [motion for pair in zip(captured, rebuilt, strict=True) for motion in pair]
        labels = ["captured", "reconstruction"] * len(rebuilt)
        players = viewer_fragment(pairs, labels=labels, groups=[motion.text for motion in pairs])
        write_text(
            self.record.sample(step, ".html"), page(f"Step {step}", f"<main class='kinema-page'>{players}</main>")
        )
        save_films(rebuilt[: self.films], self.record, step)
        return self._codes(model, step, device)

    def _chosen(self, model: MotionTokenizer) -> list[int]:
        """Choose clips all over the split, of those that fill a latent."""
        least = model.space.whole(1)
        clips = [int(i) for i in self.store.split_clips("val") if self.store.clips["frames"][i] >= least]
        return [clips[i * len(clips) // self.prompts] for i in range(min(self.prompts, len(clips)))]

    def _clips(self, chosen: list[int]) -> MotionBatch:
        most = self.store.skeleton.max_frames - 1
        items = [Item(self.store.clip_frames(i)[:most], i, 0, self.store.clip_name(i)) for i in chosen]
        return collate(items)

    def _motions(self, batch: MotionBatch, names: list[str]) -> list[Motion]:
        skeleton = self.store.skeleton
        joints = recover_joints(batch.features.float().cpu(), skeleton).numpy()
        empty = np.zeros((0, 0), np.float32)
        return [
            Motion(joints[i, :n], empty, name, skeleton.name, skeleton.fps)
            for i, (n, name) in enumerate(zip(batch.lengths.tolist(), names, strict=True))
        ]

    def _codes(self, model: MotionTokenizer, step: int, device: torch.device) -> dict[str, float]:
        if model.space.kind != "codes":
            return {}
        usage = CodeUsage(model.space.classes, model.space.quantizers, sync_on_compute=False).to(device)
        counted = count(model, self.store, "val", usage).compute()
        layers = {f"layer_{i}": row.tolist() for i, row in enumerate(counted["histogram"], 1)}
        write_json(self.record.sample(step, ".json", "codes"), layers)
        return {f"codes/{name}": float(counted[name]) for name in ("perplexity", "used", "dead")}


def save_films(motions: list[Motion], record: Record, step: int) -> None:
    """Write motions as films, where ffmpeg is; one that isn't finite can't be filmed."""
    for number, motion in enumerate(motions if films_here() else ()):
        if np.isfinite(motion.joints).all():
            save_mp4(motion, record.sample(step, ".mp4", f"film{number}"))


def films_here() -> bool:
    """Say whether films can be written here: with matplotlib and an ffmpeg."""
    try:
        import imageio_ffmpeg
        import matplotlib  # noqa: F401

        imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        return False
    return True
