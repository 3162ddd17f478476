"""What differs by scale: which value wins, models that shrink with their scale, and a scale of a user's own."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
import torch
import yaml
from omegaconf import DictConfig

from kinema.experiments.config import CONF, compose, plain
from kinema.runs.build import build

ROOT = Path(__file__).resolve().parents[2]
SCALES = ("paper", "tiny", "smoke")
LADDER = ["mar_s", "mar_m_384", "mar_m", "mar_l_384", "mar_l", "mar"]
PARTS = [
    (group, option)
    for group in ("tokenizer", "generator", "residual", "shortcut")
    for option in sorted(file.stem for file in (CONF / group).glob("*.yaml"))
    if option
    not in (
        "none",
        "frames",
        "frame_groups",
        "joints",
        "fsq",
    )  # nothing to build, nothing to shrink; FSQ needs memory to be built
]
METHOD_OF = {"msflow": "msflow_67_few", "rvq": "momask", "momask": "momask", "bamm": "bamm", "vq_attt2m": "attt2m"}
METHOD_OF |= {"latent_flow": "latent_flow", "mar_words": "mardm_words"}
METHOD_OF |= {"joint_ae": "acmdm", "acmdm": "acmdm", "acmdm_xl": "acmdm", "acmdm_raw": "acmdm_raw"}
METHOD_OF |= {"vae": "mld"} | {option: option for option in ("mdm", "mdm_1000", "motiondiffuse", "remodiffuse", "mld")}

composed = cache(lambda *overrides: compose(list(overrides)))


def with_part(group: str, option: str, scale: str) -> DictConfig:
    """Compose a part beside others that it fits."""
    method = METHOD_OF.get(option, "mardm_sit" if option.startswith(("mar", "ae")) else "mmm")
    return composed(f"method={method}", f"{group}={option}", f"scale={scale}")


def parameters(cfg: DictConfig, group: str) -> int:
    if group == "generator" and cfg.generator.name == "motiongpt":
        pytest.importorskip("transformers", reason="needs the extra kinema[text]")
    with torch.device("meta"):
        return sum(p.numel() for p in build(plain(cfg[group].model)).parameters())


@pytest.mark.parametrize("scale", SCALES)
def test_the_sizes_of_mardm_form_a_ladder(scale):
    counts = [parameters(with_part("generator", size, scale), "generator") for size in LADDER]
    assert counts == sorted(set(counts))


@pytest.mark.parametrize(("group", "option"), PARTS, ids=["/".join(part) for part in PARTS])
def test_every_part_shrinks_with_its_scale(group, option):
    """A variant without a file of its own in a budget would keep the paper's size there."""
    counts = [parameters(with_part(group, option, scale), group) for scale in SCALES]
    assert counts[0] > 4 * counts[1] > 4 * counts[2]


def test_the_later_value_wins():
    assert composed("method=bad_oaas", "scale=paper").generator.train.lr == 2e-4
    budget = composed("method=bad_oaas", "scale=tiny").generator
    assert (budget.train.lr, budget.sampling.temperature) == (5e-4, 0.6)
    method = composed("method=bad_cbs", "scale=tiny").generator.sampling
    assert (method.sampler, method.temperature) == ("cbs", None)
    given = ("generator.sampling.temperature=0.3", "generator.train.lr=1")
    line = composed("method=bad_cbs", "scale=tiny", *given).generator
    assert (line.sampling.temperature, line.train.lr) == (0.3, 1)


def test_a_budget_can_be_chosen_without_its_protocol():
    cfg = composed("scale=tiny", "budget=paper")
    assert cfg.scale == composed("scale=tiny").scale
    assert cfg.generator.model.width == composed("scale=paper").generator.model.width


def test_the_page_that_describes_a_scale_of_ones_own_is_right(tmp_path):
    page = (ROOT / "docs" / "experiments.md").read_text()
    (text,) = re.findall(r"`mine/(scale/\w+\.yaml)`.*?```yaml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "scale").mkdir()
    (tmp_path / text[0]).write_text(text[1])
    cfg = compose([f"hydra.searchpath=[file://{tmp_path}]", f"scale={Path(text[0]).stem}"])
    assert (cfg.scale.name, cfg.scale.protocol.replications, cfg.generator.train.lr) == ("medium", 10, 2e-4)


@pytest.fixture
def mine(tmp_path) -> Path:
    """Write a scale that starts from tiny and has values of its own, for all models and for one of them."""
    scale = tmp_path / "scale"
    (scale / "mine" / "generator").mkdir(parents=True)
    (scale / "mine.yaml").write_text(
        "# @package _global_\n"
        "defaults: [tiny, _self_]\n"
        "scale: {name: mine, protocol: {replications: 3}}\n"
        "tokenizer: {train: {steps: 9}}\n"
        "generator: {train: {lr: 7}}\n"
    )
    (scale / "mine" / "generator" / "mar.yaml").write_text("model: {width: 64}\n")
    return tmp_path


def test_a_scale_of_ones_own_is_one_file(mine):
    def chosen(*overrides: str) -> dict:
        return plain(compose([f"hydra.searchpath=[file://{mine}]", "scale=mine", *overrides]))

    tiny = plain(composed("scale=tiny"))
    mardm, mmm = chosen(), chosen("method=mmm")
    assert mardm["scale"]["name"] == "mine"
    assert mardm["scale"]["protocol"] == tiny["scale"]["protocol"] | {"replications": 3}
    assert mardm["tokenizer"]["train"]["steps"] == mmm["tokenizer"]["train"]["steps"] == 9
    assert mardm["generator"]["model"] == tiny["generator"]["model"] | {"width": 64}
    assert mardm["generator"]["train"] == tiny["generator"]["train"] | {"lr": 7}
    assert mmm["generator"]["model"] == plain(composed("method=mmm", "scale=tiny"))["generator"]["model"]
    assert chosen("generator.model.width=32")["generator"]["model"]["width"] == 32


def test_the_command_line_prints_the_numbers_of_ones_own_scale(mine):
    command = [sys.executable, "train.py", "--config-dir", mine, "scale=mine", "--cfg", "job", "--resolve"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True, env={**os.environ})
    assert yaml.safe_load(done.stdout)["generator"]["model"]["width"] == 64
