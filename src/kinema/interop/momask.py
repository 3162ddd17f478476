"""Load and write MoMask's published masked transformer (`latest.tar`, entry `t2m_transformer`; MoMask §2)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from kinema.generators.momask.model import MoMask
from kinema.generators.tokens.encoder import TokenEncoder
from kinema.interop.checkpoint import Rules, count, require, transfer
from kinema.nn.embeddings import sinusoidal_positions

POSITIONS = 5000
FUSED = ("query", "key", "value")

# Published name -> ours, of layers that hold a weight and a bias; {} is the layer's index.
ENCODER = {
    "input_process.poseEmbedding": "input_projection",
    "cond_emb": "text_projection",
    "output_process.dense": "output.0",
    "output_process.LayerNorm": "output.2",
    "output_process.poseFinal": "output.3",
}
ENCODER_BLOCK = {
    **{f"seqTransEncoder.layers.{{}}.self_attn.{part}": f"blocks.{{}}.attention.{part}" for part in FUSED},
    "seqTransEncoder.layers.{}.self_attn.out_proj": "blocks.{}.attention.proj",
    "seqTransEncoder.layers.{}.linear1": "blocks.{}.mlp.0",
    "seqTransEncoder.layers.{}.linear2": "blocks.{}.mlp.3",
    "seqTransEncoder.layers.{}.norm1": "blocks.{}.norm1",
    "seqTransEncoder.layers.{}.norm2": "blocks.{}.norm2",
}


def encoder_names(layers: int) -> dict[str, str]:
    """Map the keys of the shared encoder, its attentions split, to ours in a module that holds it as `encoder`."""
    parts = ENCODER | {
        theirs.format(i): ours.format(i) for i in range(layers) for theirs, ours in ENCODER_BLOCK.items()
    }
    return {f"{theirs}.{t}": f"encoder.{ours}.{t}" for theirs, ours in parts.items() for t in ("weight", "bias")}


def encoder_rules(layers: int) -> Rules:
    """Return the shared encoder's renaming rules, for a state after `split_attention`; its table is computed by us."""
    return [(re.escape(theirs), ours) for theirs, ours in encoder_names(layers).items()] + [(r"position_enc\.pe", None)]


def encoder_spec(state: Mapping[str, Tensor], kind: str) -> dict[str, int]:
    """Derive the shared encoder's sizes, as the constructors of its owners name them."""
    width, code_dim = require(state, "input_process.poseEmbedding.weight", kind=kind).shape
    return {
        "code_dim": code_dim,
        "text_dim": require(state, "cond_emb.weight", kind=kind).shape[1],
        "width": width,
        "feedforward": require(state, "seqTransEncoder.layers.0.linear1.weight", kind=kind).shape[0],
        "layers": count(state, r"seqTransEncoder\.layers\.(\d+)\."),
    }


def split_attention(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Split each fused `in_proj` into the projections of query, key and value."""
    split: dict[str, Tensor] = {}
    for key, value in state.items():
        attention, fused, tensor = key.rpartition(".in_proj_")
        if fused:
            split |= {f"{attention}.{part}.{tensor}": v for part, v in zip(FUSED, value.chunk(3), strict=True)}
        else:
            split[key] = value
    return split


def export_encoder(encoder: TokenEncoder) -> dict[str, Tensor]:
    """Return the shared encoder's weights under the published keys, the table of positions included."""
    own, layers = encoder.state_dict(), len(encoder.blocks)
    state = {theirs: own[ours.removeprefix("encoder.")] for theirs, ours in encoder_names(layers).items()}
    for i in range(layers):
        stem = f"seqTransEncoder.layers.{i}.self_attn"
        for tensor in ("weight", "bias"):
            state[f"{stem}.in_proj_{tensor}"] = torch.cat([state.pop(f"{stem}.{part}.{tensor}") for part in FUSED])
    weight = encoder.input_projection.weight
    return state | {"position_enc.pe": sinusoidal_positions(POSITIONS, len(weight), weight.device)[:, None]}


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
    """Load a published masked transformer; sizes follow from the shapes."""
    kind = "momask"
    encoder = encoder_spec(state, kind)
    spec = {
        "_target_": "kinema.generators.momask.MoMask",
        "codebook_size": require(state, "token_emb.weight", kind=kind).shape[0] - 2,
        **encoder,
        "heads": heads,
        "dropout": dropout,
        "condition_drop": condition_drop,
        "max_latents": max_latents,
        "downsample": downsample,
        "sampling": {"_target_": "kinema.generators.momask.MoMaskSampling", **(sampling or {})},
    }
    rules = [*encoder_rules(encoder["layers"]), (r"token_emb\.weight", "token_embedding.weight")]
    return transfer(spec, split_attention(state), rules, kind=kind)


def export(model: MoMask) -> dict[str, Tensor]:
    """Return a model's weights under the published keys."""
    return export_encoder(model.encoder) | {"token_emb.weight": model.token_embedding.weight.detach()}
