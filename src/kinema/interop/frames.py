"""Make the tokenizer of a published method on frames, which has no weights: its statistics alone (MDM §1)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from torch import Tensor, nn

from kinema.interop.representation import fit_statistics, representation_spec
from kinema.runs.build import build

# First layer of a denoiser -> the statistics that it was trained with.
VARIANTS = {"input_process.poseEmbedding.weight": "raw", "joint_embed.weight": "published"}


def load(state: Mapping[str, Tensor], *, statistics: Any = None, variant: str | None = None) -> nn.Module:
    """Make the tokenizer of the denoiser in a file: MDM's frames take raw statistics, MotionDiffuse's the /25 ones."""
    state = {key.removeprefix("model."): value for key, value in state.items()}  # ReMoDiffuse's file has that prefix
    layer = next((name for name in VARIANTS if name in state), None)
    if layer is None:
        raise ValueError(f"this state dict is no denoiser of frames: it has none of {', '.join(VARIANTS)}")
    width = state[layer].shape[1]
    spec = {
        "_target_": "kinema.tokenizers.frames.Frames",
        "representation": representation_spec(width, variant=variant or VARIANTS[layer]),
    }
    module = build(spec)
    module.spec = spec
    return fit_statistics(module, statistics)
