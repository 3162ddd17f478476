"""`kinema import` of the discrete methods: tokenizer, generator and its other parts become runs that generate."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from kinema import cli, interop
from kinema.generators.bamm.model import BAMM
from kinema.generators.mmm import MMM
from kinema.generators.momask.model import MoMask
from kinema.interop import bamm, mmm, momask, momask_residual
from kinema.motion.formats.arrays import load_npz
from kinema.pipeline import TextToMotion
from kinema.runs import weights
from kinema.runs.build import build
from kinema.runs.consent import ask
from kinema.runs.folder import read_about

GOLDEN = {
    # name: kind, golden file, prefix of its state dict, wrapper of the published file
    "t2m-gpt-vq": ("t2m-gpt-vq", "vq_t2mgpt", "sd.", "net"),
    "attt2m-vq": ("attt2m-vq", "attt2m_vq", "sd.", "net"),
    "mmm-vq": ("mmm-vq", "mmm_transformer", "sd.trans_base.vqvae.", "net"),
    "bad-vq": ("mmm-vq", "bad_transformer", "sd.trans_base.vqvae.", "net"),
    "momask-rvq": ("momask-rvq", "rvq_momask", "sd.", "vq_model"),
    "t2m-gpt": ("t2m-gpt", "t2mgpt_transformer", "sd.", "trans"),
    "attt2m": ("attt2m", "attt2m_transformer", "sd.", "trans"),
    "mmm": ("mmm", "mmm_transformer", "sd.", "trans"),
    "bad": ("bad", "bad_transformer", "sd.", "trans"),
    "momask": ("momask", "momask_base", "sd.", "t2m_transformer"),
    "bamm": ("bamm", "bamm_transformer", "sd.", "t2m_transformer"),
    "residual": ("momask-residual", "momask_residual", "shared.sd.", "res_transformer"),
    "length": ("length-estimator", "momask_length_estimator", "sd.", "estimator"),
}
# What is imported before a generator, as the options that link it.
CHAINS = {
    "t2m-gpt": {"tokenizer": "t2m-gpt-vq"},
    "attt2m": {"tokenizer": "attt2m-vq"},
    "mmm": {"tokenizer": "mmm-vq", "length": "length"},
    "bad": {"tokenizer": "bad-vq", "length": "length"},
    "momask": {"tokenizer": "momask-rvq", "residual": "residual", "length": "length"},
    "bamm": {"tokenizer": "momask-rvq", "residual": "residual"},
}
READS_WORDS = ("attt2m", "mmm", "bad")


@pytest.fixture
def golden_import(golden_file, tmp_path, monkeypatch, make_clip):
    """Give a function that imports a golden state dict from a file as published, for texts of 48 numbers."""
    monkeypatch.chdir(tmp_path)
    np.save("Mean.npy", np.zeros(263))
    np.save("Std.npy", np.full(263, 0.1))
    clip = str(make_clip(48, 48))

    def run(name: str, *more: str) -> str:
        kind, file, prefix, wrapper = GOLDEN[name]
        tensors = load_file(golden_file(f"vq/{file}.safetensors"))
        state = {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
        torch.save({wrapper: state, "ep": 3, "best": np.float64(0.1)}, f"{name}.tar")
        part = interop.KINDS[kind].part
        options = [*more]
        if part == "tokenizer":
            options += ["--statistics", "."]
        if part in ("generator", "residual"):
            options += ["--set", "heads=4"]
        encoder = "clip_b32_77" if name in READS_WORDS else "clip_b32"
        options += ["--text", encoder, "--text-path", clip]
        assert cli.main(["import", kind, f"{name}.tar", "--out", f"runs/{part}/{name}", *options]) == 0
        return f"runs/{part}/{name}"

    return run


@pytest.mark.parametrize("name", CHAINS)
def test_published_files_become_a_run_that_generates(golden_import, name):
    links = [word for part, of in CHAINS[name].items() for word in (f"--{part}", golden_import(of))]
    run = golden_import(name, *links, *(["--set", "words=all"] if name in READS_WORDS else []))
    assert read_about(Path(run) / "upstream.json", dict) == {
        part: f"../../{part}/{of}" for part, of in CHAINS[name].items()
    }
    make = ["generate", "a man walks", "a man sits", "--run", run, "--seed", "3", "--device", "cpu"]
    assert cli.main([*make, "--frames", "41", "--out", "walk.npz"]) == 0
    walk, sit = (load_npz(f"walk-{i}.npz") for i in (1, 2))
    assert walk.features.shape == sit.features.shape == (41, 263)
    assert np.isfinite(walk.joints).all()
    assert not np.array_equal(walk.features, sit.features)
    assert cli.main([*make, "--out", "free.npz"]) == 0  # by END, or by the length estimator
    assert 4 <= len(load_npz("free-1.npz").features) <= 196
    change = ["edit", "--motion", "walk-1.npz", "--text", "a man waves", "--run", run, "--seed", "4"]
    assert cli.main([*change, "--keep", ":20", "--out", "edited.npz"]) == 0
    edited = load_npz("edited.npz").features
    assert np.array_equal(edited[:20], walk.features[:20])
    assert not np.array_equal(edited[20:], walk.features[20:])
    # Links are relative: the runs may be moved together; files of this machine are asked for anew.
    moved = Path(shutil.move("runs", "elsewhere"), "generator", name)
    with pytest.raises(ValueError, match=r"text\.json takes its text encoder from .*, which lies outside"):
        TextToMotion.from_run(moved, "cpu")
    ask(moved, "text", read_about(moved / "text.json", dict)["path"])
    again = TextToMotion.from_run(moved, "cpu").generate(["a man walks", "a man sits"], 41, seed=3)
    np.testing.assert_array_equal(again[0].features, walk.features)


def test_a_residual_transformer_completes_the_codes(golden_import):
    tokenizer, residual = golden_import("momask-rvq"), golden_import("residual")
    links = ["--tokenizer", tokenizer]
    alone = TextToMotion.from_run(golden_import("momask", *links), "cpu")
    both = TextToMotion.from_run(golden_import("bamm", *links, "--residual", residual), "cpu")
    assert (alone.generator.space.quantizers, both.generator.space.quantizers) == (1, 4)
    assert read_about(Path(residual) / "text.json", dict)["encoder"] == "clip_b32"


@pytest.mark.parametrize("name", ["t2m-gpt-vq", "attt2m-vq", "mmm-vq", "momask-rvq"])
def test_shipped_deviations_are_not_divided_again(golden_import, name):
    std = weights.load(f"{golden_import(name)}/weights.safetensors")[0].representation.std
    assert std[[0, 3, -1]].tolist() == pytest.approx([0.1 / 25] * 3)
    assert std[10] == pytest.approx(0.1)
    shutil.rmtree(f"runs/tokenizer/{name}")
    std = weights.load(f"{golden_import(name, '--set', 'variant=raw')}/weights.safetensors")[0].representation.std
    assert std.unique().tolist() == pytest.approx([0.1])


# What doesn't fit, on parts of other sizes

SIZES = {"codebook_size": 11, "code_dim": 5, "text_dim": 64, "width": 12, "feedforward": 20, "heads": 2}
POST = SIZES | {"layers": 1}
RVQ = {
    "_target_": "kinema.tokenizers.vq.VQVAE",
    "representation": {
        "_target_": "kinema.motion.representation.Representation",
        "kind": "redundant",
        "skeleton": "humanml3d",
    },
    "codebook_size": 11,
    "code_dim": 5,
    "quantizer": {
        "_target_": "kinema.tokenizers.rvq.ResidualQuantizer",
        "codebook_size": 11,
        "code_dim": 5,
        "quantizers": 3,
    },
    "width": 8,
    "depth": 1,
}
RESIDUAL = {"_target_": "kinema.generators.tokens.residual.ResidualTransformer", **POST}
LENGTH = {"_target_": "kinema.generators.length.LengthEstimator"}
RUNS = {
    "rvq": RVQ,
    "vq": {name: value for name, value in RVQ.items() if name != "quantizer"},
    "length": LENGTH | {"text_dim": 64},
    "length9": LENGTH | {"text_dim": 9},
    "residual": RESIDUAL | {"quantizers": 3},
    "residual5": RESIDUAL | {"quantizers": 5},
    "residual9": RESIDUAL | {"quantizers": 3, "codebook_size": 9},
}
IMPORT = ["import", "momask", "momask.tar", "--set", "heads=2", "--out", "runs/new"]
LINK = ["--tokenizer", "runs/rvq"]
OWN = ["--tokenizer", "runs/vq"]


@pytest.fixture
def parts(tmp_path, monkeypatch):
    """Stand in a folder with runs of tiny parts, and with published files."""
    monkeypatch.chdir(tmp_path)
    torch.manual_seed(0)
    for name, spec in RUNS.items():
        part = {"rvq": "tokenizer", "vq": "tokenizer"}.get(name, name.rstrip("0123456789"))
        weights.save(build(spec), spec, tmp_path / "runs" / name / "weights.safetensors", part=part)
    own, other = (MMM(**SIZES, token_dim=64, cross_layers=1, base_layers=1, head_layers=1) for _ in "ab")
    own.set_codebook(weights.load("runs/vq/weights.safetensors")[0].codebook)
    other.set_codebook(torch.randn(11, 5))
    files = {
        "momask.tar": {"t2m_transformer": momask.export(MoMask(**POST))},
        "small.tar": {"t2m_transformer": momask.export(MoMask(**POST | {"codebook_size": 9}))},
        "bamm.tar": {"t2m_transformer": bamm.export(BAMM(**POST))},
        "residual.tar": {"res_transformer": momask_residual.export(build(RUNS["residual"]))},
        "mmm.pth": {"trans": mmm.export(other)},
        "own.pth": {"trans": mmm.export(own)},
    }
    for name, content in files.items():
        torch.save(content, name)


def test_trained_and_imported_parts_go_together(parts):
    start = ["import", "momask-residual", "residual.tar", "--set", "heads=2"]
    assert cli.main([*start, *LINK, "--out", "runs/imported", "--text", "hashed"]) == 0
    links = [*LINK, "--residual", "runs/imported", "--length", "runs/length"]
    assert cli.main([*IMPORT, *links, "--text", "hashed"]) == 0
    assert read_about(Path("runs/new/upstream.json"), dict).keys() == {"tokenizer", "residual", "length"}
    assert read_about(Path("runs/new/text.json"), dict) == {"encoder": "hashed", "path": None}
    assert not read_about(Path("runs/rvq/text.json"), dict)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--tokenizer", "runs/none"], "no run folder at runs/none"),
        (["--tokenizer", "runs/length"], "runs/length holds a run of 'length'; give the folder of a 'tokenizer' run"),
        (["--length", "runs/rvq"], "give the folder of a 'length' run"),
        (["--residual", "runs/rvq"], "give the folder of a 'residual' run"),
        (["--residual", "runs/residual9"], "codebook_size is 11 in the base and 9 in the"),
        (["--residual", "runs/residual5"], "makes 5 codes per position, the tokenizer has 3"),
        (["--length", "runs/length9"], "text vectors of different widths (generator 64, length 9)"),
        (["--text", "clip"], "unknown text encoder 'clip'; choose --text one of clip_b32"),
        (["--text", "minilm"], "the generator reads text vectors of 64 numbers, minilm-"),
        (["--text", "minilm", "--text-path", "somewhere"], "no MiniLM model"),
        (["--set", "width=9"], "'momask' has no option 'width'"),
        (["--set", "kind=9"], "'momask' has no option 'kind'"),
    ],
)
def test_parts_that_do_not_fit_are_named_and_nothing_is_written(parts, capsys, arguments, message):
    refused(capsys, [*IMPORT, *LINK, *arguments], message)


@pytest.mark.parametrize(
    ("kind", "file", "arguments", "message"),
    [
        ("momask", "small.tar", LINK, "codes of a codebook of 9, the tokenizer makes codes of a codebook of 11"),
        # The keys and shapes of these two agree but for the number of codes.
        ("momask", "bamm.tar", LINK, "codes of a codebook of 12, the tokenizer"),
        ("bamm", "momask.tar", LINK, "codes of a codebook of 10, the tokenizer"),
        ("mmm", "mmm.pth", LINK, "the generator has another codebook"),
        ("mmm", "own.pth", [*OWN, "--set", "words=all"], "words=all reads all 77 positions, --text clip_b32 gives"),
        ("mmm", "mmm.pth", ["--residual", "runs/residual"], "mmm takes no --residual; it takes --tokenizer and --len"),
        ("momask-residual", "residual.tar", ["--length", "runs/length"], "takes no --length; it takes --tokenizer"),
        ("momask-rvq", "momask.tar", LINK, "momask-rvq takes no --tokenizer; it takes no other run"),
    ],
)
def test_files_that_do_not_fit_are_named_and_nothing_is_written(parts, capsys, kind, file, arguments, message):
    heads = [] if kind.endswith("vq") else ["--set", "heads=2"]
    refused(capsys, ["import", kind, file, "--out", "runs/new", *heads, *arguments], message)


@pytest.mark.parametrize("kind", [name for name, kind in interop.KINDS.items() if kind.part == "generator"])
def test_every_generator_needs_its_tokenizer(parts, capsys, kind):
    message = f"{kind} needs --tokenizer RUN"
    refused(capsys, ["import", kind, "momask.tar", "--out", "runs/new"], message, interop.KINDS[kind].tokenizer)


def refused(capsys, arguments: list[str], *messages: str) -> None:
    before = sorted(Path("runs").iterdir())
    assert cli.main(arguments) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    for message in messages:
        assert message in error
    assert sorted(Path("runs").iterdir()) == before


def test_kinds_are_complete():
    for name, kind in interop.KINDS.items():
        assert (kind.part == "generator") <= (kind.tokenizer is not None), name
        for part, other in (("tokenizer", kind.tokenizer), ("residual", kind.residual)):
            assert other is None or interop.KINDS[other].part == part
