"""Load and write MMM's published transformer (`net_last.pth`, entry `trans`; MMM, Transformer).

The tokenizer lies in the same file: `kinema.interop.bad.tokenizer(state)` is what kind `mmm-vq` loads.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.generators.mmm import MMM, SPECIALS
from kinema.interop import token_transformer
from kinema.interop.checkpoint import require, transfer
from kinema.interop.gpt import FURTHER, latents

TABLE = "trans_base.learn_tok_emb.weight"


def load(
    state: Mapping[str, Tensor],
    *,
    heads: int = 16,
    dropout: float = 0.1,
    words: str = "real",
    pkeep: float = 0.5,
    max_latents: int | None = None,
    downsample: int = 4,
    sampling: Mapping[str, Any] | None = None,
) -> nn.Module:
    """Load a published transformer; sizes follow from the shapes.

    words="all" lets the padding of CLIP's 77 positions be seen, as published, given features of 77.
    """
    kind = "mmm"
    rows = len(require(state, TABLE, kind=kind))
    if rows != SPECIALS:
        raise ValueError(f"this file has {rows - 2} mask tokens where MMM has one: load it as 'bad'")
    spec = {
        "_target_": "kinema.generators.mmm.MMM",
        **token_transformer.sizes(state, kind),
        "heads": heads,
        "dropout": dropout,
        "words": words,
        "pkeep": pkeep,
        "max_latents": latents(state) if max_latents is None else max_latents,
        "downsample": downsample,
        "sampling": {"_target_": "kinema.generators.mmm.MmmSampling", **(sampling or {})},
    }
    return transfer(spec, state, token_transformer.rules(state), kind=kind)


def export(model: MMM) -> dict[str, Tensor]:
    """Return a model's weights under the published keys; of the tokenizer inside, the codebook alone."""
    return token_transformer.export(model.transformer, model.max_latents + FURTHER)
