"""Generate motion as a foreign language: MotionGPT's text-to-motion, a T5 from prompts to strings of motion tokens."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.nn import functional as F

from kinema.decoding.autoregressive import decode_left_to_right
from kinema.decoding.draws import TokenDraws
from kinema.generators import TrainingLatents
from kinema.generators.gpt.sampling import GptSampling
from kinema.generators.motiongpt.language import LanguageModel
from kinema.generators.motiongpt.words import MINILM, PAD, Words
from kinema.generators.tokens.generator import TokenGenerator
from kinema.nn.mode import inference
from kinema.nn.ranks import mean_over_ranks
from kinema.options import Classes, Count, Depth, OneOf, OpenShare, Size, checked
from kinema.registry import buildable
from kinema.tokenizers import MotionTokenizer
from kinema.types import Known, Latents, Losses, TextFeatures, frame_mask

CLASSES = ("all", "motion")
MARKERS = 3
"""Start, end and mask of a motion have ids behind the codes; mask belongs to tasks that are not trained here."""


@buildable
@dataclass(frozen=True)
class MotionGPTSampling(GptSampling):
    """Choose how tokens are sampled; published: temperature 1, the 50 likeliest tokens (transformers' defaults)."""

    top_k: Count | None = 50


@buildable
class MotionGPT(TokenGenerator):
    """Translate the prompt "Generate motion: CAPTION" to the string `<start> c1 ... cn <end>` (MotionGPT §2).

    Text-to-motion alone: the other tasks of the published instruction tuning are out of scope. The text's strings are
    read by the model's own `vocabulary` ("minilm", a local folder or hub id, of `words` words); text features are not
    used. `weights` (a flan-t5 of these sizes; None starts from random ones) are read by `load_pretrained`, which
    training calls; a saved model needs neither. `classes` are what the loss scores: words and motion tokens as
    published ("all"), or motion tokens alone ("motion": much less work for a small model).
    """

    predicts_length = True

    @checked
    def __init__(
        self,
        *,
        codebook_size: Classes,
        vocabulary: str = MINILM,
        words: Classes = 30522,
        weights: str | None = None,
        width: Size = 768,
        feedforward: Size = 2048,
        layers: Depth = 12,
        decoder_layers: Depth | None = None,
        heads: Size = 12,
        head_dim: Size = 64,
        dropout: OpenShare = 0.1,
        classes: Annotated[str, OneOf(CLASSES)] = "all",
        longest_prompt: Size = 256,
        prompt: str = "Generate motion: {}",
        max_latents: Size = 49,
        downsample: Size = 4,
        sampling: MotionGPTSampling | None = None,
    ) -> None:
        super().__init__(codebook_size=codebook_size, max_latents=max_latents, downsample=downsample)
        if "{}" not in prompt:
            raise ValueError(f"prompt {prompt!r} has no place for the caption; put {{}} into it")
        self.weights = weights
        self.prompt = prompt
        self.sampling = sampling or MotionGPTSampling()
        self.words = Words(vocabulary, words, longest_prompt)
        self.start, self.end = words + codebook_size, words + codebook_size + 1
        sizes = {
            "d_model": width,
            "d_ff": feedforward,
            "d_kv": head_dim,
            "num_heads": heads,
            "num_layers": layers,
            "num_decoder_layers": decoder_layers or layers,
        }
        self.language = LanguageModel(
            sizes, words=words, motion=codebook_size + MARKERS, dropout=dropout, all_classes=classes == "all"
        )

    def prepare(self, tokenizer: MotionTokenizer, latents: TrainingLatents) -> None:
        """Load what the model starts from."""
        self.load_pretrained()

    def load_pretrained(self) -> None:
        """Start from `weights` (from random ones if None), and read the vocabulary; call it before training."""
        _ = self.words.tokenizer
        if self.weights is not None:
            self.language.load(self.weights)

    def forward(self, text: TextFeatures, ids: Int[Tensor, "b n"]) -> Float[Tensor, "b n w"]:
        """Return the decoder's states before each of the ids: the first has seen the prompt alone."""
        memory, mask = self._encode(text)
        return self.language.decode(F.pad(ids[:, :-1], (1, 0), value=PAD), memory, mask)

    def loss(
        self,
        latents: Latents,
        text: TextFeatures,
        *,
        generator: torch.Generator | None = None,
        shard: tuple[int, int] = (0, 1),
    ) -> Losses:
        """Return the cross-entropy over all tokens of the batch's strings, start and end included.

        Nothing is drawn but dropout, which is torch's own; the mean is over the tokens of all ranks.
        """
        codes = self.codes(latents)
        ids, real = self._strings(codes, latents.lengths)
        logits = self.language.head(self(text, ids)[real])
        wanted = ids[real] - self.language.first_class
        entropy, hits = F.cross_entropy(logits, wanted, reduction="none"), (logits.argmax(-1) == wanted).float()
        return {"loss": mean_over_ranks(entropy, shard[1]), "accuracy": mean_over_ranks(hits, shard[1])}

    def sample(
        self,
        text: TextFeatures,
        frames: Int[Tensor, " b"] | None,
        *,
        seeds: Int[Tensor, " b"],
        known: Known | None = None,
        sampling: MotionGPTSampling | None = None,
        draws: TokenDraws | None = None,
    ) -> Latents:
        """Generate tokens for `frames` frames, exactly so many; None: until `<end>`, 1 to max_latents tokens.

        Where a code belongs only codes are allowed, so that every string is a motion. The codes of `known` stay in
        their places and set the lengths where `frames` is None; each token sees what lies before it only. A sample
        depends on its own seed only. `draws` replaces what the seeds draw (tests).
        """
        sampling = sampling or self.sampling
        request = self.request(text, frames, seeds, known)
        with inference(self):
            codes, lengths = decode_left_to_right(
                self._predictor(text, sampling, request.open_end),
                request.codes[..., 0],
                request.lengths,
                draws or sampling.draws(seeds),
                keep=request.keep,
                end=self.codebook_size if request.open_end else None,
            )
        base = self.latents(codes[:, : int(lengths.max())], lengths)
        return self.completed(base, text, seeds=seeds, known=known, sampling=sampling)

    def _encode(self, text: TextFeatures) -> tuple[Float[Tensor, "b l w"], Bool[Tensor, "b l"]]:
        ids, mask = self.words([self.prompt.replace("{}", x) for x in text.texts], self.language.head.weight.device)
        return self.language.encode(ids, mask), mask

    def _strings(
        self, codes: Int[Tensor, "b n"], lengths: Int[Tensor, " b"]
    ) -> tuple[Int[Tensor, "b m"], Bool[Tensor, "b m"]]:
        """Return the ids of `<start> c1 ... cn <end>`, PAD behind, and the mask of real ones (m = n + 2)."""
        ids = F.pad(codes + self.words.size, (1, 1))
        ids[:, 0] = self.start
        real = frame_mask(lengths + 2, ids.shape[1])
        return ids.scatter(1, lengths[:, None] + 1, self.end).masked_fill(~real, PAD), real

    def _predictor(
        self, text: TextFeatures, sampling: MotionGPTSampling, open_end: bool
    ) -> Callable[[int, Int[Tensor, "b n"]], Float[Tensor, "b k"]]:
        """Return the logits of a slot's codes (and the end, if open) from the tokens before it, on top of a cache."""
        memory, mask = self._encode(text)
        cache = self.language.cache() if sampling.cache else None
        begin = torch.tensor([[PAD, self.start]], device=mask.device).expand(len(mask), 2)

        def predict(step: int, codes: Int[Tensor, "b n"]) -> Float[Tensor, "b k"]:
            ids = torch.cat((begin, codes[:, :step] + self.words.size), dim=1)
            ids = ids if cache is None or step == 0 else ids[:, -1:]
            logits = self.language.head(self.language.decode(ids, memory, mask, cache)[:, -1])
            logits = logits[:, self.words.size - self.language.first_class :]
            allowed = logits[:, : self.codebook_size]
            if open_end:
                end = logits[:, self.codebook_size + 1, None]
                allowed = torch.cat((allowed, end if step else end - torch.inf), dim=1)
            return sampling.narrow(allowed)

        return predict
