"""Encode texts by a frozen transformer's last hidden states: MiniLM, DistilBERT, the encoder of T5 (FRONTIER §2.3)."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from kinema.files.json import read_json
from kinema.text.files import INSTALL, local_folder, quiet_loading, require, short_hash, weights_file
from kinema.text.frozen import check_texts, encode_in_chunks, tell_losses
from kinema.types import TextFeatures, frame_mask


@dataclass(frozen=True)
class Pretrained:
    """Say what transformers calls a model, and where its configuration has its width.

    `context` is how many tokens of a text are read; `repository` is where the published files lie. `kind` is the model
    type that config.json names.
    """

    label: str
    repository: str
    kind: str
    model: str
    width: str
    context: int
    tokenizer: Sequence[str] = ("tokenizer.json",)


DISTILBERT = Pretrained(
    "DistilBERT",
    "distilbert/distilbert-base-uncased",
    "distilbert",
    "DistilBertModel",
    "dim",
    512,
    ("tokenizer.json", "vocab.txt"),
)
# MoLingo reads 64 tokens (FRONTIER §5); the end of text is one of them.
PRETRAINED = {
    "distilbert": DISTILBERT,
    "t5_small": Pretrained("T5", "google-t5/t5-small", "t5", "T5EncoderModel", "d_model", 64),
    "t5_base": Pretrained("T5", "google-t5/t5-base", "t5", "T5EncoderModel", "d_model", 64),
    "t5_large": Pretrained("T5", "google-t5/t5-large", "t5", "T5EncoderModel", "d_model", 64),
}


class HiddenStateTextEncoder:
    """Encode by last hidden states, start and end tokens ([CLS], [SEP], </s>) included; pooled is their mean.

    The files are read from a folder of this machine, and nothing is ever downloaded. Runs in fp32.
    """

    options: ClassVar[dict[str, Any]] = {}
    """What else `from_pretrained` is given."""

    def __init__(self, name: str, folder: Path, kind: Pretrained, device: torch.device | str = "cpu") -> None:
        self.folder, self.kind, self.device = folder, kind, torch.device(device)
        config = read_json(folder / "config.json", {"model_type": str})
        if config["model_type"] != kind.kind:
            raise ValueError(
                f"{folder} holds a model of the type {config['model_type']!r}, text={name} reads {kind.kind!r}; put "
                f"the files of {kind.repository} there, or choose another text="
            )
        sizes = read_json(folder / "config.json", {kind.width: int, "vocab_size": int})
        self.dim = self.token_dim = sizes[kind.width]
        self.vocabulary = sizes["vocab_size"]
        self.identity = f"{name}-{short_hash(weights_file(folder))}"

    @functools.cached_property
    def tokenizer(self) -> Any:
        """Load the tokenizer and hold it to the model's vocabulary."""
        transformers = require("transformers", self.kind.label)
        tokenizer = transformers.AutoTokenizer.from_pretrained(self.folder, local_files_only=True)
        if len(tokenizer) > self.vocabulary:
            raise ValueError(
                f"the tokenizer in {self.folder} has {len(tokenizer)} entries, its model {self.vocabulary}: its files "
                f"are another model's; put {' or '.join(self.kind.tokenizer)} of {self.kind.repository} there"
            )
        return tokenizer

    @functools.cached_property
    def model(self) -> torch.nn.Module:
        """Load the encoder."""
        with quiet_loading() as transformers:
            model = getattr(transformers, self.kind.model).from_pretrained(
                self.folder, dtype=torch.float32, local_files_only=True, **self.options
            )
        return model.eval().requires_grad_(False).to(self.device)

    def __call__(self, texts: list[str]) -> TextFeatures:
        texts = check_texts(texts)
        ids = self.tokenizer(texts, verbose=False)["input_ids"]
        tell_losses(self.kind.label, texts, ids, self.kind.context, self.tokenizer.unk_token_id)
        return encode_in_chunks(texts, self._encode)

    def empty(self) -> TextFeatures:
        """Encode the empty text: start and end alone."""
        return encode_in_chunks([""], self._encode)

    def pool(self, mean: Tensor) -> Tensor:
        """Make the pooled vectors of the tokens' means."""
        return mean

    @torch.no_grad()
    def _encode(self, texts: list[str]) -> tuple[Tensor, Tensor, Tensor]:
        rows = self.tokenizer(texts, truncation=True, max_length=self.kind.context, verbose=False)["input_ids"]
        lengths = torch.tensor([len(row) for row in rows])
        ids = pad_sequence([torch.tensor(row) for row in rows], batch_first=True).to(self.device)
        lengths = lengths.to(self.device)
        mask = frame_mask(lengths, ids.shape[1])
        hidden = self.hidden(ids, mask)
        shown = mask[..., None].to(hidden.dtype)
        return self.pool((hidden * shown).sum(1) / shown.sum(1)), hidden, lengths

    def hidden(self, ids: Int[Tensor, "n l"], mask: Bool[Tensor, "n l"]) -> Float[Tensor, "n l k"]:
        """Return the last hidden states of texts, padded with anything where `mask` is False."""
        return self.model(input_ids=ids, attention_mask=mask.long()).last_hidden_state


def pretrained_encoder(
    name: str, path: str | Path | None = None, device: torch.device | str = "cpu"
) -> HiddenStateTextEncoder:
    """Make one of `PRETRAINED`, from the folder `path` or the hub's local cache; raises FileNotFoundError."""
    kind = PRETRAINED[name]
    return HiddenStateTextEncoder(name, _folder(name, kind, path), kind, device)


def _folder(name: str, kind: Pretrained, path: str | Path | None) -> Path:
    folder, lacking = local_folder(str(path or kind.repository), kind.tokenizer)
    if folder is None or lacking:
        raise FileNotFoundError(
            f"no {kind.label} model at {str(path or kind.repository)!r}"
            + (f" ({', '.join(lacking)} missing)" if folder is not None else " (no such folder)")
            + f". Nothing is downloaded: put config.json, model.safetensors (or pytorch_model.bin) and "
            f"{' or '.join(kind.tokenizer)} of {kind.repository} into a folder and pass text.path=FOLDER or set "
            f"{name.upper()}=FOLDER in the environment, or train with text=minilm ({INSTALL})"
        )
    return folder
