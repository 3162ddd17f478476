"""Load and write MotionDiffuse's published denoiser (`latest.tar`, entry `encoder`; MotionDiffuse)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.generators.motiondiffuse import MotionDiffuse
from kinema.interop.checkpoint import count, require, transfer
from kinema.interop.torch_layers import ENCODER_LAYER, fuse_attention, split_attention, stack, tensors

# Published name -> ours, of layers that hold a weight and a bias.
LAYERS = {
    "text_pre_proj": "text_projection",
    "text_ln": "text_norm",
    "text_proj.0": "sentence_projection",
    "time_embed.0": "time.0",
    "time_embed.2": "time.2",
    "joint_embed": "input_projection",
    "out": "output",
}
STYLE = {
    "proj_out.emb_layers.1": "style.modulation",
    "proj_out.norm": "style.norm",
    "proj_out.out_layers.2": "style.output",
}
ATTENTION = {**{part: part for part in ("norm", "query", "key", "value")}, **STYLE}
BLOCK = {
    **{f"sa_block.{theirs}": f"attention.{ours}" for theirs, ours in ATTENTION.items()},
    **{f"ca_block.{theirs}": f"cross.{ours}" for theirs, ours in ATTENTION.items()},
    "ca_block.text_norm": "cross.context_norm",
    **{f"ffn.{theirs}": f"mlp.{ours}" for theirs, ours in STYLE.items()},
    "ffn.linear1": "mlp.mlp.0",
    "ffn.linear2": "mlp.mlp.3",
}


def names(layers: int, text_layers: int) -> dict[str, str]:
    """Map all published keys, attention split, to those of the denoiser."""
    blocks = stack(BLOCK, "temporal_decoder_blocks", "blocks", layers)
    text = stack(ENCODER_LAYER, "textTransEncoder.layers", "text_blocks", text_layers)
    return tensors(LAYERS | blocks | text) | {"sequence_embedding": "positions"}


def load(
    state: Mapping[str, Tensor],
    *,
    heads: int = 8,
    text_heads: int = 4,
    steps: int = 1000,
    dropout: float = 0.0,
    attention: str = "linear",
    sampling: Mapping[str, Any] | None = None,
) -> nn.Module:
    """Load a published model; `attention` is "linear", or "softmax" for one that was trained with `no_eff`."""
    kind = "motiondiffuse"
    max_frames, width = require(state, "sequence_embedding", kind=kind).shape
    text_width, token_dim = require(state, "text_pre_proj.weight", kind=kind).shape
    layers = count(state, r"temporal_decoder_blocks\.(\d+)\.")
    text_layers = count(state, r"textTransEncoder\.layers\.(\d+)\.")
    process = {"steps": steps, "schedule": "linear", "prediction": "epsilon"}
    spec = {
        "_target_": "kinema.generators.motiondiffuse.MotionDiffuse",
        "frame_dim": require(state, "joint_embed.weight", kind=kind).shape[1],
        "token_dim": token_dim,
        "width": width,
        "feedforward": require(state, "temporal_decoder_blocks.0.ffn.linear1.weight", kind=kind).shape[0],
        "layers": layers,
        "heads": heads,
        "text_width": text_width,
        "text_feedforward": require(state, "textTransEncoder.layers.0.linear1.weight", kind=kind).shape[0],
        "text_layers": text_layers,
        "text_heads": text_heads,
        "dropout": dropout,
        "attention": attention,
        "max_frames": max_frames,
        "process": {"_target_": "kinema.diffusion.ddpm.DDPM", **process},
        "sampling": {"_target_": "kinema.generators.motiondiffuse.FrameSampling", **(sampling or {})},
    }
    rules = [(re.escape(theirs), f"denoiser.{ours}") for theirs, ours in names(layers, text_layers).items()]
    return transfer(spec, split_attention(state), rules, kind=kind)


def export(model: MotionDiffuse) -> dict[str, Tensor]:
    """Return a model's weights under the published keys."""
    denoiser = model.denoiser
    own, mapped = denoiser.state_dict(), names(len(denoiser.blocks), len(denoiser.text_blocks))
    return fuse_attention({theirs: own[ours] for theirs, ours in mapped.items()})
