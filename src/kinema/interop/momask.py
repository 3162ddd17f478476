"""Load and write MoMask's published masked transformer (`latest.tar`, entry `t2m_transformer`; MoMask §2)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.generators.momask.model import MoMask
from kinema.generators.tokens.encoder import TokenEncoder
from kinema.interop.checkpoint import Rules, count, require, transfer
from kinema.interop.torch_layers import ENCODER_LAYER, fuse_attention, split_attention, stack, tensors
from kinema.nn.embeddings import sinusoidal_positions

POSITIONS = 5000

# Published name -> ours, of layers that hold a weight and a bias; {} is the layer's index.
ENCODER = {
    "input_process.poseEmbedding": "input_projection",
    "cond_emb": "text_projection",
    "output_process.dense": "output.0",
    "output_process.LayerNorm": "output.2",
    "output_process.poseFinal": "output.3",
}


def encoder_names(layers: int) -> dict[str, str]:
    """Map the keys of the shared encoder, its attentions split, to ours in a module that holds it as `encoder`."""
    parts = ENCODER | stack(ENCODER_LAYER, "seqTransEncoder.layers", "blocks", layers)
    return {theirs: f"encoder.{ours}" for theirs, ours in tensors(parts).items()}


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


def export_encoder(encoder: TokenEncoder) -> dict[str, Tensor]:
    """Return the shared encoder's weights under the published keys, the table of positions included."""
    own, layers = encoder.state_dict(), len(encoder.blocks)
    state = {theirs: own[ours.removeprefix("encoder.")] for theirs, ours in encoder_names(layers).items()}
    weight = encoder.input_projection.weight
    return fuse_attention(state) | {
        "position_enc.pe": sinusoidal_positions(POSITIONS, len(weight), weight.device)[:, None]
    }


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
