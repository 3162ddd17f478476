"""Compose every option of every config group, and build every part and method from its file."""

from __future__ import annotations

import re
from copy import deepcopy
from functools import cache

import pytest
from omegaconf import OmegaConf
from tests.configs.composing import CORPORA, METHODS, OFFLINE, composed, resolved, size, stage_model

from kinema.experiments.config import CONF, compose, plain, validate
from kinema.experiments.sampling import build_sampling
from kinema.experiments.stages import get_stage, stages
from kinema.experiments.stages.fitted import FittedStage
from kinema.experiments.table_files import load_table
from kinema.pipeline.compatibility import check_pair
from kinema.runs.build import build
from kinema.text.encoders import ENCODERS

MODELS = ("tokenizer", "generator", "residual", "shortcut", "length")
ELSEWHERE = ("table", "page", "study", "hydra", "method", "scale", "budget", "recipe")
"""No groups, or composed by a test of their own."""
GROUPS = {
    group.name: sorted(file.stem for file in group.glob("*.yaml"))
    for group in sorted(CONF.iterdir())
    if group.is_dir() and group.name not in ELSEWHERE
}
UNTRAINED = ("frames", "frame_groups", "joints")
PARTS = [(group, option) for group in MODELS for option in GROUPS[group] if option not in ("none", *UNTRAINED)]
"""Not the tokenizers that have no parameters."""
REST = [group for group in GROUPS if group not in MODELS]
# Options that no method names, and one whose parts they fit.
OTHERS = {"bad_notime": "bad_oaas", "fsq": "t2m_gpt", "acmdm_xl": "acmdm"}


def fitting(group: str, option: str) -> list[str]:
    """Choose a method whose other parts the option fits."""
    named = rf"override /{group}: {option}$"
    methods = [m for m in METHODS if re.search(named, (CONF / "method" / f"{m}.yaml").read_text(), re.MULTILINE)]
    methods += [OTHERS[option]] if option in OTHERS else []
    return [f"method={methods[0]}"] if methods else []


@pytest.mark.parametrize("scale", ["smoke", "tiny", "paper"])
@pytest.mark.parametrize("row", range(max(len(GROUPS[group]) for group in REST)))
def test_every_option_composes_and_resolves(row, scale):
    """Take the groups' options side by side, those of short lists several times."""
    choice = {group: GROUPS[group][row % len(GROUPS[group])] for group in REST}
    source = ["data.source=somewhere"] if choice["data"] == "custom" else []
    config = resolved(*(f"{group}={option}" for group, option in choice.items()), *source, f"scale={scale}")
    assert config["text"]["name"] == choice["text"]


@pytest.mark.parametrize(("group", "option"), PARTS, ids=["/".join(part) for part in PARTS])
def test_every_part_builds_where_it_fits(group, option):
    choice = (*OFFLINE, *fitting(group, option), f"{group}={option}", "scale=paper")
    resolved(*choice)
    assert size(stage_model(group, cfg=composed(*choice))) > 0


@pytest.mark.parametrize("corpus", CORPORA)
@pytest.mark.parametrize("scale", ["smoke", "tiny", "paper"])
@pytest.mark.parametrize("method", METHODS)
def test_every_method_builds_at_every_scale_on_both_skeletons(method, scale, corpus):
    cfg = composed(*OFFLINE, f"method={method}", f"scale={scale}", f"data={corpus}")
    fitted = [name for name, stage in stages().items() if isinstance(stage, FittedStage) and stage.present(cfg)]
    models = {name: stage_model(name, cfg=cfg) for name in fitted}
    assert all(size(model) > 0 or get_stage(name).config(cfg).train is None for name, model in models.items())
    assert cfg.generator.get("predicts_length", False) == models["generator"].predicts_length
    assert type(build(plain(cfg.generator.sampling))) is type(models["generator"].sampling)
    for name in {"generator", *models["generator"].parts} & models.keys():
        check_pair(models["tokenizer"], models[name])
    for name in models.keys() & models["generator"].parts:
        models["generator"].attach(name, models[name])
    assert type(build_sampling(cfg)) is type(models["generator"].sampling)
    printed = deepcopy(cfg)
    OmegaConf.resolve(printed)  # as `--cfg job --resolve` does, in place
    assert "${" not in OmegaConf.to_yaml(printed)


def test_nothing_is_guided_from_an_empty_text_that_training_never_had():
    guided = []
    for method in METHODS:
        cfg = composed(*OFFLINE, f"method={method}", "scale=smoke")
        if cfg.generator.model.get("condition_drop", 0) and cfg.generator.sampling.get("guidance", 1) != 1:
            guided.append(method)
            cfg.generator.model.condition_drop = 0.0
            with pytest.raises(ValueError, match="no empty text to be guided from"):
                stage_model("generator", cfg=cfg)
    assert {"mardm_sit", "momask", "bamm", "mdm", "mld", "msflow"} <= set(guided)


@pytest.mark.parametrize("method", ["mmm", "bad_oaas", "attt2m"])
def test_the_published_words_are_one_choice(method):
    """COMMON §6: all 77 positions, unmasked."""
    config = resolved(f"method={method}", "scale=paper", "text=clip_b32_77", "generator.model.words=all")
    assert config["text"]["name"] in ENCODERS
    assert config["generator"]["model"]["token_dim"] == 512


def test_ddpm_and_flow_are_one_override_apart():
    ddpm = resolved("method=mardm_ddpm", "scale=paper")["generator"]
    assert ddpm["model"]["process"] == {"_target_": "kinema.diffusion.ddpm.DDPM", "steps": 50, "schedule": "cosine"}
    assert ddpm["sampling"]["solver"] == "ancestral"
    assert resolved("method=mardm_sit", "diffusion=ddpm", "scale=paper")["generator"] == ddpm


@pytest.mark.parametrize(("corpus", "widths"), [("humanml3d", (67, 263)), ("kit_ml", (64, 251))])
def test_the_representation_is_one_override(corpus, widths):
    for kind, width in zip(("essential", "redundant"), widths, strict=True):
        choice = (f"data={corpus}", f"representation={kind}")
        assert stage_model("tokenizer", *choice).representation.width == width
        # The judge's representation is its own: the comparison of tables is on the same judge.
        assert stage_model("matching", *choice).representation.width == widths[0]
        assert stage_model("matching", *choice, "evaluator=redundant").representation.width == widths[1]


@cache
def row_config(*overrides: str) -> None:
    validate(compose(list(overrides), "evaluate"))


@pytest.mark.parametrize("table", sorted(file.stem for file in (CONF / "table").glob("*.yaml")))
def test_every_table_names_methods_and_columns_that_exist(table):
    from kinema.experiments.tables import row_overrides

    described = load_table(table)
    keys = {row["key"] for row in described["rows"]}
    columns = {column["key"] for column in [*described["columns"], *described.get("beside", [])]}
    for row in described["rows"]:
        if "source" in row:
            row_config(*row_overrides(row))
    for published in described["paper"].values():
        assert set(published) <= keys
        assert set().union(*published.values()) <= columns


def test_names_that_a_configuration_may_hold_are_their_owners():
    from kinema.evaluation import controlled, oracle, perturbed
    from kinema.experiments import config
    from kinema.pipeline import editing

    assert config.PERTURBATIONS == perturbed.HOW
    assert (*controlled.FRAMES, "mixed") == config.DENSITIES
    assert config.ORACLES == oracle.KNOWS
    assert set(config.EDITS) == set(editing.TASKS)
