"""Load and write MDM's published transformers (`model*.pt`; with EMA its entry `model_avg`; MDM §2)."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor, nn

from kinema.generators.mdm import MDM
from kinema.interop.checkpoint import count, require, transfer
from kinema.interop.torch_layers import DECODER_LAYER, ENCODER_LAYER, fuse_attention, split_attention, stack, tensors
from kinema.nn.embeddings import sinusoidal_positions

POSITIONS = 5000
TABLES = ("sequence_pos_encoder.pe", "embed_timestep.sequence_pos_encoder.pe")
STACKS = {"encoder": ("seqTransEncoder.layers", ENCODER_LAYER), "decoder": ("seqTransDecoder.layers", DECODER_LAYER)}

# Published name -> ours, of layers that hold a weight and a bias.
LAYERS = {
    "input_process.poseEmbedding": "input_projection",
    "embed_text": "text_projection",
    "embed_timestep.time_embed.0": "time.0",
    "embed_timestep.time_embed.2": "time.2",
    "output_process.poseFinal": "output",
}


def names(architecture: str, layers: int) -> dict[str, str]:
    """Map all published keys, attention split, to those of the denoiser."""
    theirs, layer = STACKS[architecture]
    return tensors(LAYERS | stack(layer, theirs, "blocks", layers))


def load(
    state: Mapping[str, Tensor],
    *,
    heads: int = 4,
    steps: int = 50,
    mask_frames: bool = True,
    prediction: str = "x0",
    words: bool = False,
    dropout: float = 0.1,
    condition_drop: float = 0.1,
    max_frames: int = 196,
    sampling: Mapping[str, Any] | None = None,
) -> nn.Module:
    """Load a published model; encoder or decoder and all sizes follow from the keys and shapes.

    The paper's model has steps=1000 and mask_frames=false, which no key tells. `words`: its text is that of all tokens
    (DistilBERT), not the pooled vector.
    """
    kind = "mdm"
    architecture = "decoder" if count(state, r"(seqTransDecoder)\.") else "encoder"
    stem = STACKS[architecture][0]
    width, frame_dim = require(state, "input_process.poseEmbedding.weight", kind=kind).shape
    layers = count(state, rf"{re.escape(stem)}\.(\d+)\.")
    spec = {
        "_target_": "kinema.generators.mdm.MDM",
        "frame_dim": frame_dim,
        "token_dim" if words else "text_dim": require(state, "embed_text.weight", kind=kind).shape[1],
        "width": width,
        "feedforward": require(state, f"{stem}.0.linear1.weight", kind=kind).shape[0],
        "layers": layers,
        "heads": heads,
        "dropout": dropout,
        "architecture": architecture,
        "condition_drop": condition_drop,
        "mask_frames": mask_frames,
        "max_frames": max_frames,
        "process": {"_target_": "kinema.diffusion.ddpm.DDPM", "steps": steps, "prediction": prediction},
        "sampling": {"_target_": "kinema.generators.mdm.FrameSampling", "guidance": 2.5, **(sampling or {})},
    }
    rules: list[tuple[str, str | None]] = [(re.escape(table), None) for table in TABLES]
    rules += [(re.escape(theirs), f"denoiser.{ours}") for theirs, ours in names(architecture, layers).items()]
    return transfer(spec, split_attention(state), rules, kind=kind)


def export(model: MDM) -> dict[str, Tensor]:
    """Return a model's weights under the published keys, the tables of positions included."""
    denoiser = model.denoiser
    own, layers = denoiser.state_dict(), len(denoiser.blocks)
    architecture = "encoder" if denoiser.encodes else "decoder"
    state = {theirs: own[ours] for theirs, ours in names(architecture, layers).items()}
    weight = denoiser.input_projection.weight
    table = sinusoidal_positions(POSITIONS, len(weight), weight.device)[:, None]
    return fuse_attention(state) | {name: torch.clone(table) for name in TABLES}
