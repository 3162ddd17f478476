"""Load and write MLD's published autoencoder (entry `vae` of its Lightning file; MLD §1)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.interop.checkpoint import require, transfer
from kinema.interop.mld import skip_layers, skip_transformer
from kinema.interop.representation import fit_statistics, representation_spec
from kinema.interop.torch_layers import fuse_attention, split_attention, tensors
from kinema.tokenizers.vae import VAE

LAYERS = {"skel_embedding": "input_projection", "final_layer": "output"}
TABLES = {"query_pos_encoder.pe": "encoder_positions", "query_pos_decoder.pe": "decoder_positions"}
TOKENS = {"global_motion_token": "tokens"}


def names(layers: int) -> dict[str, str]:
    """Map all published keys but the tables', attention split, to ours."""
    stacks = skip_transformer("encoder", layers) | skip_transformer("decoder", layers, cross=True)
    return tensors(LAYERS | stacks) | TOKENS


def load(
    state: Mapping[str, Tensor],
    *,
    statistics: Any = None,
    heads: int = 4,
    dropout: float = 0.1,
    joint_weight: float = 1.0,
    kl_weight: float = 1e-4,
) -> nn.Module:
    """Load a published autoencoder; the number of its latents and all sizes follow from the shapes."""
    kind = "mld-vae"
    tokens, width = require(state, "global_motion_token", kind=kind).shape
    layers = skip_layers(state, "encoder")
    spec = {
        "_target_": "kinema.tokenizers.vae.VAE",
        "representation": representation_spec(
            require(state, "skel_embedding.weight", kind=kind).shape[1], variant="raw"
        ),
        "latents": tokens // 2,
        "width": width,
        "feedforward": require(state, "encoder.middle_block.linear1.weight", kind=kind).shape[0],
        "layers": layers,
        "heads": heads,
        "dropout": dropout,
        "joint_weight": joint_weight,
        "kl_weight": kl_weight,
        "positions": len(require(state, "query_pos_encoder.pe", kind=kind)),
    }
    state = split_attention(state) | {table: state[table].squeeze(1) for table in TABLES if table in state}
    rules = [(re.escape(theirs), ours) for theirs, ours in (names(layers) | TABLES).items()]
    return fit_statistics(transfer(spec, state, rules, kind=kind), statistics)


def export(model: VAE) -> dict[str, Tensor]:
    """Return a model's weights under the published keys."""
    own, layers = model.state_dict(), 2 * len(model.encoder.inputs) + 1
    state = fuse_attention({theirs: own[ours] for theirs, ours in names(layers).items()})
    return state | {theirs: own[ours][:, None] for theirs, ours in TABLES.items()}
