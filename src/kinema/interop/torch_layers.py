"""Rename the tensors of torch's transformer layers, whose attention holds query, key and value in one matrix."""

from __future__ import annotations

import re
from collections.abc import Mapping

import torch
from torch import Tensor

FUSED = ("query", "key", "value")


def attention(theirs: str, ours: str) -> dict[str, str]:
    """Map the layers of an attention, once it is split, to those of our `Attention`."""
    parts = {part: part for part in FUSED} | {"out_proj": "proj"}
    return {f"{theirs}.{published}": f"{ours}.{own}" for published, own in parts.items()}


# Layer of torch's encoder -> of our post-norm block.
ENCODER_LAYER = {
    **attention("self_attn", "attention"),
    "linear1": "mlp.0",
    "linear2": "mlp.3",
    "norm1": "norm1",
    "norm2": "norm2",
}
# Layer of torch's decoder -> of our `DecoderBlock`.
DECODER_LAYER = {
    **attention("multihead_attn", "cross"),
    **{theirs: f"block.{ours}" for theirs, ours in ENCODER_LAYER.items()},
    "norm2": "cross_norm",
    "norm3": "block.norm2",
}


def stack(layer: Mapping[str, str], theirs: str, ours: str, layers: int) -> dict[str, str]:
    """Map a stack of layers, published as `theirs`.0, `theirs`.1, ..."""
    return {f"{theirs}.{i}.{a}": f"{ours}.{i}.{b}" for i in range(layers) for a, b in layer.items()}


def tensors(layers: Mapping[str, str]) -> dict[str, str]:
    """Map the weight and the bias of every layer."""
    return {f"{theirs}.{t}": f"{ours}.{t}" for theirs, ours in layers.items() for t in ("weight", "bias")}


def split_attention(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Split each fused `in_proj` into the projections of query, key and value."""
    split: dict[str, Tensor] = {}
    for key, value in state.items():
        stem, fused, tensor = key.rpartition(".in_proj_")
        if fused:
            split |= {f"{stem}.{part}.{tensor}": v for part, v in zip(FUSED, value.chunk(3), strict=True)}
        else:
            split[key] = value
    return split


def fuse_attention(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Undo `split_attention`."""
    fused = dict(state)
    for key in state:
        if found := re.fullmatch(r"(.*_attn)\.query\.(weight|bias)", key):
            stem, tensor = found.groups()
            parts = [fused.pop(f"{stem}.{part}.{tensor}") for part in FUSED]
            fused[f"{stem}.in_proj_{tensor}"] = torch.cat(parts)
    return fused
