"""Hold what both evaluators share: the vocabulary beside the module, its identity, duplicate captions."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from typing import Any, Protocol, Self, runtime_checkable

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from kinema.motion.representation import Representation
from kinema.types import Caption, Losses, MotionBatch


@runtime_checkable
class Vocabulary(Protocol):
    """Turn captions into what an evaluator reads; `identity` names its content."""

    @property
    def identity(self) -> str: ...


class TextMotionEvaluator(nn.Module):
    """Embed motion and captions in one space, in the order given; base of both kinds.

    The vocabulary (word vectors or token table) is attached, not registered: it is in no state_dict, checkpoint or
    DDP bucket. A short fingerprint of its identity is, so that weights trained with one are not read with another.
    """

    vocabulary_fingerprint: Float[Tensor, " 8"]

    def __init__(self, representation: Representation, behaviour: dict[str, Any]) -> None:
        super().__init__()
        self.representation = representation
        self.behaviour = behaviour
        # Float, so that averaging or broadcasting buffers leaves it as it is; zeros: not attached yet.
        self.register_buffer("vocabulary_fingerprint", torch.zeros(8))
        self.__dict__["_attached"] = None

    def attach(self, vocabulary: Vocabulary) -> Self:
        """Hold the vocabulary beside the module; returns the module."""
        self.__dict__["_attached"] = vocabulary
        return self

    @property
    def vocabulary(self) -> Any:
        """The attached vocabulary; ValueError if there is none or the weights were trained with another."""
        attached = self.__dict__["_attached"]
        if attached is None:
            raise ValueError(
                f"{type(self).__name__} has no vocabulary; call evaluator.attach(word_vectors(...)) for the T2M-style "
                "evaluator or evaluator.attach(clip_tokens(...)) for the CLIP-style one"
            )
        found = hashlib.sha256(attached.identity.encode()).digest()[:8]
        if not self.vocabulary_fingerprint.any():
            self.vocabulary_fingerprint.copy_(torch.tensor(list(found)))
        elif self.vocabulary_fingerprint.tolist() != list(found):
            raise ValueError(
                f"{type(self).__name__} was trained with another vocabulary than {attached.identity!r}; attach the one "
                "that its run names, or train it anew"
            )
        return attached

    def identity(self) -> str:
        """Name the evaluator by 12 hex digits over its weights, statistics, vocabulary and behaviour."""
        attached = self.__dict__["_attached"]
        named = [type(self).__name__, self.behaviour, None if attached is None else attached.identity]
        digest = hashlib.sha256(json.dumps(named, sort_keys=True).encode())
        for name, value in sorted(self.state_dict().items()):
            if name != "vocabulary_fingerprint":
                digest.update(name.encode())
                digest.update(value.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy())
        return digest.hexdigest()[:12]

    def loss(
        self, batch: MotionBatch, *, generator: torch.Generator | None = None, shard: tuple[int, int] = (0, 1)
    ) -> Losses:
        """Contrast the motions of a batch with their captions."""
        raise TypeError(f"{type(self).__name__} is abstract; use MatchingEvaluator or ContrastiveEvaluator")

    def embed_motion(self, batch: MotionBatch) -> Float[Tensor, "b e"]:
        """Embed motions in the order given."""
        raise TypeError(f"{type(self).__name__} is abstract; use MatchingEvaluator or ContrastiveEvaluator")

    def embed_text(self, captions: Sequence[Caption]) -> Float[Tensor, "b e"]:
        """Embed captions in the order given."""
        raise TypeError(f"{type(self).__name__} is abstract; use MatchingEvaluator or ContrastiveEvaluator")


def caption_keys(texts: Sequence[str], device: torch.device) -> Int[Tensor, " b"]:
    """Number captions so that equal words, whatever their case and punctuation, have equal numbers on every rank."""
    words = (" ".join(re.findall(r"\w+", text.lower())) for text in texts)
    keys = [int.from_bytes(hashlib.sha256(w.encode()).digest()[:7], "little") for w in words]
    return torch.tensor(keys, dtype=torch.int64, device=device)


def false_negatives(keys: Int[Tensor, " b"]) -> Bool[Tensor, "b b"]:
    """Mark the pairs off the diagonal whose captions say the same."""
    same = keys[:, None] == keys[None, :]
    return same & ~torch.eye(len(keys), dtype=torch.bool, device=keys.device)


def symmetric_cross_entropy(logits: Float[Tensor, "b b"]) -> Float[Tensor, ""]:
    """Average the cross entropies of rows and columns with the diagonal as the answer (CLIP_EVALUATOR §2)."""
    answer = torch.arange(len(logits), device=logits.device)
    cross_entropy = nn.functional.cross_entropy
    return (cross_entropy(logits, answer) + cross_entropy(logits.T, answer)) / 2
