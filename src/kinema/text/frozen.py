"""Say what a frozen text encoder is, and do what all of them do: check texts, encode in chunks, standardise.

An encoder knows its `identity`, `dim` and `token_dim` from its files' headers; its weights are read at the first call.
It is no nn.Module, so that a model that holds one doesn't register, save, average or distribute it.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor

from kinema.types import TextFeatures, frame_mask

CHUNK = 128
_SURROGATE = re.compile("[\ud800-\udfff]")


@runtime_checkable
class FrozenTextEncoder(Protocol):
    """Turn texts into features without gradients.

    `identity` names the model and its weights, `dim` is the width of the pooled vector, `token_dim` of the token
    features. The call returns features on the encoder's device in the order of the texts, `empty` those of one empty
    text, which the call refuses as a mistake.
    """

    identity: str
    dim: int
    token_dim: int

    def __call__(self, texts: list[str]) -> TextFeatures: ...

    def empty(self) -> TextFeatures: ...


def check_texts(texts: Iterable[object]) -> list[str]:
    """Refuse what no encoder can encode; gives the texts as a list, a bare string as a list of one."""
    checked = []
    for i, text in enumerate([texts] if isinstance(texts, str) else texts):
        if not isinstance(text, str):
            raise ValueError(f"text {i} is {type(text).__name__} {text!r}; every text must be a string")
        if not text.strip():
            raise ValueError(f"text {i} is empty; give every motion a prompt such as 'a person walks forward'")
        if broken := _SURROGATE.search(text):
            raise ValueError(
                f"text {i}, {text!r}, is not valid UTF-8 at character {broken.start() + 1}; write it as UTF-8 (a "
                "terminal or file in another encoding, such as Latin-1, gives this)"
            )
        checked.append(text)
    if not checked:
        raise ValueError("no texts were given; pass at least one string")
    return checked


def tell_losses(name: str, texts: list[str], ids: Sequence[Sequence[int]], context: int, unknown: int | None) -> None:
    """Warn once of texts that an encoder cuts, or of which it doesn't know words; they are encoded all the same.

    Args:
        ids: of each whole text, its start and end included.
        context: how many of them are read.
        unknown: the id of every word outside the vocabulary (None: there is none, words are spelt in bytes).
    """
    cut = [(text, len(row)) for text, row in zip(texts, ids, strict=True) if len(row) > context]
    if cut:
        warnings.warn(
            f"{name} reads {context} tokens and cuts {_of(len(cut), len(texts))} longer: {_short(cut[0][0])} has "
            f"{cut[0][1]}; say it in fewer words",
            stacklevel=3,
        )
    counted = zip(texts, ids, strict=True) if unknown is not None else ()
    strange = [(text, row.count(unknown), len(row) - 2) for text, row in counted]
    if blind := [text for text, count, size in strange if count and count == size]:
        warnings.warn(
            f"{name} knows no word of {_of(len(blind), len(texts))}: {_short(blind[0])}; all such texts give the same "
            "motion, write English words",
            stacklevel=3,
        )
    if partly := [text for text, count, size in strange if 0 < count < size]:
        warnings.warn(
            f"{name} doesn't know words or signs in {_of(len(partly), len(texts))}, and reads the rest: "
            f"{_short(partly[0])}",
            stacklevel=3,
        )


def _of(count: int, total: int) -> str:
    return f"{count} of {total} texts"


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else f"{text[:57]}...")


def encode_in_chunks(texts: list[str], encode: Callable[[list[str]], tuple[Tensor, Tensor, Tensor]]) -> TextFeatures:
    """Encode texts of similar length together and give the features in the order of the texts.

    `encode` maps a list of texts to (pooled [n c], tokens [n l k], lengths [n]).
    """
    order = sorted(range(len(texts)), key=lambda i: len(texts[i]))
    parts = [encode([texts[i] for i in order[start : start + CHUNK]]) for start in range(0, len(texts), CHUNK)]
    longest = max(tokens.shape[1] for _, tokens, _ in parts)
    device = parts[0][0].device
    back = torch.tensor(order, device=device).argsort()
    pooled = torch.cat([pooled for pooled, _, _ in parts])[back]
    tokens = torch.cat([_pad_to(tokens, longest) for _, tokens, _ in parts])[back]
    mask = frame_mask(torch.cat([lengths for _, _, lengths in parts])[back], longest)
    return TextFeatures(texts, pooled, tokens * mask[..., None], mask)


def _pad_to(tokens: Tensor, size: int) -> Tensor:
    return torch.nn.functional.pad(tokens, (0, 0, 0, size - tokens.shape[1]))


def standardise(pooled: Tensor) -> Tensor:
    """Bring each vector to zero mean and unit variance over its dims."""
    centred = pooled - pooled.mean(-1, keepdim=True)
    return centred / centred.square().mean(-1, keepdim=True).sqrt().clamp_min(1e-12)
