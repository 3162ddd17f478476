"""Share the fixtures: golden files, one thread, and micro runs on a few dozen synthetic clips."""

from __future__ import annotations

import json
import os
import random
import string
import subprocess
import sys
import tarfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import torch
from hypothesis import settings
from jaxtyping import install_import_hook

# Shapes and types are checked in this process, in what is imported after this. NumPy's numbers serve as numbers, an int
# as a float (PEP 484); `Self` is mypy's to check, since jaxtyping decorates methods one by one.
CHECKER = (
    "beartype.beartype(conf=beartype.BeartypeConf(hint_overrides=beartype.FrozenDict({"
    "int: int | __import__('numpy').integer, float: float | int | __import__('numpy').number, "
    "__import__('typing').Self: object})))"
)
CHECKED = ("types", "atomic", "files", "locks", "seeds", "signals", "devices", "registry", "masking", "nn", "motion")
CHECKED += ("data", "diffusion", "decoding", "runs", "pipeline", "evaluation", "report", "experiments", "cli", "demo")
CHECKED += ("generators", "tokenizers", "interop")
CHECKED += tuple(
    f"training.{name}"
    for name in (
        "callbacks",
        "checkpoint",
        "dashboards",
        "latents",
        "modules",
        "observers",
        "pace",
        "progress",
        "record",
    )
)
# Not `text.hashed`, `text.cache` and `training.recipe`: tests pass them what is wrong, which they refuse by themselves.
CHECKED += tuple(
    f"text.{name}" for name in ("clip", "files", "frozen", "hidden", "minilm", "packed", "tokens", "vip", "words")
)
install_import_hook([f"kinema.{name}" for name in CHECKED], CHECKER)

# Nothing depends on chance, on time or on what a run before found.
settings.register_profile("repeatable", derandomize=True, deadline=None, database=None, max_examples=50)
settings.load_profile("repeatable")

ROOT = Path(__file__).resolve().parent.parent
GOLDEN = ROOT / "tests" / "golden"
SHARED = Path(os.environ.get("KINEMA_SHARED", ROOT.parent / "shared")).absolute()

torch.set_num_threads(1)

MICRO = [
    "data=synthetic",
    "data.options.size=160",
    "text=hashed",
    "evaluator.words=hashed",
    "evaluator.tokens=hashed",
    "trainer=cpu",
    "trainer.progress=none",
    "tokenizer.train.steps=24",
    "generator.train.steps=24",
    "generator.model.dropout=0.1",
    "length.train.steps=8",
    "evaluator.decomposition.train.steps=8",
    "evaluator.matching.train.steps=24",
    "evaluator.contrastive.train.steps=8",
    "scale.protocol.mm_texts=4",
    "scale.protocol.pool=8",
]
for stage in ("tokenizer", "generator", "evaluator.matching"):
    MICRO += [f"{stage}.train.validate_every=8", f"{stage}.train.checkpoint_every=5", f"{stage}.train.val_batches=1"]


@pytest.fixture(autouse=True)
def seeded() -> None:
    """Seed what a test draws without a generator of its own, and what beartype does: one item of a container."""
    random.seed(0)
    torch.manual_seed(0)


Script = Callable[..., subprocess.CompletedProcess]


@pytest.fixture(scope="session")
def shelf(tmp_path_factory) -> Path:
    """Give a folder for stores and caches that the tests of a session share."""
    return tmp_path_factory.mktemp("kinema")


@pytest.fixture(scope="session", autouse=True)
def own_cache(shelf: Path) -> Iterator[None]:
    """Keep what tests ask runs to read apart from the user's own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("KINEMA_CACHE", str(shelf / "cache"))
        yield


@pytest.fixture
def overrides(shelf: Path, tmp_path: Path) -> list[str]:
    """Give the overrides of a micro run whose runs are the test's own."""
    return [*MICRO, f"paths.runs={tmp_path}/runs", f"paths.stores={shelf}/stores", f"paths.cache={shelf}/cache"]


@pytest.fixture
def script(overrides: list[str]) -> Script:
    """Run train.py, evaluate.py or a snippet in a process of its own; returns the completed process."""

    def run(name: str, *arguments: str, check: bool = True) -> subprocess.CompletedProcess:
        command = [sys.executable, name, *overrides, *arguments]
        done = subprocess.run(
            command, cwd=ROOT, capture_output=True, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"}
        )
        assert not check or done.returncode == 0, f"{' '.join(command)}\n{done.stdout}\n{done.stderr}"
        return done

    return run


@pytest.fixture(scope="session")
def micro(shelf: Path) -> list[str]:
    """Give the overrides of micro runs that all tests share: whoever needs one first trains it."""
    return [*MICRO, f"paths.runs={shelf}/runs", f"paths.stores={shelf}/stores", f"paths.cache={shelf}/cache"]


@pytest.fixture(scope="session")
def micro_tables(micro: list[str], shelf: Path) -> list[str]:
    """Give what makes the same runs with tokenizers that train and ones that don't: their steps stand in a scale."""
    own = [o.removeprefix("tokenizer.train.").split("=") for o in micro if o.startswith("tokenizer.train.")]
    files = {"scale/micro.yaml": "# @package _global_\ndefaults: [smoke, _self_]\n"}
    for file in (ROOT / "conf" / "tokenizer").glob("*.yaml"):
        if "train: null" not in file.read_text():
            recipe = ", ".join(f"{key}: {value}" for key, value in own)
            files[f"scale/micro/tokenizer/{file.name}"] = f"train: {{{recipe}}}\n"
    for name, text in files.items():
        (shelf / "conf" / name).parent.mkdir(parents=True, exist_ok=True)
        (shelf / "conf" / name).write_text(text)
    others = [o for o in micro if not o.startswith("tokenizer.train.")]
    return [*others, f"hydra.searchpath=[file://{shelf}/conf]", "scale=micro"]


@pytest.fixture(scope="session")
def open_mocap() -> Path:
    """Return the folder of the open-mocap corpus in KINEMA_SHARED (default ../shared beside the checkout) or skip."""
    folder = SHARED / "data" / "open-mocap"
    if not folder.is_dir():
        pytest.skip(f"the corpus {folder} is absent; set KINEMA_SHARED to run this test")
    return folder


@pytest.fixture(scope="session")
def shipped() -> Path:
    """Return the folder of the package's model, or skip: `tests/test_package.py` fails without it."""
    folder = ROOT / "src" / "kinema" / "models" / "latent-flow-open-mocap"
    if not (folder / "weights.safetensors").is_file():
        pytest.skip(f"the model of the package is absent: {folder}")
    return folder


@pytest.fixture(scope="session")
def golden_file(tmp_path_factory) -> Callable[[str], Path]:
    """Find a golden file by name ("vq/schedules.safetensors"): in tests/golden, else in KINEMA_SHARED, else skip."""
    unpacked = tmp_path_factory.mktemp("golden")

    def find(name: str) -> Path:
        family = name.split("/")[0]
        archive = GOLDEN / f"{family}.tar.xz"
        if archive.is_file() and not (unpacked / family).is_dir():
            with tarfile.open(archive) as members:
                members.extraction_filter = lambda member, _: member  # our own files; 3.11.0 knows no `filter=`
                members.extractall(unpacked)
        for folder in (unpacked, SHARED / "golden"):
            if (folder / name).is_file():
                return folder / name
        pytest.skip(f"{name} is neither in {GOLDEN} nor in {SHARED / 'golden'}; set KINEMA_SHARED to run this test")

    return find


@pytest.fixture(scope="session")
def make_clip(tmp_path_factory) -> Callable[[int, int], Path]:
    """Make a tiny CLIP of two widths: random weights and a BPE of single letters, laid out as the published folders."""

    def make(hidden: int, projection: int) -> Path:
        transformers = pytest.importorskip("transformers")
        folder = tmp_path_factory.mktemp("tiny-clip")
        letters = list(string.ascii_lowercase)
        vocabulary = [*letters, *(c + "</w>" for c in letters), "wa", "<|startoftext|>", "<|endoftext|>"]
        torch.manual_seed(0)
        shape = {
            "intermediate_size": 64,
            "num_hidden_layers": 2,
            "num_attention_heads": 2,
            "projection_dim": projection,
        }
        text = {"hidden_size": hidden, "vocab_size": len(vocabulary), "max_position_embeddings": 77, **shape}
        # As in the published files, the end token's id in the config is the legacy 2: the model then takes the argmax.
        text |= {"eos_token_id": 2, "bos_token_id": 0, "pad_token_id": 1}
        vision = {"hidden_size": 32, "image_size": 32, "patch_size": 16, **shape}
        config = transformers.CLIPConfig(text_config=text, vision_config=vision, projection_dim=projection)
        transformers.CLIPModel(config).save_pretrained(folder)
        (folder / "vocab.json").write_text(json.dumps({t: i for i, t in enumerate(vocabulary)}))
        (folder / "merges.txt").write_text("#version: 0.2\nw a\n")
        special = {"bos_token": "<|startoftext|>", "eos_token": "<|endoftext|>", "pad_token": "<|endoftext|>"}
        names = {"tokenizer_class": "CLIPTokenizer", "unk_token": "<|endoftext|>", "model_max_length": 77}
        (folder / "tokenizer_config.json").write_text(json.dumps(special | names))
        return folder

    return make
