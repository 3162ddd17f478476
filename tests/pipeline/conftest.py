"""Share one tiny random model: an autoencoder and a masked autoregressive generator on hashed text."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema.atomic import write_json
from kinema.motion.statistics import Statistics
from kinema.pipeline import TextToMotion
from kinema.runs import weights
from kinema.runs.build import build
from kinema.text.encoders import build_text_encoder

TOKENIZER = {
    "_target_": "kinema.tokenizers.autoencoder.AutoEncoder",
    "representation": {
        "_target_": "kinema.motion.representation.Representation",
        "kind": "essential",
        "skeleton": "humanml3d",
    },
    "width": 16,
    "latent_dim": 8,
    "dropout": 0.0,
}
GENERATOR = {
    "_target_": "kinema.generators.mar.MARDM",
    "latent_dim": 8,
    "text_dim": 64,
    "process": {"_target_": "kinema.diffusion.flow.Flow"},
    "width": 32,
    "feedforward": 64,
    "heads": 4,
    "mlp_width": 32,
    "mlp_depth": 2,
    "sampling": {
        "_target_": "kinema.generators.mar.MarSampling",
        "steps": 4,
        "guidance": 2.0,
        "solver": "euler",
        "solver_steps": 4,
    },
}
LENGTH = {"_target_": "kinema.generators.length.LengthEstimator", "text_dim": 64}


def make(spec):
    """Build a module with every weight random (untrained modulations are zero and would hide the text)."""
    torch.manual_seed(0)
    module = build(spec)
    with torch.no_grad():
        for parameter in module.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
    module.spec = spec
    return module.eval()


@pytest.fixture(scope="session")
def parts():
    tokenizer = make(TOKENIZER)
    rng = np.random.default_rng(0)
    std = np.full(67, 0.1)
    std[0] = 0.02
    tokenizer.representation.fit(Statistics(rng.normal(scale=0.1, size=67), std))
    return tokenizer, make(GENERATOR), make(LENGTH)


@pytest.fixture
def model(parts) -> TextToMotion:
    tokenizer, generator, length = parts
    return TextToMotion(
        tokenizer, generator, build_text_encoder("hashed"), {"length": length}, {"text": {"encoder": "hashed"}}
    )


@pytest.fixture
def run(parts, tmp_path):
    """Give a generator's run folder as training leaves it, beside its tokenizer's and length estimator's."""
    for name, module in zip(("tokenizer", "generator", "length"), parts, strict=True):
        folder = tmp_path / "runs" / name / "one"
        weights.save(module, module.spec, folder / "weights.safetensors", part=name)
        write_json(folder / "status.json", {"state": "done"})
    folder = tmp_path / "runs" / "generator" / "one"
    write_json(folder / "upstream.json", {"tokenizer": "../../tokenizer/one"})
    write_json(folder / "text.json", {"encoder": "hashed", "path": None})
    return folder
