"""Load and write ReMoDiffuse's published network (`*.pth` of mogen, entry `state_dict`; ReMoDiffuse)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.generators.remodiffuse import ReMoDiffuse
from kinema.interop.checkpoint import count, require, transfer
from kinema.interop.motiondiffuse import STYLE
from kinema.interop.torch_layers import ENCODER_LAYER, fuse_attention, split_attention, stack, tensors

# Published name -> ours, of layers that hold a weight and a bias.
LAYERS = {
    "text_pre_proj": "text_projection",
    "text_ln": "text_norm",
    "time_embed.0": "time.0",
    "time_embed.2": "time.2",
    "joint_embed": "input_projection",
    "out": "output",
    "database.motion_proj": "retrieval.input_projection",
}
ATTENTION = {
    "norm": "norm",
    "text_norm": "text_norm",
    "retr_norm1": "pair_norm",
    "retr_norm2": "retrieved_norm",
    "query": "query",
    "key_text": "text_key",
    "value_text": "text_value",
    "key_retr": "retrieved_key",
    "value_retr": "retrieved_value",
    "key_motion": "key",
    "value_motion": "value",
    **STYLE,
}
BLOCK = {
    **{f"ca_block.{theirs}": f"attention.{ours}" for theirs, ours in ATTENTION.items()},
    **{f"ffn.{theirs}": f"mlp.{ours}" for theirs, ours in STYLE.items()},
    "ffn.linear1": "mlp.mlp.0",
    "ffn.linear2": "mlp.mlp.3",
}
RETRIEVED_BLOCK = {
    **{f"sa_block.{name}": name for name in ("norm", "query", "key", "value")},
    "ffn.linear1": "mlp.0",
    "ffn.linear2": "mlp.2",
}
STACKS = {
    "blocks": ("temporal_decoder_blocks", BLOCK),
    "text_blocks": ("textTransEncoder.layers", ENCODER_LAYER),
    "retrieval.blocks": ("database.motion_encoder_blocks", RETRIEVED_BLOCK),
    "retrieval.text_blocks": ("database.text_encoder.layers", ENCODER_LAYER),
}
"""Our stack of layers -> the published one and the names within a layer."""
TABLES = {"sequence_embedding": "positions", "database.motion_pos_embedding": "retrieval.positions"}
PREFIX = "model."


def names(layers: Mapping[str, int]) -> dict[str, str]:
    """Map all published keys, attention split, to those of the denoiser; `layers` counts each of our stacks."""
    stacks = (stack(layer, theirs, ours, layers[ours]) for ours, (theirs, layer) in STACKS.items())
    return tensors(LAYERS | {k: v for found in stacks for k, v in found.items()}) | TABLES


def load(
    state: Mapping[str, Tensor],
    *,
    heads: int = 8,
    text_heads: int = 4,
    steps: int = 1000,
    stride: int = 4,
    neighbours: int = 2,
    length_weight: float = 0.1,
    dropout: float = 0.0,
    sampling: Mapping[str, Any] | None = None,
) -> nn.Module:
    """Load a published model; the mixture's weights, which no file holds, are HumanML3D's unless `sampling` has some.

    Its motions come from a database of its own (the retrieval stage makes it).
    """
    kind = "remodiffuse"
    state = {key.removeprefix(PREFIX): value for key, value in state.items()}
    max_frames, width = require(state, "sequence_embedding", kind=kind).shape
    text_width, token_dim = require(state, "text_pre_proj.weight", kind=kind).shape
    layers = {ours: count(state, rf"{re.escape(theirs)}\.(\d+)\.") for ours, (theirs, _) in STACKS.items()}
    process = {"steps": steps, "schedule": "linear", "prediction": "x0"}
    spec = {
        "_target_": "kinema.generators.remodiffuse.ReMoDiffuse",
        "frame_dim": require(state, "joint_embed.weight", kind=kind).shape[1],
        "token_dim": token_dim,
        "width": width,
        "feedforward": require(state, "temporal_decoder_blocks.0.ffn.linear1.weight", kind=kind).shape[0],
        "layers": layers["blocks"],
        "heads": heads,
        "embedding": require(state, "time_embed.0.weight", kind=kind).shape[0],
        "text_width": text_width,
        "text_feedforward": require(state, "textTransEncoder.layers.0.linear1.weight", kind=kind).shape[0],
        "text_layers": layers["text_blocks"],
        "text_heads": text_heads,
        "retrieval_layers": layers["retrieval.blocks"],
        "retrieval_text_layers": layers["retrieval.text_blocks"],
        "retrieved_dim": width,  # published, they enter the encoder as they are
        "stride": stride,
        "dropout": dropout,
        "neighbours": neighbours,
        "length_weight": length_weight,
        "max_frames": max_frames,
        "process": {"_target_": "kinema.diffusion.ddpm.DDPM", **process},
        "sampling": {"_target_": "kinema.generators.remodiffuse.MixtureSampling", **(sampling or {})},
    }
    rules = [(re.escape(theirs), f"denoiser.{ours}") for theirs, ours in names(layers).items()]
    return transfer(spec, split_attention(state), [*rules, (r"clip\..*", None)], kind=kind)


def export(model: ReMoDiffuse) -> dict[str, Tensor]:
    """Return a model's weights under the published keys; raises ValueError for what no published model has."""
    denoiser = model.denoiser
    if model.retrieved_dim != denoiser.width:
        raise ValueError(
            f"retrieved texts of {model.retrieved_dim} numbers are projected to the model's width {denoiser.width}, "
            "for which the published network has no layer; train with generator.model.width equal to text.dim to export"
        )
    own = denoiser.state_dict()
    layers = {ours: sum(1 for _ in denoiser.get_submodule(ours).children()) for ours in STACKS}
    return fuse_attention({theirs: own[ours] for theirs, ours in names(layers).items()})
