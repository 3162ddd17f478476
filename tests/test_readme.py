"""What README and docs/ tell people to type exists: Python runs, bash parses, overrides compose, links lead on."""

from __future__ import annotations

import functools
import importlib.util
import re
import shlex
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from kinema import cli
from kinema.atomic import write_json
from kinema.cli.parser import command_line
from kinema.experiments.config import CONF, compose
from kinema.motion.statistics import Statistics
from kinema.runs import weights
from kinema.runs.build import build
from kinema.runs.folder import RunFolder

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "docs" / "adding_a_method.md"  # its files are none of ours: test_adding_a_method.py runs them
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(set((ROOT / "docs").glob("*.md")) - {EXAMPLE})]
SPECS = sorted((ROOT / "docs" / "specs").glob("*.md"))  # their references and options: test_spec_references.py
SHELL = ("eval", "export", "cd", ".", "git", "ls", "mkdir", "cp", "wandb", "tensorboard", "pip", "tail", "python3.11")
"""Commands that are not ours to check."""


METHODS = (
    "mardm_sit",
    "momask",
    "bad_oaas",
    "bamm",
    "attt2m",
    "t2m_gpt",
    "mmm",
    "motiongpt",
    "mdm",
    "mld",
    "remodiffuse",
    "msflow",
    "msflow_67",
    "msflow_67_few",
    "mardm_words",
    "acmdm",
)
GROUPS = "method|tokenizer|generator|residual|shortcut|diffusion|evaluator|representation|text|data"
GROUPS += "|scale|trainer|logger|launcher|debug"
OVERRIDE = rf"\+?({GROUPS}|[a-z]+(\.\w+)+)=[\w.]+"


def blocks(language: str) -> list:
    """Give the fenced blocks of a language, page by page."""
    found = []
    for page in PAGES:
        for i, text in enumerate(re.findall(rf"^```{language}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL)):
            found.append(pytest.param(text, id=f"{page.stem}-{i}"))
    return found


def commands() -> list:
    """Give every command line of the bash blocks, continued lines joined."""
    lines = []
    for block in blocks("bash"):
        for line in block.values[0].replace("\\\n", " ").splitlines():
            words = shlex.split(line, comments=True)
            if words:
                lines.append(pytest.param(words, id=f"{block.id}-{line[:60]}"))
    return lines


@pytest.mark.parametrize("words", commands())
def test_commands_exist(words):
    while re.fullmatch(r"\w+=.*", words[0]):  # VARIABLE=value before a command, or alone
        words = words[1:]
        if not words or words[0].startswith(("-", "runs", "|", "head")):
            return
    check = {"make": check_make, "kinema": check_kinema, "python": check_python}
    if words[0] in check:
        check[words[0]](words[1:])
    else:
        assert words[0] in SHELL


def check_kinema(words):
    if words[0] in ("train", "evaluate"):
        check_hydra(words[0], words[1:])
    elif words[0] == "reproduce":
        assert reproducible(words[1])
        check_overrides([w for w in words[2:] if "=" in w], "evaluate")
    elif words[0] == "figures":
        assert importlib.util.find_spec(f"kinema.experiments.figures.{words[1]}")
    elif words != ["--version"]:
        command_line().parse_args(words)


def reproducible(name):
    return any((CONF / group / f"{name}.yaml").exists() for group in ("table", "page"))


def check_make(words):
    dry = subprocess.run(["make", "-n", *words], cwd=ROOT, capture_output=True, text=True)
    assert dry.returncode == 0, dry.stderr
    variables = dict(w.split("=", 1) for w in words if "=" in w)
    own = re.findall(r"^(reproduce-[\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    for target in (w for w in words if w.startswith("reproduce-") and w not in own):
        assert reproducible(target.removeprefix("reproduce-"))
        known = {k: v for k, v in variables.items() if k in ("DATA", "SCALE", "LAUNCHER")}
        assert set(variables) <= {*known, "ARGS"}
        check_overrides(
            [*(f"{k.lower()}={v}" for k, v in known.items()), *variables.get("ARGS", "").split()], "evaluate"
        )


def check_python(words):
    if words[0] == "-m":
        assert importlib.util.find_spec(words[1])
        return
    assert (ROOT / words[0]).exists()
    if words[0] in ("train.py", "evaluate.py"):
        check_hydra(words[0].removesuffix(".py"), words[1:])


def check_hydra(config, words):
    flags = {w for w in words if w.startswith("-")}
    assert flags <= {"-m", "--cfg", "--resolve", "--config-dir"}
    if "--config-dir" in flags:  # its files are the page's: tests/configs/test_scales.py
        return
    check_overrides([w for w in words if "=" in w], config)


def check_overrides(overrides, config):
    """Compose every value of a sweep at least once."""
    choices = []
    for override in OverridesParser.create().parse_overrides(overrides):
        sweep = override.is_sweep_override()
        values = override.sweep_string_iterator() if sweep else [override.get_value_element_as_str()]
        key = override.input_line.split("=", 1)[0]
        choices.append([f"{key}={value}" for value in values])
    for i in range(max(map(len, choices), default=1)):
        compose([values[i % len(values)] for values in choices], config)


def test_overrides_that_the_text_names_compose():
    """Compose inline code such as `text=clip_b32`, for a method or corpus that has it."""
    text = "\n".join(page.read_text() for page in PAGES)
    codes = " ".join(re.findall(r"`([^`\n]+)`", text)).split()
    overrides = sorted({code for code in codes if re.fullmatch(OVERRIDE, code) and "..." not in code})
    assert len(overrides) > 20
    assert not [override for override in overrides if not composes_for_some(override)]


def composes_for_some(override):
    """Tell whether it can be said: of an option, that it composes; of any other key, that some choice has it."""
    key = override.lstrip("+").partition("=")[0]
    choices = [choice for choice, cfg in composed_choices().items() if OmegaConf.select(cfg, key) is not None]
    if choices and not (ROOT / "conf" / key).is_dir():
        OverridesParser.create().parse_override(override)
        return True
    for choice in choices or composed_choices():
        try:
            compose([choice, override], "evaluate")
        except ValueError:
            continue
        return True
    return False


@functools.cache
def composed_choices():
    choices = (*(f"method={method}" for method in METHODS), "data=open_mocap")
    return {choice: compose([choice], "evaluate") for choice in choices}


RUN = "mardm_sit-xl-essential-synthetic-smoke-s0-0"
TOKENIZER = {
    "_target_": "kinema.tokenizers.autoencoder.AutoEncoder",
    "representation": {
        "_target_": "kinema.motion.representation.Representation",
        "kind": "essential",
        "skeleton": "humanml3d",
    },
    "width": 8,
    "latent_dim": 4,
    "depth": 1,
}
GENERATOR = {
    "_target_": "kinema.generators.mar.MARDM",
    "latent_dim": 4,
    "text_dim": 64,
    "process": {"_target_": "kinema.diffusion.flow.Flow"},
    "width": 16,
    "feedforward": 16,
    "heads": 2,
    "mlp_width": 16,
    "mlp_depth": 1,
    "sampling": {"_target_": "kinema.generators.mar.MarSampling", "steps": 3, "solver": "euler", "solver_steps": 2},
}


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """Stand in a folder that has the runs which `make reproduce-table5` leaves, with tiny random weights."""
    torch.manual_seed(0)
    for stage, name, spec in (
        ("tokenizer", "ae", TOKENIZER),
        ("generator", "mardm_sit-xl-essential-synthetic-smoke-s0-0", GENERATOR),
    ):
        module = build(spec)
        if stage == "tokenizer":
            module.representation.fit(Statistics(np.zeros(67), np.full(67, 0.05)))
        weights.save(module, spec, tmp_path / "runs" / stage / name / "weights.safetensors", part=stage)
    folder = tmp_path / "runs" / "generator" / RUN
    RunFolder(folder).mark("done")
    write_json(folder / "upstream.json", {"tokenizer": "../../tokenizer/ae"})
    write_json(folder / "text.json", {"encoder": "hashed", "path": None})
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("code", blocks("python"))
def test_python_runs(code, checkout, request):
    if "latent-flow-open-mocap" in code:
        request.getfixturevalue("shipped")
    for _ in range(2):
        exec(compile(code, "example", "exec"), {"__name__": "example"})


USES = ("generate", "edit", "export", "gallery", "models", "info")
"""Commands that a model and what commands before it wrote are enough for."""


@pytest.mark.slow
def test_the_readme_s_commands_run_with_the_model_of_the_package(shipped, tmp_path, monkeypatch):
    """Run them in their order, in a folder with nothing in it, without corpus, runs or network."""
    for name in ("KINEMA_SHARED", "KINEMA_RUNS", "KINEMA_STORES"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("socket.socket.connect", lambda *_: pytest.fail("the network was asked for"))
    monkeypatch.chdir(tmp_path)
    lines = [param.values[0] for param in commands() if param.id.startswith("README-")]
    ours = [words[1:] for words in lines if words[0] == "kinema" and words[1] in USES]
    used = [words for words in ours if not any(word.startswith("latest:") for word in words)]  # of a run of one's own
    assert used[0] == ["generate", "a person waves with the left hand", "--out", "wave.html"]
    for words in used:
        assert cli.main(words) == 0, words
        if "--out" in words:
            assert list(tmp_path.glob(f"{Path(words[words.index('--out') + 1]).stem}*")), words


def test_the_readme_has_both_kinds():
    assert len(commands()) > 10
    assert blocks("python")


@pytest.mark.parametrize("page", [*PAGES, *SPECS], ids=lambda page: page.stem)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text()):
        assert (page.parent / target).exists(), target
    for path in re.findall(r"`(src/kinema/[\w/.]+\.py|kinema/[\w/.]+\.py|conf/[\w/.]+\.yaml)`", page.read_text()):
        assert (ROOT / path).exists() or (ROOT / "src" / path).exists(), path
