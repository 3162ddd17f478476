"""Build the T5 that MotionGPT fine-tunes, with room for motion tokens behind its words, and read its weights."""

from __future__ import annotations

from typing import Any

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.files.checkpoints import read_safetensors
from kinema.files.json import read_json
from kinema.generators.motiongpt.words import find_file
from kinema.text.files import require

FLAN = {
    "feed_forward_proj": "gated-gelu",
    "scale_decoder_outputs": False,
    "relative_attention_num_buckets": 32,
    "relative_attention_max_distance": 128,
}
"""What all flan-t5 models have in common: states that go to an output layer of their own are not scaled."""
OPTIONS = {
    "d_model": "width",
    "d_ff": "feedforward",
    "d_kv": "head_dim",
    "num_heads": "heads",
    "num_layers": "layers",
    "num_decoder_layers": "decoder_layers",
}
"""T5's names of the sizes, and the names of MotionGPT's arguments."""


class LanguageModel(nn.Module):
    """Encode words and decode motion tokens with transformers' T5 of flan-t5's kind.

    One embedding holds the `words` and behind them the `motion` tokens; the head scores both, or motion tokens alone
    (`all_classes=False`). `sizes` are T5's, by the names of `OPTIONS`.
    """

    def __init__(
        self, sizes: dict[str, int], *, words: int, motion: int, dropout: float, all_classes: bool = True
    ) -> None:
        super().__init__()
        transformers = require("transformers", "MotionGPT")
        self.sizes = sizes
        self.words = words
        # The words are embedded here, the stacks see vectors. torch's fused GELU is the "gelu" of T5's files.
        config = transformers.T5Config(
            **sizes, vocab_size=2, dropout_rate=dropout, feed_forward_proj="gated-gelu_pytorch_tanh"
        )
        t5 = transformers.T5Model(config)
        self.encoder, self.decoder = t5.encoder, t5.decoder
        for stack in (self.encoder, self.decoder):
            stack.set_input_embeddings(None)
        width = sizes["d_model"]
        self.embedding = nn.Embedding(words + motion, width)
        self.head = nn.Linear(width, words * all_classes + motion, bias=False)
        nn.init.normal_(self.head.weight, std=width**-0.5)

    @property
    def first_class(self) -> int:
        """The id that the head's first row stands for."""
        return len(self.embedding.weight) - len(self.head.weight)

    def encode(self, ids: Int[Tensor, "b l"], mask: Bool[Tensor, "b l"]) -> Float[Tensor, "b l w"]:
        """Encode words; `mask` is True at real ones."""
        return self.encoder(inputs_embeds=self.embedding(ids), attention_mask=mask).last_hidden_state

    def decode(
        self, ids: Int[Tensor, "b n"], memory: Float[Tensor, "b l w"], mask: Bool[Tensor, "b l"], cache: Any = None
    ) -> Float[Tensor, "b n w"]:
        """Return the states that predict each next token; `cache` (transformers' own) holds the tokens before `ids`."""
        return self.decoder(
            inputs_embeds=self.embedding(ids),
            encoder_hidden_states=memory,
            encoder_attention_mask=mask,
            past_key_values=cache,
            use_cache=cache is not None,
        ).last_hidden_state

    def cache(self) -> Any:
        """Make an empty cache of keys and values."""
        transformers = require("transformers", "MotionGPT")
        return transformers.EncoderDecoderCache(transformers.DynamicCache(), transformers.DynamicCache())

    def load(self, source: str) -> None:
        """Copy the weights of a flan-t5 of these sizes (local folder or hub id).

        Raises FileNotFoundError without its files, ValueError for a model of another size or kind.
        """
        self._check(source, read_json(find_file(source, "config.json", "weights")))
        file = find_file(source, "model.safetensors", "weights")
        # Files repeat the words per stack; old ones hold a bias of the cross-attention that T5 doesn't have.
        left_out = ("embed_tokens.weight", "block.0.layer.1.EncDecAttention.relative_attention_bias.weight")
        try:
            state, _ = read_safetensors(file)
            for name in ("encoder", "decoder"):
                own = {k.removeprefix(f"{name}."): v for k, v in state.items() if k.startswith(f"{name}.")}
                getattr(self, name).load_state_dict({k: v for k, v in own.items() if k not in left_out})
            fill(self.embedding.weight, state["shared.weight"], self.words)
            fill(self.head.weight, state["lm_head.weight"], self.words - self.first_class)
        except (RuntimeError, KeyError) as error:
            raise ValueError(f"the weights in {source!r} are not those of a flan-t5: {error}") from None

    def _check(self, source: str, config: dict[str, Any]) -> None:
        scaled = config.get("tie_word_embeddings", True)  # how files older than transformers 5 say it
        defaults = {**FLAN, "scale_decoder_outputs": scaled, "num_decoder_layers": config.get("num_layers")}
        found = defaults | {k: v for k, v in config.items() if v is not None}
        for name, wanted in {**self.sizes, **FLAN}.items():
            if found.get(name) != wanted:
                fix = f"set generator.model.{OPTIONS[name]}" if name in OPTIONS else "take a flan-t5"
                raise ValueError(f"{source!r} has {name}={found.get(name)!r}, this model has {wanted!r}; {fix}")


@torch.no_grad()
def fill(rows: Float[Tensor, "n w"], pretrained: Float[Tensor, "m w"], words: int) -> None:
    """Copy the words' rows and draw the others from the words' mean and deviation per dimension."""
    rows[:words] = pretrained[:words]
    mean, deviation = pretrained.mean(0).to(rows), pretrained.std(0).to(rows)
    rows[words:] = mean + deviation * torch.randn_like(rows[words:])
