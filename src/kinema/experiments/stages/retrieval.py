"""Build what a generator retrieves from (ReMoDiffuse §2)."""

from __future__ import annotations

import time

from omegaconf import DictConfig

from kinema.data.datasets import ClipDataset
from kinema.data.store import PackedStore
from kinema.experiments.stages.base import Stage, Summary, dims
from kinema.runs.folder import RunFolder


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
        entries = ClipDataset(store, "train").entries
        count, wanted = int(store.entries["captions"][entries].sum()), cfg.generator.model.neighbours
        if count < wanted:
            raise ValueError(
                f"corpus {store.name!r} has {count} captions in its training split, fewer than the {wanted} neighbours "
                "that are retrieved; use a larger corpus or a smaller generator.model.neighbours"
            )
        from kinema.experiments.instantiate import check_text  # here: it pays for torch

        check_text(cfg)

    def make(self, cfg: DictConfig, store: PackedStore, needs: dict[str, RunFolder], folder: RunFolder) -> Summary:
        """Encode captions and motions, and write them."""
        from kinema.experiments.database import build_database
        from kinema.experiments.instantiate import encode_captions, machine_of, read_model, text_encoder
        from kinema.runs import weights
        from kinema.runs.parts import write_text_encoder

        started, device = time.monotonic(), machine_of(cfg).device()
        (source,) = self.needs
        tokenizer = read_model(needs[source].path, source)
        text = encode_captions(text_encoder(cfg, device), store, "train")
        database = build_database(store, text, tokenizer, max_frames=self.config(cfg).max_frames)
        own = {"text": text.identity, "representation": tokenizer.identity()}
        meta = {"part": self.name, "label": folder.path.name, "corpus": store.hash, **own}
        weights.save(database, database.spec or {}, folder.weights, **meta)
        write_text_encoder(folder.path, cfg.text.name, cfg.text.path)
        return Summary(round(time.monotonic() - started, 1), device=str(device))
