"""Encode texts with OpenAI's CLIP text tower (MARDM §6, COMMON §6)."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from kinema.text.files import INSTALL, clip_folder, quiet_loading, require, short_hash, weights_file
from kinema.text.frozen import check_texts, encode_in_chunks, tell_losses
from kinema.types import TextFeatures

REPOSITORIES = {
    "clip_b32": "openai/clip-vit-base-patch32",
    "clip_b32_77": "openai/clip-vit-base-patch32",
    "clip_l14": "openai/clip-vit-large-patch14",
}
VARIABLES = {"clip_b32": "CLIP_B32", "clip_b32_77": "CLIP_B32", "clip_l14": "CLIP_L14"}
"""The variables of the environment that name a local folder of them."""
WHOLE = ("clip_b32_77",)
"""Encoders whose token features are those of the whole context, padding and all."""
PADDING = 0
"""The id that the published tokenizer pads with; transformers' pads with the end of text."""
OPTION = f"text.path=FOLDER, or train without CLIP: text=minilm ({INSTALL})"


class ClipTextEncoder:
    """Encode with CLIP ViT-B/32 or ViT-L/14: pooled is the projected end-of-text feature, not normalised.

    Token features are the final layer norm's output before the projection; the mask covers start to end of text, in
    "clip_b32_77" all 77 positions, as MMM, BAD and AttT2M read them (COMMON §6): at padding stand features of the text
    too. Runs in the precision of the file (fp32); the published code converts the weights to fp16.
    """

    def __init__(self, name: str, path: str | Path | None = None, device: torch.device | str = "cpu") -> None:
        if name not in REPOSITORIES:
            raise ValueError(f"unknown CLIP model {name!r}; choose one of {', '.join(REPOSITORIES)}")
        transformers = require("transformers", "the CLIP text encoder")
        self.folder = clip_folder(path, REPOSITORIES[name], OPTION)
        self.device = torch.device(device)
        config = transformers.CLIPTextConfig.from_pretrained(self.folder)
        self.dim, self.token_dim = config.projection_dim, config.hidden_size
        self.context, self.vocabulary = config.max_position_embeddings, config.vocab_size
        self.whole = name in WHOLE
        self.identity = f"{name}-{short_hash(weights_file(self.folder))}"

    @functools.cached_property
    def tokenizer(self) -> Any:
        """Load the BPE tokenizer and hold it to the model's vocabulary."""
        return clip_tokenizer(self.folder, self.vocabulary)

    @functools.cached_property
    def model(self) -> torch.nn.Module:
        """Load the text tower and its projection."""
        with quiet_loading() as transformers:
            model = transformers.CLIPTextModelWithProjection.from_pretrained(self.folder, dtype=torch.float32)
        return model.eval().requires_grad_(False).to(self.device)

    def __call__(self, texts: list[str]) -> TextFeatures:
        texts = check_texts(texts)
        # The vocabulary spells in bytes whatever it has no word for.
        tell_losses("CLIP", texts, self.tokenizer(texts, verbose=False)["input_ids"], self.context, unknown=None)
        return encode_in_chunks(texts, self._encode)

    def empty(self) -> TextFeatures:
        """Encode the empty text: start and end alone."""
        return encode_in_chunks([""], self._encode)

    @torch.no_grad()
    def _encode(self, texts: list[str]) -> tuple[Tensor, Tensor, Tensor]:
        padding = "max_length" if self.whole else "longest"
        batch = self.tokenizer(texts, padding=padding, truncation=True, max_length=self.context, return_tensors="pt")
        ids, mask = (batch[k].to(self.device) for k in ("input_ids", "attention_mask"))
        if self.whole:
            ids, mask = ids.masked_fill(mask == 0, PADDING), torch.ones_like(mask)
        out = self.model(input_ids=ids, attention_mask=mask)
        return out.text_embeds, out.last_hidden_state, mask.sum(1)


def clip_tokenizer(folder: Path, vocabulary: int) -> Any:
    """Load a CLIP tokenizer whose vocabulary is the model's.

    Without its files transformers makes a tokenizer of two entries instead of failing, which would encode every
    caption alike. Raises FileNotFoundError.
    """
    transformers = require("transformers", "the CLIP tokenizer")
    tokenizer = None
    if (folder / "tokenizer.json").is_file() or (folder / "vocab.json").is_file():
        tokenizer = transformers.AutoTokenizer.from_pretrained(folder)
    found = 0 if tokenizer is None else len(tokenizer)
    if found < 3 or found != vocabulary:
        raise FileNotFoundError(
            f"the tokenizer in {folder} has {found} entries, its model {vocabulary}: its files are missing or of "
            f"another model. Put tokenizer.json (or vocab.json and merges.txt) of the same CLIP model there, or use "
            f"text=minilm ({INSTALL})"
        )
    return tokenizer
