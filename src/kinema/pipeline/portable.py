"""Hold the parts that make motion from text: read them from a run, a packed model or the hub, and write them."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Self

import torch
from torch import nn

from kinema.devices import find_device
from kinema.generators import Generator
from kinema.nn.precision import Precision
from kinema.pipeline.card import Card
from kinema.pipeline.compatibility import check_pair, check_text
from kinema.pipeline.folder import read_parts, write_parts
from kinema.pipeline.models import find_model, upload
from kinema.pipeline.repertoire import Repertoire
from kinema.runs.latest import find_run
from kinema.runs.parts import GENERATOR, LENGTH, TOKENIZER
from kinema.text.frozen import FrozenTextEncoder
from kinema.tokenizers import MotionTokenizer
from kinema.types import TextFeatures


class Portable:
    """Hold a tokenizer, a generator, a text encoder and what stands beside them.

    `parts` stand beside the generator by their names: those that it names itself (`generator.parts`, e.g. a residual
    transformer) and `length`, an estimator of lengths. `meta["text"]` = {"encoder": name, "path": ...} says how the
    text encoder is made again; `save` needs it. A packed model also has a `card` and may have a `repertoire`.
    """

    card: Card | None = None
    repertoire: Repertoire | None = None
    precision: Precision = "float32"

    def __init__(
        self,
        tokenizer: MotionTokenizer,
        generator: Generator,
        text_encoder: FrozenTextEncoder,
        parts: Mapping[str, nn.Module] | None = None,
        meta: dict[str, Any] | None = None,
    ) -> None:
        check_pair(tokenizer, generator)
        self.tokenizer = tokenizer
        self.generator = generator
        self.text_encoder = text_encoder
        self.parts = dict(parts or {})
        self.meta = dict(meta or {})
        for name, part in self.parts.items():
            if name != LENGTH:
                generator.attach(name, part)
        check_pair(tokenizer, generator)
        check_text(text_encoder, {GENERATOR: generator, **self.parts})
        if generator.lacks_empty_text:  # a published file does not hold it
            generator.take_empty_text(text_encoder.empty())

    def encode(self, texts: list[str]) -> TextFeatures:
        """Encode texts, and warn of those that are far from all that the model knows."""
        features = self.text_encoder(texts)
        if self.repertoire is not None:
            self.repertoire.tell(features)
        return features

    @classmethod
    def from_run(cls, path: str | Path, device: torch.device | str | None = None, **parts: str | Path | None) -> Self:
        """Load a generator's run folder (or one that `save` wrote) with what it was trained on.
        The run of a shortcut is its generator's with the shortcut beside it.
        `path` may be `latest:mardm_sit`, the last run of that name that finished (`kinema.runs.latest.find_run`).
        `parts` are run folders of what stands beside it (`length=`, `residual=`); without them those that
        `upstream.json` names are taken (`residual=None`: none). Raises FileNotFoundError or ValueError that name the
        part that is missing or unfit.
        """
        beside = {part: run and find_run(run) for part, run in parts.items()}
        folder = find_run(path)
        tokenizer, generator, encoder, loaded, meta = read_parts(folder, find_device(device), beside)
        model = cls(tokenizer, generator, encoder, loaded, meta)
        model.card, model.repertoire = Card.read(folder), Repertoire.read(folder)
        if (known := model.repertoire) is not None and known.directions.shape[1] != encoder.dim:
            raise ValueError(
                f"{folder} knows texts of {known.directions.shape[1]} numbers, {encoder.identity} has {encoder.dim}"
            )
        return model

    @classmethod
    def from_pretrained(
        cls,
        name_or_path: str | Path,
        device: torch.device | str | None = None,
        *,
        revision: str | None = None,
        **parts: str | Path | None,
    ) -> Self:
        """Load a model of this package by its name, a folder, or `OWNER/NAME` from the Hugging Face hub or its cache.

        `revision` is a branch, tag or commit of the hub's; `parts` as of `from_run`, which loads what was found:
        nothing in a file is executed, and nothing outside of the folder is read.
        """
        return cls.from_run(find_model(name_or_path, revision), device, **parts)

    def save(self, path: str | Path, *, half: bool = False, replace: bool = False) -> Path:
        """Write the weights of all parts as one portable folder, whole or not at all; `from_run` loads it anywhere.

        `half`: weights in half precision, of half the size. `replace`: in place of a model that was saved there before.
        Raises ValueError for any other folder that exists.
        """
        path = Path(path)
        if self.precision != "float32":
            raise ValueError(
                f"this model's weights were cast to {self.precision}; load it again and save that one (half=True "
                "writes a file of half the size)"
            )
        if "text" not in self.meta:
            raise ValueError('meta has no "text": {"encoder": name, "path": ...}; pass it to TextToMotion to save it')
        own = {"text": self.text_encoder.identity, "representation": self.tokenizer.identity()}
        parts: dict[str, nn.Module] = {TOKENIZER: self.tokenizer, **self.parts}
        about = [one for one in (self.card, self.repertoire) if one is not None]
        write_parts(path, self.generator, parts, self.meta["text"], own, about, half=half, replace=replace)
        return path

    def push_to_hub(self, repo_id: str, *, private: bool = False, revision: str | None = None) -> str:
        """Upload the model with its card to the Hugging Face hub; gives the commit's address.

        The repository is made if it isn't there. Who may write is what `hf auth login` or HF_TOKEN says. Raises
        ValueError for a model without a card: `kinema pack RUN --out FOLDER` makes one.
        """
        if self.card is None:
            raise ValueError("this model has no card to publish it with: `kinema pack RUN --out FOLDER` makes one")
        with tempfile.TemporaryDirectory() as folder:
            saved = self.save(Path(folder) / "model", half=self.card.half)
            return upload(saved, repo_id, private=private, revision=revision)
