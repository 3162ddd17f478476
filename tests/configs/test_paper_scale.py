"""Hold the models and recipes of scale=paper to the papers' sizes and numbers, as the specs have them."""

from __future__ import annotations

from typing import Any

import pytest
from omegaconf import DictConfig, OmegaConf
from tests.configs.composing import CORPORA, METHODS, OFFLINE, composed, size, stage_model

from kinema.experiments.config import plain
from kinema.experiments.stages import get_stage


def at_paper_scale(method: str, corpus: str) -> DictConfig:
    return composed(*OFFLINE, f"method={method}", "scale=paper", f"data={corpus}")


# Parameters at paper scale, counted from STATE_DICTS' shapes (millions there, codebooks and CLIP excluded). Published
# files count more: two tables of positions (T2M-GPT, AttT2M, MMM 2 x 51 x 1024, BAD 2 x 52 x 1024) that are no
# parameters here, and BAMM's 512 numbers of a mask token that nothing reads. MotionGPT is flan-t5-base (247,577,856)
# with 32,615 instead of 32,128 words in its two tables of 768 columns. MARDM §3, §4.
CONV = {"humanml3d": 19_436_807, "kit_ml": 19_399_931}
CONV_32 = {"humanml3d": 17_961_767, "kit_ml": 17_924_891}
VAE = 18_035_207 - 2 * 6 * 256
TEXT_END = 512 * 512 + 128 + 513 * 512 + 512 + 3 * 512 * 682 + 4 * 512 * 513
MSFLOW = 68_772_103 - (768 - 512) * 512 - TEXT_END
# The words, four more, and attention to them: its norms, queries, keys, values and output.
WORDS = 513 * 1024 + 4 * 1024 + 1024 + 2 * 64 + 3 * 1024 * 1024 + 1025 * 1024
AE_2X = {"humanml3d": 9_914_179, "kit_ml": 9_904_960}
SIZES = {
    "mardm_ddpm": ({"humanml3d": 18_834_499, "kit_ml": 18_825_280}, 19_940_864 + 270_875_648),
    "mardm_sit": ({"humanml3d": 18_834_499, "kit_ml": 18_825_280}, 19_940_864 + 270_875_648),
    "mardm_parallel": ({"humanml3d": 18_834_499, "kit_ml": 18_825_280}, 19_940_864 + 270_875_648),
    # 4 x 263 channels instead of 512: of the mask latent, both input layers and the output.
    "mardm_frames": (
        {"humanml3d": 0, "kit_ml": 0},
        19_940_864 + 270_875_648 + (4 * 263 - 512) * (1 + 1024 + 1792 + 1792 + 1),
    ),
    "t2m_gpt": (CONV, 228_415_488 - 2 * 51 * 1024),
    "attt2m": ({"humanml3d": 20_496_455, "kit_ml": 20_478_011}, 254_137_344 - 2 * 51 * 1024),
    "mmm": (CONV_32, 236_315_744 - 2 * 51 * 1024),
    "bad_cbs": (CONV_32, 238_944_896 - 2 * 52 * 1024),
    "bad_oaas": (CONV_32, 238_944_896 - 2 * 52 * 1024),
    "momask": (CONV, 12_048_768),
    "bamm": (CONV, 12_049_665 - 512),
    "motiongpt": (CONV, 247_577_856 + 2 * (32_615 - 32_128) * 768),
    # MDM §2, MotionDiffuse and ReMoDiffuse §4 say 17.88, 87.15 and 46.97 millions; frames have no tokenizer.
    "mdm": ({"humanml3d": 0, "kit_ml": 0}, 17_880_327),
    "mdm_epsilon": ({"humanml3d": 0, "kit_ml": 0}, 17_880_327),
    "mdm_1000": ({"humanml3d": 0, "kit_ml": 0}, 17_880_327),
    "motiondiffuse": ({"humanml3d": 0, "kit_ml": 0}, 87_152_135),
    "remodiffuse": ({"humanml3d": 0, "kit_ml": 0}, 46_966_791),
    # Derived from FRONTIER §3: no paper's or file's count is known.
    # 68,772,103 with DistilBERT, and with an end of the last block's text that nothing reads. FRONTIER §2.2
    "msflow_263": ({"humanml3d": 0, "kit_ml": 0}, MSFLOW),
    "msflow_67": ({"humanml3d": 0, "kit_ml": 0}, MSFLOW - (263 - 67) * (2 * 512 + 1)),
    "msflow": ({"humanml3d": 0, "kit_ml": 0}, MSFLOW - (263 - 66) * (2 * 512 + 1)),
    "latent_flow": (AE_2X, MSFLOW + (512 - 263) * (2 * 512 + 1) - (512 - 384) * 512),
    "latent_flow_few": (AE_2X, MSFLOW + (512 - 263) * (2 * 512 + 1) - (512 - 384) * 512),
    "msflow_67_few": ({"humanml3d": 0, "kit_ml": 0}, MSFLOW - (263 - 67) * (2 * 512 + 1)),
    "mardm_words": ({"humanml3d": 18_834_499, "kit_ml": 18_825_280}, 19_940_864 + 270_875_648 + WORDS),
    "acmdm": ({"humanml3d": 16_289_799, "kit_ml": 16_289_799}, 39_055_960),
    "acmdm_raw": ({"humanml3d": 0, "kit_ml": 0}, 39_055_960 - (88 - 66) * (2 * 512 + 1)),
    # 18,035,207 with seven latents; 8,349,184 with ViT-L/14 and a table of no use. MLD §1-§2
    "mld": ({"humanml3d": VAE, "kit_ml": VAE - 12 * (2 * 256 + 1)}, 8_349_184 - 500 * 256 - (768 - 512) * 256),
}


@pytest.mark.parametrize("method", METHODS)
def test_paper_models_have_the_published_sizes(method):
    tokenizers, generator = SIZES[method]
    cfg = at_paper_scale(method, "humanml3d")
    assert size(stage_model("generator", cfg=cfg)) == generator
    for corpus, tokenizer in tokenizers.items():
        assert size(stage_model("tokenizer", cfg=at_paper_scale(method, corpus))) == tokenizer
    if get_stage("residual").present(cfg):
        assert size(stage_model("residual", cfg=cfg)) == 13_364_224


def test_mardm_is_a_transformer_and_a_diffusion_mlp():
    generator = stage_model("generator", cfg=at_paper_scale("mardm_sit", "humanml3d"))
    assert 270_875_648 in {size(part) for part in generator.children()}


# The papers' numbers; a pair is (HumanML3D, KIT).
PROTOCOL = {
    "text.name": "clip_b32",
    # MARDM §8
    "scale.protocol.replications": 20,
    "scale.protocol.pool": 32,
    "scale.protocol.mm_texts": 96,
    "scale.protocol.mm_repeats": 30,
    "scale.protocol.mm_pairs": 10,
    "scale.protocol.diversity_pairs": 300,
    "scale.protocol.leftover": "drop",
    # T2M_EVALUATOR §4
    "evaluator.matching.train.batch_size": 8,
    "evaluator.decomposition.train.window": 24,
}


def under(prefix: str, **values: Any) -> dict[str, Any]:
    return {f"{prefix}.{name}": value for name, value in values.items()}


# MARDM §3, §4, §6
MARDM = {
    **under(
        "generator.train",
        batch_size=(64, 16),
        milestones=([50_000], [20_000]),
        milestones_from="start",
        gamma=0.1,
        lr=2e-4,
        betas=[0.9, 0.99],
        weight_decay=1e-5,
        warmup=2000,
        epochs=500,
        steps=None,
        ema=0.9999,
        ema_warmup=False,
        decay="milestones",
    ),
    **under("generator.model", dropout=0.2, condition_drop=0.1, batch_multiplier=4),
    **under("generator.sampling", guidance=(4.5, 2.5), steps=18, clip_latents=False),
    **under(
        "tokenizer.train",
        batch_size=(256, 512),
        gamma=(0.05, 0.1),
        lr=2e-4,
        betas=[0.9, 0.99],
        weight_decay=0.0,
        warmup=2000,
        milestones=[150_000, 250_000],
        milestones_from="warmup_end",
        epochs=50,
        window=64,
        legacy_windows=True,
        ema=None,
    ),
    **under("tokenizer.model", dropout=0.2, joint_weight=1.0, root_weight=0.0),
    "method.lengths": "real",
}

# COMMON §3, §4: the tokenizers of codes. Warm-up comes before the 300,000 steps.
NETWORK = under("tokenizer.model", width=512, depth=3, dilation_growth=3, down_levels=2, joint_weight=0.5)
NETWORK |= under("tokenizer.model", commit_weight=0.02, root_weight=0.0)
VQ = {
    "representation.kind": "redundant",
    "representation.variant": "published",
    **NETWORK,
    **under("tokenizer.model", codebook_size=512, code_dim=512, dropout=0.0, auxiliary="joints"),
    **under("tokenizer.model.quantizer", reset="always", threshold=1.0),
    **under(
        "tokenizer.train",
        batch_size=256,
        lr=2e-4,
        betas=[0.9, 0.99],
        weight_decay=0.0,
        warmup=1000,
        steps=301_000,
        epochs=None,
        milestones=[200_000],
        milestones_from="warmup_end",
        gamma=0.05,
        decay="milestones",
        ema=None,
        window=64,
        legacy_windows=False,
    ),
}
VQ_8192 = VQ | under("tokenizer.model", codebook_size=8192, code_dim=32)
VQ_8192 |= under("tokenizer.model.quantizer", reset="unused")

# COMMON §5: what the transformers of this family share.
WIDE = {
    **under("generator.model", width=1024, feedforward=4096, heads=16, dropout=0.1),
    **under(
        "generator.train",
        batch_size=128,
        steps=300_000,
        epochs=None,
        betas=[0.5, 0.9],
        weight_decay=1e-6,
        warmup=0,
        milestones=[150_000],
        milestones_from="start",
        gamma=0.05,
        decay="milestones",
        ema=None,
        select="last",
    ),
}
T2M_GPT = {
    **VQ,
    **WIDE,
    **under("generator.model", layers=18, cross_layers=0, pkeep=0.5),
    **under("generator.sampling", temperature=1.0, top_k=None, top_p=None),
    "generator.train.lr": 1e-4,
    "generator.reads_tokens": False,
    "method.lengths": "predicted",
}
ENCODER = under("tokenizer.model.encoder", node_width=32, node_hidden=512, part_width=128, feedforward=512, layers=2)
ATTT2M = {
    **T2M_GPT,
    **ENCODER,
    **under("tokenizer.model.encoder", heads=4, dropout=0.2),
    "tokenizer.model.auxiliary": "velocities",
    "generator.model.cross_layers": 2,
    "generator.reads_tokens": True,
}
MMM = {
    **VQ_8192,
    **WIDE,
    **under("generator.model", cross_layers=2, base_layers=7, head_layers=9, pkeep=0.5),
    **under("generator.sampling", steps=10, temperature=1.0),
    "generator.train.lr": 2e-4,
    "generator.reads_tokens": True,
    "method.lengths": "real",
}
BAD = {
    **VQ_8192,
    **WIDE,
    **under("generator.model", cross_layers=2, base_layers=7, head_layers=9, time_token=True, direction="ge"),
    **under("generator.model", unmasked_see_masks=False, max_replaced=0.4, low_mask_share=0.1),
    **under("generator.sampling", steps=10, temperature=None, orders="random", official_inference_mask=False),
    **under("generator.train", lr=2e-4, steps=350_000),
    "generator.reads_tokens": True,
    "method.lengths": "real",
}

# MoMask §1-§4
RVQ = {
    **VQ,
    **under("tokenizer.model.quantizer", quantizers=6, quantizer_dropout=0.2, temperature=0.5),
    "tokenizer.model.dropout": 0.2,
    **under("tokenizer.train", warmup=2000, milestones=[150_000, 250_000], epochs=50, steps=None, legacy_windows=True),
}


def narrow(stage: str, condition_drop: float, **train: Any) -> dict[str, Any]:
    """Give what the transformers of MoMask, its residual codes and BAMM share."""
    return {
        **under(f"{stage}.model", width=384, feedforward=1024, layers=8, heads=6, dropout=0.2),
        f"{stage}.model.condition_drop": condition_drop,
        **under(f"{stage}.train", lr=2e-4, betas=[0.9, 0.99], weight_decay=1e-5, warmup=2000, steps=None),
        **under(f"{stage}.train", milestones_from="start", gamma=0.1, decay="milestones", ema=None),
        **under(f"{stage}.train", **train),
    }


MOMASK_TRAIN = {"batch_size": (64, 16), "epochs": 500, "milestones": [50_000]}
MOMASK = {
    **RVQ,
    **narrow("generator", 0.1, **MOMASK_TRAIN),
    **narrow("residual", 0.2, **MOMASK_TRAIN),
    "residual.model.share_weights": True,
    **under("generator.sampling", steps=10, guidance=(4.0, 2.0), temperature=1.0, top_k=0.9),
    **under("generator.sampling", residual_guidance=5.0, residual_temperature=1.0, residual_top_k=0.9),
    "method.lengths": "real",
}
BAMM = {
    **MOMASK,
    **narrow("generator", 0.1, batch_size=(512, 64), epochs=2000, milestones=[50_000, 80_000]),
    "generator.model.norm": "post",
    **under("generator.sampling", guidance=(4.0, 2.0), second_guidance=3.0, iterations=2, residual_guidance=6.0),
    "method.lengths": "predicted",
}
for gone in ("steps", "top_k"):
    del BAMM[f"generator.sampling.{gone}"]

# MotionGPT §2: flan-t5-base
MOTIONGPT = {
    **VQ,
    **under("generator.model", width=768, feedforward=2048, layers=12, heads=12, head_dim=64, dropout=0.1),
    **under("generator.model", words=32_100, classes="all"),
    **under("generator.train", batch_size=16, lr=2e-4, betas=[0.9, 0.99], steps=300_000, decay="cosine", ema=None),
    **under("generator.sampling", temperature=1.0, top_k=50),
    "method.lengths": "predicted",
}

# MDM §2-§4
MDM = {
    "representation.kind": "redundant",
    "representation.variant": "raw",
    "tokenizer.train": None,
    **under("generator.model", width=512, feedforward=1024, layers=8, heads=4, dropout=0.1, condition_drop=0.1),
    **under("generator.model", frame_dim=(263, 251), architecture="encoder", mask_frames=True),
    **under("generator.model.process", steps=50, schedule="cosine", prediction="x0"),
    **under("generator.train", batch_size=64, lr=1e-4, betas=[0.9, 0.999], weight_decay=0.0, warmup=0),
    **under("generator.train", steps=600_000, milestones=[], decay="milestones", ema=0.9999, ema_warmup=False),
    **under("generator.sampling", guidance=2.5, solver="ancestral", solver_steps=None),
    "method.lengths": "real",
}
MDM_1000 = MDM | {
    "generator.model.mask_frames": False,
    "generator.model.process.steps": 1000,
    **under("generator.train", steps=(475_000, 400_000), ema=None),
}
# MotionDiffuse
MOTIONDIFFUSE = {
    "representation.kind": "redundant",
    "representation.variant": "published",
    "tokenizer.train": None,
    **under("generator.model", width=512, feedforward=1024, layers=8, heads=8, dropout=0.0, attention="linear"),
    **under("generator.model", text_width=256, text_feedforward=2048, text_layers=4, text_heads=4, condition_drop=0.0),
    **under("generator.model.process", steps=1000, schedule="linear"),
    **under("generator.train", batch_size=1024, epochs=50, repeats=200, lr=2e-4, weight_decay=0.0, clip=0.5, ema=None),
    **under("generator.sampling", guidance=1.0, solver="ancestral", solver_steps=None),
    "generator.reads_tokens": True,
    "method.lengths": "real",
}
# MLD §1-§2
MLD = {
    "representation.kind": "redundant",
    "representation.variant": "raw",
    **under("tokenizer.model", latents=1, width=256, feedforward=1024, layers=9, heads=4, dropout=0.1),
    **under("tokenizer.model", joint_weight=1.0, kl_weight=1e-4, log_variance=0.0),
    **under("tokenizer.train", batch_size=128, lr=1e-4, betas=[0.9, 0.999], weight_decay=1e-2, warmup=0, clip="absent"),
    **under("generator.model", latents=1, latent_dim=256, feedforward=1024, layers=9, heads=4, dropout=0.1),
    **under("generator.model", condition_drop=0.1),
    **under("generator.model.process", steps=1000, schedule="scaled_linear"),
    **under("generator.train", batch_size=64, epochs=2000, lr=1e-4, betas=[0.9, 0.999], weight_decay=1e-2, ema=None),
    **under("generator.sampling", guidance=7.5, solver="ddim", solver_steps="leading50"),
    "method.lengths": "real",
}
# ReMoDiffuse §4, §5
REMODIFFUSE = {
    "representation.kind": "redundant",
    "representation.variant": "published",
    "tokenizer.train": None,
    **under("generator.model", width=512, feedforward=1024, layers=4, heads=8, dropout=0.0, neighbours=2, stride=4),
    **under("generator.model", text_width=256, text_feedforward=2048, text_layers=2, text_heads=4, condition_drop=0.1),
    **under("generator.model", retrieval_layers=2, retrieval_text_layers=2, length_weight=0.1),
    **under("generator.model.process", steps=1000, schedule="linear", prediction="x0"),
    **under("generator.train", batch_size=1024, epochs=(40, 20), repeats=(200, 100), lr=2e-4, decay="cosine"),
    **under("generator.sampling", coarse=(6.5, 4.0), both=(0.52351, 0.78123), text=(-0.28419, 0.39284)),
    **under("generator.sampling", retrieval=(2.39872, -0.12475), solver="ddim", solver_steps="15,15,8,6,6"),
    "generator.reads_tokens": True,
    "method.lengths": "real",
}
# FRONTIER §2.5, §3
LATENT_FLOW = under("generator.model", unit=2, patch=2) | {"generator.model.process.clamp": 0.2}
LATENT_FLOW |= under("tokenizer.model", width=512, latent_dim=256, down_levels=1) | {"text.name": "minilm_words"}
SHORTCUT = {
    **under("shortcut.model", finest=8, counts=None, grid="emergence", guidance=3.0, teacher_share=1.0, substeps=2),
    "shortcut.model.solver": "euler",
    **under("shortcut.train", epochs=50, warmup=500, decay="cosine", ema=0.999),
    "shortcut.sampling.steps": 4,
}
ACMDM = {
    "representation.kind": "essential",
    **under("tokenizer.model", width=512, channels=4, depth=3, dilation_growth=3, down_levels=2, dropout=0.2),
    **under("tokenizer.model", statistics="shared_axis", scatter=True),
    **under("tokenizer.train", batch_size=256, lr=2e-4, epochs=50, window=64, steps=None, ema=None),
    **under("generator.model", width=512, layers=8, heads=8, patch=(22, 21), condition_drop=0.1, unit=4, channels=4),
    **under("generator.train", batch_size=64, lr=2e-4, betas=[0.9, 0.99], weight_decay=1e-5, warmup=2000, epochs=500),
    **under("generator.train", milestones=[50_000], gamma=0.1, ema=0.9999, ema_warmup=False, clip="absent"),
    **under("generator.sampling", guidance=3.0),
    "generator.reads_tokens": False,
    "method.lengths": "real",
}
# FRONTIER §2.2, §2.4-§2.5
MSFLOW_RECIPE = {
    **{k: v for k, v in MARDM.items() if k.startswith("generator.train.")},
    **under(
        "generator.model",
        width=512,
        feedforward=1024,
        layers=8,
        heads=4,
        patch=1,
        mask="bidirectional",
        text_attention="joint",
        refiner_layers=2,
        refiner_timed=True,
        null_tokens=0,
        shared_modulation=False,
        condition_drop=0.1,
    ),
    **under("generator.model.process", prediction="x1", source_scale=5.0, clamp=0.05, times="uniform"),
    **under("generator.sampling", guidance=3.0, solver="heun", solver_steps=49, solver_grid="uniform"),
    "generator.train.clip": None,
    "generator.train.milestones": [50_000],
}
PAPERS = {
    "msflow_263": MSFLOW_RECIPE | {"generator.model.mask": "causal", "representation.kind": "redundant"},
    "msflow_67": MSFLOW_RECIPE,
    "msflow": MSFLOW_RECIPE | {"tokenizer.model.statistics": "shared_axis"},
    "msflow_67_few": MSFLOW_RECIPE | SHORTCUT,
    "latent_flow": MSFLOW_RECIPE | LATENT_FLOW,
    "latent_flow_few": MSFLOW_RECIPE | LATENT_FLOW | SHORTCUT,
    "mardm_words": MARDM | {"generator.model.null_tokens": 4},
    "acmdm": ACMDM,
    "acmdm_raw": {k: v for k, v in ACMDM.items() if not k.startswith("tokenizer.")}
    | {"generator.model.unit": 1, "generator.model.channels": 3, "tokenizer.train": None},
    "remodiffuse": REMODIFFUSE,
    "mdm": MDM,
    "mld": MLD,
    "mdm_epsilon": MDM | {"generator.model.process.prediction": "epsilon"},
    "mdm_1000": MDM_1000,
    "motiondiffuse": MOTIONDIFFUSE,
    "mardm_ddpm": MARDM,
    "mardm_sit": MARDM,
    "mardm_frames": {k: v for k, v in MARDM.items() if not k.startswith("tokenizer.")}
    | {"generator.model.latent_dim": (4 * 263, 4 * 251), "representation.variant": "raw", "tokenizer.train": None},
    "mardm_parallel": MARDM | {"generator.model.mask_ratio": "all", "generator.sampling.steps": 1},
    "t2m_gpt": T2M_GPT,
    "attt2m": ATTT2M,
    "mmm": MMM,
    "bad_cbs": BAD | {"generator.sampling.sampler": "cbs"},
    "bad_oaas": BAD | {"generator.sampling.sampler": "oaas"},
    "momask": MOMASK,
    "bamm": BAMM,
    "motiongpt": MOTIONGPT,
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("corpus", CORPORA)
def test_paper_scale_is_the_papers(corpus, method):
    config = at_paper_scale(method, corpus)
    wrong = {}
    for key, value in (PROTOCOL | PAPERS[method]).items():
        wanted = value[CORPORA.index(corpus)] if isinstance(value, tuple) else value
        assert OmegaConf.select(config, key.rpartition(".")[0]) is not None, key
        found = plain(OmegaConf.select(config, key, default="absent"))
        if found != wanted:
            wrong[key] = (found, wanted)
    assert not wrong
