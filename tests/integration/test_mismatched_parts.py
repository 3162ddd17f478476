"""A tokenizer that doesn't fit its generator is refused before anything trains, and before anything is generated."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from kinema.experiments.config import compose
from kinema.experiments.run import run_stage
from kinema.pipeline import TextToMotion
from kinema.pipeline.compatibility import check_pair
from kinema.types import Known, Latents


def compose_micro(overrides: list[str], *more: str):
    own = [o for o in overrides if not o.startswith("generator.model")]
    return compose([*own, *more])


def trained(cfg) -> list[Path]:
    return list(Path(cfg.paths.runs).glob("*/*"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (["generator.model.codebook_size=99"], "the generator is for codes of a codebook of 99, the tokenizer makes"),
        (
            ["+generator.model.downsample=8"],
            "one latent for 8 frames, the tokenizer makes one latent for 4 frames",
        ),
        (
            ["tokenizer.model.down_levels=1"],
            "one latent for 4 frames, the tokenizer makes one latent for 2 frames",
        ),
        (["tokenizer=ae", "generator.model.codebook_size=64"], "the tokenizer makes continuous latents"),
    ],
)
def test_a_configuration_whose_parts_do_not_fit_trains_nothing(overrides, changes, message):
    cfg = compose_micro(overrides, "method=t2m_gpt", *changes)
    with pytest.raises(ValueError, match=message):
        run_stage(cfg, "generator")
    assert not trained(cfg)


def test_a_given_tokenizer_is_held_to_the_configuration(overrides, tmp_path):
    short = ["tokenizer.train.steps=2", "generator.train.steps=2", "length.train.steps=2"]
    cfg = compose_micro(overrides, "method=t2m_gpt", "representation=essential", *short)
    tokenizer = run_stage(cfg, "tokenizer").path
    given = [*short, f"tokenizer_run={tokenizer}", f"paths.runs={tmp_path}/other"]
    cfg = compose_micro(overrides, "method=t2m_gpt", *given)
    with pytest.raises(ValueError, match="trained on essential dims of humanml3d, this configuration asks"):
        run_stage(cfg, "generator")
    assert not trained(cfg)
    cfg = compose_micro(
        overrides, "method=t2m_gpt", "representation=essential", "generator.model.codebook_size=32", *given
    )
    with pytest.raises(ValueError, match="codes of a codebook of 32"):
        run_stage(cfg, "generator")
    cfg = compose_micro(overrides, "method=t2m_gpt", *given[:3], f"tokenizer_run={tmp_path}", given[-1])
    with pytest.raises(FileNotFoundError, match="holds no weights"):
        run_stage(cfg, "generator")
    cfg = compose_micro(overrides, "method=t2m_gpt", "representation=essential", *given)
    run = run_stage(cfg, "generator").path
    assert not (tmp_path / "other" / "tokenizer").exists()
    assert len(TextToMotion.from_run(run, device="cpu").generate("a man walks", 40, seed=0)[0].features) == 40


def test_ids_out_of_range_and_foreign_codebooks(workshop_parts):
    tokenizer, generator = workshop_parts
    lengths = torch.tensor([10])
    codes = torch.zeros(1, 10, 1, dtype=torch.long)
    codes[0, 3] = generator.codebook_size
    bad = Latents(lengths, lengths * 4, codes=codes)
    text = text_features(1)
    with pytest.raises(ValueError, match=f"token id {generator.codebook_size} is out of range"):
        generator.loss(bad, text)
    with pytest.raises(ValueError, match=f"token id {generator.codebook_size} is out of range"):
        generator.sample(text, None, seeds=torch.tensor([1]), known=Known(bad, codes[..., 0] >= 0))
    with pytest.raises(ValueError, match="out of range"):
        tokenizer.decode(bad)
    generator.set_codebook(tokenizer.codebook + 1)
    with pytest.raises(ValueError, match="has another codebook"):
        check_pair(tokenizer, generator)


@pytest.fixture
def workshop_parts(overrides):
    from kinema.data.store import PackedStore
    from kinema.experiments.corpus import open_corpus
    from kinema.experiments.stages import get_stage
    from kinema.runs.build import build

    cfg = compose_micro(overrides, "method=mmm")
    torch.manual_seed(0)
    tokenizer, generator = (build(get_stage(name).spec(cfg)) for name in ("tokenizer", "generator"))
    tokenizer.representation.fit(PackedStore.open(open_corpus(cfg)).statistics)
    tokenizer.codebook.copy_(torch.randn_like(tokenizer.codebook))
    generator.set_codebook(tokenizer.codebook)
    check_pair(tokenizer, generator)
    return tokenizer.eval(), generator.eval()


def text_features(count: int):
    from kinema.text.encoders import build_text_encoder

    return build_text_encoder("hashed")(["a person walks"] * count)
