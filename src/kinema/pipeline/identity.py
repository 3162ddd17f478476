"""Name a model by what it computes with: its weights and its text encoder, wherever they lie."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict
from typing import Any

import torch
from torch import nn

from kinema.pipeline.text_to_motion import TextToMotion
from kinema.runs.parts import GENERATOR, TOKENIZER


def fingerprint(model: TextToMotion) -> str:
    """Hash tokenizer, generator, what stands beside it and the text encoder's identity to 12 digits."""
    digest = hashlib.sha256(str(model.text_encoder.identity).encode())
    parts: dict[str, nn.Module] = {TOKENIZER: model.tokenizer, GENERATOR: model.generator, **model.parts}
    for part, module in sorted(parts.items()):
        for name, value in sorted(module.state_dict().items()):
            digest.update(f"{part}.{name} {value.dtype} {tuple(value.shape)}".encode())
            digest.update(value.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()[:12]


def sampling_of(model: TextToMotion, changes: dict[str, Any]) -> dict[str, Any]:
    """Return all options that a motion is sampled with, as JSON has them."""
    options: dict[str, Any] = json.loads(json.dumps(asdict(model.changed_sampling(changes))))
    return options
