"""Load and write BAMM's published transformers (entry `t2m_transformer`), post-norm and pre-norm (`t2mgpt`; BAMM)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from kinema.generators.bamm.model import BAMM
from kinema.interop.checkpoint import count, require, transfer
from kinema.interop.gpt import BLOCK
from kinema.interop.momask import (
    ENCODER,
    POSITIONS,
    encoder_names,
    encoder_spec,
    export_encoder,
)
from kinema.interop.torch_layers import split_attention
from kinema.nn.embeddings import sinusoidal_positions


def names(layers: int, *, pre: bool) -> dict[str, str]:
    """Map all published keys with tensors of the same shape to ours, attentions split."""
    if not pre:
        return encoder_names(layers)
    parts = dict(ENCODER)
    for i in range(layers):
        parts |= {f"seqTransEncoder.blocks.{i}.{part}": f"blocks.{i}.{ours}" for part, ours in BLOCK.items()}
    return {f"{theirs}.{t}": f"encoder.{ours}.{t}" for theirs, ours in parts.items() for t in ("weight", "bias")}


def load(
    state: Mapping[str, Tensor],
    *,
    heads: int = 6,
    dropout: float = 0.2,
    condition_drop: float = 0.1,
    max_latents: int = 49,
    downsample: int = 4,
    sampling: Mapping[str, Any] | None = None,
) -> nn.Module:
    """Load a published transformer; its form and sizes follow from the keys and shapes.

    The row of the never trained MASK token is left out.
    """
    kind = "bamm"
    table = require(state, "token_emb.weight", kind=kind)
    layers = count(state, r"seqTransEncoder\.blocks\.(\d+)\.")
    pre = layers > 0
    sizes = _pre_sizes(state, layers, kind) if pre else encoder_spec(state, kind)
    spec = {
        "_target_": "kinema.generators.bamm.BAMM",
        "codebook_size": len(table) - 3,
        **sizes,
        "heads": heads,
        "dropout": dropout,
        "condition_drop": condition_drop,
        "norm": "pre" if pre else "post",
        "max_latents": max_latents,
        "downsample": downsample,
        "sampling": {"_target_": "kinema.generators.bamm.BammSampling", **(sampling or {})},
    }
    rules: list[tuple[str, str | None]] = [
        (re.escape(theirs), ours) for theirs, ours in names(sizes["layers"], pre=pre).items()
    ]
    rules += [(r"token_emb\.weight", "token_embedding.weight"), (r"position_enc\.pe", None)]
    return transfer(spec, {**split_attention(state), "token_emb.weight": table[:-1]}, rules, kind=kind)


def export(model: BAMM) -> dict[str, Tensor]:
    """Return a model's weights under the published keys, the row of MASK being zeros."""
    table = model.token_embedding.weight.detach()
    state = {"token_emb.weight": torch.cat((table, torch.zeros_like(table[:1])))}
    if not model.encoder.blocks[0].pre:
        return state | export_encoder(model.encoder)
    own = model.state_dict()
    state |= {theirs: own[ours] for theirs, ours in names(len(model.encoder.blocks), pre=True).items()}
    width = model.encoder.input_projection.out_features
    return state | {"position_enc.pe": sinusoidal_positions(POSITIONS, width, table.device)[:, None]}


def _pre_sizes(state: Mapping[str, Tensor], layers: int, kind: str) -> dict[str, int]:
    width, code_dim = require(state, "input_process.poseEmbedding.weight", kind=kind).shape
    return {
        "code_dim": code_dim,
        "text_dim": require(state, "cond_emb.weight", kind=kind).shape[1],
        "width": width,
        "feedforward": require(state, "seqTransEncoder.blocks.0.mlp.0.weight", kind=kind).shape[0],
        "layers": layers,
    }
