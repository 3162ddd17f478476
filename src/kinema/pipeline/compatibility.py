"""Check that a tokenizer and a generator fit together, before anything is trained or generated."""

from __future__ import annotations

from typing import Any

import torch
from torch import nn


def check_pair(tokenizer: nn.Module, generator: nn.Module) -> None:
    """Raise one ValueError that names what of the two doesn't match: latents, codebook, codes, downsampling."""
    who = f"{_name(generator)} and {_name(tokenizer)} don't fit"
    wants, makes = getattr(generator, "codebook_size", None), getattr(tokenizer, "codebook_size", None)
    if wants != makes:
        raise ValueError(
            f"{who}: the generator is for {_latents(wants)}, the tokenizer makes {_latents(makes)}; {_FIX}"
        )
    if wants is None and getattr(generator, "latent_dim", tokenizer.latent_dim) != tokenizer.latent_dim:
        raise ValueError(
            f"{who}: the generator's latent_dim is {generator.latent_dim}, the tokenizer's "
            f"{tokenizer.latent_dim}; {_FIX}"
        )
    if generator.downsample != tokenizer.downsample:
        raise ValueError(
            f"{who}: the generator counts {generator.downsample} frames a latent, the tokenizer makes one of "
            f"{tokenizer.downsample}; {_FIX}"
        )
    if wants is not None and generator.quantizers > tokenizer.quantizers:
        raise ValueError(
            f"{who}: the generator makes {generator.quantizers} codes per position, the tokenizer has "
            f"{tokenizer.quantizers}; {_FIX}"
        )
    _check_codebook(who, tokenizer, generator)


def check_representation(saved: dict[str, Any] | None, tokenizer: nn.Module) -> None:
    """Raise ValueError if a generator was trained on latents of another representation than the tokenizer's."""
    own = tokenizer.representation.identity()
    if saved is not None and saved != own:
        different = {k: (saved.get(k), own[k]) for k in own if saved.get(k) != own[k]}
        name, (theirs, ours) = next(iter(different.items()))
        raise ValueError(
            f"the generator was trained with a tokenizer whose representation has {name}={theirs!r}, this one has "
            f"{ours!r}; use the tokenizer run it was trained on"
        )


_FIX = "use the tokenizer it was made for, or the same numbers in tokenizer.model and generator.model"


def _name(module: nn.Module) -> str:
    """Name a part by its file too: BAD's and BAMM's generators are namesakes."""
    return f"{type(module).__module__.removeprefix('kinema.')}.{type(module).__name__}"


def _latents(codebook_size: int | None) -> str:
    return "continuous latents" if codebook_size is None else f"codes of a codebook of {codebook_size}"


def _check_codebook(who: str, tokenizer: nn.Module, generator: nn.Module) -> None:
    """Compare a generator's copy of the codebook, once it has one, with the tokenizer's."""
    kept = getattr(getattr(generator, "base", generator), "codebook", None)
    if kept is None:
        return
    if kept.shape != tokenizer.codebook.shape:
        raise ValueError(
            f"{who}: the generator's codebook is {tuple(kept.shape)}, the tokenizer's "
            f"{tuple(tokenizer.codebook.shape)}; {_FIX}"
        )
    if kept.is_meta or not kept.any():
        return
    if not torch.allclose(kept, tokenizer.codebook.to(kept), atol=1e-5):
        raise ValueError(f"{who}: the generator has another codebook; use the tokenizer run it was trained on")
