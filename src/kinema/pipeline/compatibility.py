"""Check that a tokenizer and a generator fit together, before anything is trained or generated."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import nn

from kinema.generators import LatentModel
from kinema.text.frozen import FrozenTextEncoder
from kinema.tokenizers import MotionTokenizer
from kinema.types import LatentSpace

_FIX = "use the tokenizer it was made for, or the same numbers in tokenizer.model and generator.model"


def check_pair(tokenizer: MotionTokenizer, generator: LatentModel) -> None:
    """Raise one ValueError that names what of the two doesn't match: kind, width, unit, number of codes, codebook."""
    wants, makes = generator.space, tokenizer.space
    if wants is None:
        return
    who = f"{type(generator).__name__} and {type(tokenizer).__name__} don't fit"
    if (wants.kind, wants.codebook_size) != (makes.kind, makes.codebook_size):
        raise ValueError(
            f"{who}: the generator is for {_latents(wants)}, the tokenizer makes {_latents(makes)}; {_FIX}"
        )
    if wants.width is not None and wants.width != makes.width:
        raise ValueError(
            f"{who}: the generator reads {_WIDTHS[wants.kind]} of {wants.width} numbers, the tokenizer makes them of "
            f"{makes.width}; {_FIX}"
        )
    if wants.unit != makes.unit or (wants.unit is None and wants.most != makes.most):
        raise ValueError(f"{who}: the generator counts {_count(wants)}, the tokenizer makes {_count(makes)}; {_FIX}")
    if wants.quantizers > makes.quantizers:
        raise ValueError(
            f"{who}: the generator makes {wants.quantizers} codes per position, the tokenizer has "
            f"{makes.quantizers}; {_FIX}"
        )
    _check_codebook(who, tokenizer, generator)


def check_text(encoder: FrozenTextEncoder, parts: Mapping[str, nn.Module]) -> None:
    """Raise ValueError if a part reads text features of other widths."""
    for name, part in ((name, part) for name, part in parts.items() if isinstance(part, LatentModel)):
        for kind, reads, makes in (
            ("vectors", part.text_dim, encoder.dim),
            ("token features", part.token_dim, encoder.token_dim),
        ):
            if reads is not None and reads != makes:
                raise ValueError(
                    f"the {name} reads text {kind} of {reads} numbers, {encoder.identity} makes them of {makes}; name "
                    "the text encoder it was trained with"
                )


def check_representation(saved: dict[str, Any] | None, own: MotionTokenizer) -> None:
    """Raise ValueError if a generator was trained on latents of another representation than the tokenizer's."""
    ours = own.identity()
    if saved is not None and saved != ours:
        name = next(key for key in {**ours, **saved} if saved.get(key) != ours.get(key))
        raise ValueError(
            f"the generator was trained with a tokenizer whose representation has {name}={saved.get(name)!r}, this one "
            f"has {ours.get(name)!r}; use the tokenizer run it was trained on"
        )


_WIDTHS = {"continuous": "latents", "codes": "code vectors", "frames": "frames"}


def _latents(space: LatentSpace) -> str:
    if space.kind == "codes":
        return f"codes of a codebook of {space.codebook_size}"
    return "continuous latents" if space.kind == "continuous" else "frames as they are"


def _count(space: LatentSpace) -> str:
    return f"{space.most} latents a motion" if space.unit is None else f"one latent for {space.unit} frames"


def _check_codebook(who: str, tokenizer: MotionTokenizer, generator: LatentModel) -> None:
    """Compare a generator's copy of the codebook, once it has one, with the tokenizer's."""
    kept, own = generator.codebook, tokenizer.codebook
    if kept is None or own is None or kept.is_meta or not kept.any():
        return
    if not torch.allclose(kept, own.to(kept), atol=1e-5):
        raise ValueError(f"{who}: the generator has another codebook; use the tokenizer run it was trained on")
