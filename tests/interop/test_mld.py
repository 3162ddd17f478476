"""Test the importers of MLD on weights of other sizes, written under the published names."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema import cli, interop
from kinema.diffusion.ddpm import DDPM
from kinema.generators.mld import MLD, LatentSampling
from kinema.interop import mld, mld_vae
from kinema.motion.formats.arrays import load_npz
from kinema.motion.representation import Representation
from kinema.motion.statistics import Statistics
from kinema.runs.build import build
from kinema.tokenizers.vae import VAE
from kinema.types import MotionBatch, TextFeatures

STATISTICS = Statistics(np.zeros(263), np.full(263, 0.1))
SIZES = {"feedforward": 20, "layers": 5, "heads": 2, "positions": 210}


def filled(model):
    torch.manual_seed(3)
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    return model.eval()


def make_vae(latents: int = 1, **options) -> VAE:
    representation = Representation("redundant", "humanml3d").fit(STATISTICS)
    return filled(VAE(representation, latents=latents, **(SIZES | {"width": 12} | options)))


def make_mld(latents: int = 1, text_dim: int = 7, **options) -> MLD:
    sizes = SIZES | {"latent_dim": 12, "time_dim": 10, "sampling": LatentSampling(3.0)}
    return filled(MLD(text_dim=text_dim, latents=latents, process=DDPM(40, "scaled_linear"), **(sizes | options)))


def wrapped(vae: VAE | None = None, denoiser: MLD | None = None) -> dict:
    """Lay weights out as in the published Lightning file, beside a text encoder's."""
    state = {"text_encoder.text_model.weight": torch.zeros(1)}
    if vae is not None:
        state |= {f"vae.{k}": v for k, v in mld_vae.export(vae).items()}
    if denoiser is not None:
        state |= {f"denoiser.{k}": v for k, v in mld.export(denoiser).items()}
    return {"epoch": 3, "state_dict": state}


def rebuilt(model):
    copy = build(model.spec).eval()
    copy.load_state_dict(model.state_dict())
    return copy


@pytest.mark.parametrize("latents", [1, 7])
def test_autoencoder_round_trip(latents):
    model = make_vae(latents)
    copy = interop.load("mld-vae", wrapped(vae=model), heads=2, statistics=STATISTICS)
    assert copy.space == model.space
    batch = MotionBatch(torch.randn(2, 16, 263), torch.tensor([16, 9]))
    results = [m.decode(m.encode(batch)).features for m in (model, copy, rebuilt(copy))]
    assert torch.equal(results[0], results[1])
    assert torch.equal(results[0], results[2])
    assert mld_vae.export(copy).keys() == mld_vae.export(model).keys()


@pytest.mark.parametrize("latents", [1, 5])
def test_denoiser_round_trip(latents):
    model = make_mld(latents)
    content, steps = wrapped(denoiser=model), {"steps": 40, "sampling": {"solver_steps": "leading4"}}
    copy = interop.load("mld", content, heads=2, latents=latents, **steps)
    assert copy.lacks_empty_text
    assert (copy.sampling.guidance, copy.sampling.solver) == (7.5, "ddim")
    frames, seeds = torch.tensor([16, 9]), torch.tensor([1, 2])
    text, results = TextFeatures(["", ""], torch.randn(2, 7)), []
    sampling = LatentSampling(3.0, solver="ddim", solver_steps="leading4")
    for m in (model, copy, rebuilt(copy)):
        m.take_empty_text(TextFeatures([""], torch.ones(1, 7)))
        results.append(m.sample(text, frames, seeds=seeds, sampling=sampling).values)
    assert torch.equal(results[0], results[1])
    assert torch.equal(results[0], results[2])


def test_published_sizes():
    """Compare with MLD §1-§2: 18.03 M, seven latents 18,035,207 parameters; 8,349,184 with the table of no use."""
    with torch.device("meta"):
        vaes = [VAE(Representation("redundant", "humanml3d"), latents=n) for n in (1, 7)]
        denoiser = MLD(text_dim=768, process=DDPM(1000, "scaled_linear"))
        exported = mld.export(denoiser), mld_vae.export(vaes[1])
    assert sum(p.numel() for p in vaes[0].parameters()) == 18_032_135
    assert sum(v.numel() for v in exported[1].values()) == 18_035_207
    assert sum(v.numel() for v in exported[0].values()) == 8_349_184
    assert exported[1]["global_motion_token"].shape == (14, 256)
    assert exported[0]["mem_pos.pe"].shape == exported[0]["query_pos.pe"].shape == (500, 1, 256)


@pytest.mark.parametrize(
    ("kind", "damage", "message"),
    [
        ("mld", lambda s: s.pop("emb_proj.1.bias"), "missing: denoiser.text_projection.bias"),
        ("mld", lambda s: s.pop("time_embedding.linear_1.weight"), "not that of a 'mld'"),
        ("mld", lambda s: s.update(extra=torch.zeros(1)), "unknown: extra"),
        ("mld-vae", lambda s: s.pop("global_motion_token"), "not that of a 'mld-vae'"),
        ("mld-vae", lambda s: s.pop("query_pos_decoder.pe"), "missing: decoder_positions"),
    ],
)
def test_keys_that_do_not_fit_are_named(kind, damage, message):
    state = mld.export(make_mld()) if kind == "mld" else mld_vae.export(make_vae())
    damage(state)
    with pytest.raises(ValueError, match=message):
        interop.load(kind, state, heads=2)


def test_a_published_file_becomes_two_runs_that_generate(tmp_path, monkeypatch, make_clip, capsys):
    """One file is read twice; the text encoder tells the imported generator what the empty text is."""
    monkeypatch.chdir(tmp_path)
    np.save("Mean.npy", np.zeros(263))
    np.save("Std.npy", np.full(263, 0.1))
    torch.save(wrapped(make_vae(), make_mld(text_dim=48)), "mld.ckpt")
    heads = ["--set", "heads=2"]
    assert cli.main(["import", "mld-vae", "mld.ckpt", "--statistics", ".", *heads, "--out", "runs/vae"]) == 0
    options = ["--tokenizer", "runs/vae", "--text-path", str(make_clip(48, 48)), "--set", "steps=100"]
    assert cli.main(["import", "mld", "mld.ckpt", *options, *heads, "--out", "runs/mld"]) == 0
    run = ["--run", "runs/mld", "--seed", "3", "--device", "cpu"]
    assert cli.main(["generate", "a man walks", *run, "--frames", "41", "--out", "walk.npz"]) == 0
    walk = load_npz("walk.npz").features
    assert walk.shape == (41, 263)
    assert np.isfinite(walk).all()
    change = ["edit", "--motion", "walk.npz", "--text", "a man waves", *run, "--keep", ":20", "--out", "edited.npz"]
    assert cli.main(change) != 0
    assert "needs latents in time, but here 1 latents stand for the whole of a motion" in capsys.readouterr().err
