"""Load and write MoMask's published residual transformer (`net_best_fid.tar`, entry `res_transformer`; MoMask §3)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from kinema.generators.tokens.residual import ResidualTransformer
from kinema.interop.checkpoint import require, transfer
from kinema.interop.momask import encoder_rules, encoder_spec, export_encoder
from kinema.interop.torch_layers import split_attention

SHARED = ("token_embed_weight_", "embed_proj_shared_weight", "output_proj_weight_")
SEPARATE = ("token_embed_weight", "output_proj_weight", "output_proj_bias")
DOUBLED = 2.0
"""Published code doubles the dot products with separate tables before it adds the bias; our tables hold the double."""


def load(
    state: Mapping[str, Tensor],
    *,
    heads: int = 6,
    dropout: float = 0.2,
    condition_drop: float = 0.2,
    max_latents: int = 49,
    downsample: int = 4,
    sampling: Mapping[str, Any] | None = None,
) -> nn.Module:
    """Load a published residual transformer, its tables shared (as released) or separate; sizes follow from shapes."""
    kind = "momask-residual"
    encoder, (tables, names) = encoder_spec(state, kind), _tables(state, kind)
    spec = {
        "_target_": "kinema.generators.tokens.residual.ResidualTransformer",
        "codebook_size": tables["tables"].shape[1] - 1,
        "quantizers": require(state, "quant_emb.weight", kind=kind).shape[1],
        "share_weights": "score_tables" not in tables,
        **encoder,
        "heads": heads,
        "dropout": dropout,
        "condition_drop": condition_drop,
        "max_latents": max_latents,
        "downsample": downsample,
        "sampling": {"_target_": "kinema.generators.tokens.residual.ResidualSampling", **(sampling or {})},
    }
    rules = [*encoder_rules(encoder["layers"]), (r"quant_emb\.(weight|bias)", r"layer_projection.\1")]
    rules += [(name, name) for name in tables]
    rest = {key: value for key, value in state.items() if key not in names}
    return transfer(spec, split_attention(rest) | tables, rules, kind=kind)


def export(model: ResidualTransformer) -> dict[str, Tensor]:
    """Return a model's weights under the published keys."""
    own = model.state_dict()
    state = {f"quant_emb.{t}": own[f"layer_projection.{t}"] for t in ("weight", "bias")}
    if model.score_tables is None:
        first, middle, last = own["tables"].split((1, model.quantizers - 2, 1))
        state |= dict(zip(SHARED, (first, middle, last), strict=True))
    else:
        bias = torch.cat((own["score_bias"], torch.zeros_like(own["score_bias"][:1])))
        state |= dict(zip(SEPARATE, (own["tables"], own["score_tables"] / DOUBLED, bias), strict=True))
    return export_encoder(model.encoder) | state


def _tables(state: Mapping[str, Tensor], kind: str) -> tuple[dict[str, Tensor], tuple[str, ...]]:
    """Return our tables and the published keys they come from; the last row of the biases is used by no layer."""
    if SHARED[0] in state:
        return {"tables": torch.cat([require(state, name, kind=kind) for name in SHARED])}, SHARED
    embedding, scores, bias = (require(state, name, kind=kind) for name in SEPARATE)
    return {"tables": embedding, "score_tables": scores * DOUBLED, "score_bias": bias[:-1]}, SEPARATE
