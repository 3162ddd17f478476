"""Test the importers of methods on frames on weights of other sizes, written under the published names."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from kinema import cli, interop
from kinema.diffusion.ddpm import DDPM
from kinema.generators.mdm import MDM
from kinema.generators.motiondiffuse import MotionDiffuse
from kinema.generators.remodiffuse import MixtureSampling, ReMoDiffuse, RetrievalDatabase
from kinema.interop import mdm, motiondiffuse, remodiffuse
from kinema.motion.formats.arrays import load_npz
from kinema.runs.build import build
from kinema.types import TextFeatures, frame_mask

MDMS = {
    "encoder": {"text_dim": 7},
    "decoder": {"text_dim": 7, "architecture": "decoder"},
    "words": {"token_dim": 6, "architecture": "decoder"},
}


def filled(model):
    for parameter in model.parameters():
        torch.nn.init.normal_(parameter, std=0.3)
    return model.eval()


def make_mdm(frame_dim: int = 5, **options) -> MDM:
    torch.manual_seed(3)
    sizes = {"width": 12, "feedforward": 20, "layers": 3, "heads": 2, "max_frames": 20}
    return filled(MDM(frame_dim=frame_dim, process=DDPM(steps=4, prediction="x0"), **(sizes | options)))


def make_motiondiffuse(frame_dim: int = 5, **options) -> MotionDiffuse:
    torch.manual_seed(3)
    sizes = {"width": 12, "feedforward": 20, "layers": 3, "heads": 2, "max_frames": 20}
    text = {"token_dim": 6, "text_width": 8, "text_feedforward": 10, "text_layers": 2, "text_heads": 4}
    return filled(MotionDiffuse(frame_dim=frame_dim, process=DDPM(40, "linear"), **(sizes | text | options)))


def text(width: int = 7) -> TextFeatures:
    generator = torch.Generator().manual_seed(1)
    pooled, tokens = torch.randn(2, width, generator=generator), torch.randn(2, 4, 6, generator=generator)
    return TextFeatures(["", ""], pooled, tokens, frame_mask(torch.tensor([4, 2]), 4))


def assert_same(copy, model) -> None:
    frames, seeds = torch.tensor([16, 9]), torch.tensor([1, 2])
    results = [m.sample(text(), frames, seeds=seeds).values for m in (model, copy)]
    assert torch.equal(*results)
    rebuilt = build(copy.spec).eval()
    rebuilt.load_state_dict(copy.state_dict())
    assert torch.equal(rebuilt.sample(text(), frames, seeds=seeds).values, results[0])


@pytest.mark.parametrize("name", MDMS)
def test_mdm_round_trip(name):
    model = make_mdm(**MDMS[name])
    content = {"model": {}, "model_avg": mdm.export(model) | {"clip_model.ln": torch.zeros(1)}}
    options = {"heads": 2, "steps": 4, "max_frames": 20, "words": name == "words"}
    assert_same(interop.load("mdm", content, **options), model)


def test_the_paper_s_mdm_is_told_by_options():
    state = mdm.export(make_mdm(text_dim=7))
    copy = interop.load("mdm", state, steps=1000, mask_frames=False, heads=3, sampling={"guidance": 1.5})
    assert len(copy.process.schedule.betas) == 1000
    assert copy.process.prediction == "x0"
    assert not copy.mask_frames
    assert copy.denoiser.blocks[0].attention.heads == 3
    assert copy.sampling.guidance == 1.5


@pytest.mark.parametrize("attention", ["linear", "softmax"])
def test_motiondiffuse_round_trip(attention):
    model = make_motiondiffuse(attention=attention)
    content = {"encoder": {f"module.{k}": v for k, v in motiondiffuse.export(model).items()}, "ep": 3}
    copy = interop.load("motiondiffuse", content, heads=2, steps=40, attention=attention)
    assert_same(copy, model)


def make_remodiffuse(**options) -> ReMoDiffuse:
    torch.manual_seed(3)
    sizes = {"width": 12, "feedforward": 20, "layers": 3, "heads": 2, "max_frames": 20, "embedding": 10, "stride": 3}
    words = {"token_dim": 6, "retrieved_dim": 12, "text_width": 8, "text_feedforward": 10, "text_layers": 1}
    process, sampling = DDPM(40, "linear", "x0"), MixtureSampling(solver_steps=4)
    layers = {"retrieval_layers": 1, "retrieval_text_layers": 3, "neighbours": 3}
    return filled(ReMoDiffuse(frame_dim=5, process=process, sampling=sampling, **(sizes | words | layers | options)))


def make_database() -> RetrievalDatabase:
    generator, rows = torch.Generator().manual_seed(4), torch.arange(4)
    return RetrievalDatabase.holding(
        pooled=torch.randn(4, 7, generator=generator),
        tokens=[torch.randn(3, 12, generator=generator)] * 4,
        frames=torch.randn(40, 5, generator=generator),
        starts=10 * rows,
        lengths=10 - rows,
        families=rows,
        captions=torch.stack((rows, rows), dim=1),
        names=["a", "b", "c", "d"],
    )


def test_remodiffuse_round_trip():
    model, database = make_remodiffuse(), make_database()
    content = {"state_dict": {f"model.{k}": v for k, v in remodiffuse.export(model).items()}, "meta": {}}
    sampling = {"solver_steps": 4}
    copy = interop.load("remodiffuse", content, heads=2, steps=40, stride=3, neighbours=3, sampling=sampling)
    rebuilt = build(copy.spec).eval()
    rebuilt.load_state_dict(copy.state_dict())
    made = []
    for one in (model, copy, rebuilt):
        one.attach("retrieval", database)
        made.append(one.sample(text(), torch.tensor([16, 9]), seeds=torch.tensor([1, 2])).values)
    assert torch.equal(made[0], made[1])
    assert torch.equal(made[0], made[2])


def test_remodiffuse_s_file_tells_its_frames():
    content = {"state_dict": {"model.joint_embed.weight": torch.zeros(4, 263)}}
    frames = interop.load("frames", content)
    assert (frames.representation.width, frames.representation.variant) == (263, "published")


def test_texts_of_another_width_than_the_model_s_have_no_published_form():
    with pytest.raises(ValueError, match="retrieved texts of 6 numbers are projected to the model's width 12"):
        remodiffuse.export(make_remodiffuse(retrieved_dim=None))


def parameters(model: torch.nn.Module) -> int:
    return sum(p.numel() for p in model.parameters())


def test_published_sizes():
    """Compare with MDM §2 and MotionDiffuse: 17.88 M, KIT 17.87 M, 26.4 M with DistilBERT's tokens; 87.15 M.

    ReMoDiffuse §4: 46.97 M.
    """
    with torch.device("meta"):
        process = DDPM()
        sizes = [MDM(frame_dim=d, text_dim=512, process=process) for d in (263, 251)]
        words = MDM(frame_dim=263, token_dim=768, architecture="decoder", process=process)
        other = MotionDiffuse(frame_dim=263, token_dim=512, process=process)
        retrieving = ReMoDiffuse(frame_dim=263, token_dim=512, process=DDPM(1000, "linear", "x0"))
        exported = mdm.export(sizes[0]), motiondiffuse.export(other)
    assert [round(parameters(m) / 1e6, 2) for m in (*sizes, other, retrieving)] == [17.88, 17.87, 87.15, 46.97]
    assert round(parameters(words) / 1e6, 1) == 26.4
    assert exported[0]["sequence_pos_encoder.pe"].shape == (5000, 1, 512)
    assert exported[1]["sequence_embedding"].shape == (196, 512)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda s: s.pop("embed_text.bias"), "missing: denoiser.text_projection.bias"),
        (lambda s: s.pop("input_process.poseEmbedding.weight"), "not that of a 'mdm'"),
        (lambda s: s.update(extra=torch.zeros(1)), "unknown: extra"),
    ],
)
def test_keys_that_do_not_fit_are_named(damage, message):
    state = mdm.export(make_mdm(text_dim=7))
    damage(state)
    with pytest.raises(ValueError, match=message):
        interop.load("mdm", state, heads=2)


def test_a_state_without_frames_has_no_statistics():
    with pytest.raises(ValueError, match="no denoiser of frames"):
        interop.load("frames", {"model": {"a": torch.zeros(2, 2)}})


PUBLISHED = {
    "mdm": (make_mdm, mdm.export, "model_avg", {"text_dim": 48}, "raw"),
    "motiondiffuse": (make_motiondiffuse, motiondiffuse.export, "encoder", {"token_dim": 48}, "published"),
}


@pytest.mark.parametrize("kind", PUBLISHED)
def test_a_published_file_becomes_two_runs_that_generate_and_edit(tmp_path, monkeypatch, make_clip, kind):
    """One file is read twice: for its statistics' variant and width, and for its weights."""
    monkeypatch.chdir(tmp_path)
    make, export, wrapper, sizes, variant = PUBLISHED[kind]
    np.save("Mean.npy", np.zeros(263))
    np.save("Std.npy", np.full(263, 0.1))
    torch.save({wrapper: export(make(263, max_frames=196, **sizes))}, "model.pt")
    link = ["--statistics", ".", "--out", "runs/frames"]
    assert cli.main(["import", "frames", "model.pt", *link]) == 0
    options = ["--tokenizer", "runs/frames", "--text-path", str(make_clip(48, 48))]
    options += ["--set", "heads=2", "--set", "steps=30"]
    assert cli.main(["import", kind, "model.pt", "--out", "runs/generator", *options]) == 0
    run = ["--run", "runs/generator", "--seed", "3", "--device", "cpu"]
    assert cli.main(["generate", "a man walks", *run, "--frames", "41", "--out", "walk.npz"]) == 0
    walk = load_npz("walk.npz").features
    assert walk.shape == (41, 263)
    assert np.isfinite(walk).all()
    change = ["edit", "--motion", "walk.npz", "--text", "a man waves", *run, "--keep", ":20", "--out", "edited.npz"]
    assert cli.main(change) == 0
    edited = load_npz("edited.npz").features
    assert np.array_equal(edited[:20], walk[:20])
    assert not np.array_equal(edited[20:], walk[20:])
    tokenizer = interop.load("frames", "model.pt", statistics=".")
    assert tokenizer.representation.variant == variant
