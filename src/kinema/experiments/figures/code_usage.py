"""Compare how trained tokenizers use their codes, redundant beside essential dims (MARDM, Figure 2).

`kinema figures code_usage RUN... [--split test] [--out reports/code_usage]`
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from omegaconf import DictConfig

from kinema.atomic import replacing, write_json, write_text
from kinema.data.catalog import SPLITS
from kinema.data.collate import collate
from kinema.data.datasets import Item
from kinema.data.store import PackedStore
from kinema.devices import find_device
from kinema.evaluation.metrics.code_usage import CodeUsage
from kinema.experiments.config import read_config
from kinema.experiments.corpus import open_corpus
from kinema.experiments.instantiate import read_model
from kinema.motion.skeleton import DIMS
from kinema.motion.view.draw import new_figure
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.runs.parts import TOKENIZER
from kinema.tokenizers import MotionTokenizer

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BATCH = 64
ORDER = DIMS[::-1]
CONFIG = {
    TOKENIZER: {"name": str},
    "seed": int,
    "scale": {"name": str},
    "data": {"name": str, "reader": str, "skeleton": str, "options": dict},
    "paths": {"stores": str},
}
"""What is read of a run's configuration."""


def main(arguments: list[str] | None = None) -> None:
    """Parse the command line and write the report."""
    parser = argparse.ArgumentParser(prog="kinema figures code_usage", description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN", help="a folder of runs/tokenizer")
    parser.add_argument("--split", default="test", choices=SPLITS)
    parser.add_argument("--out", type=Path, default=Path("reports/code_usage"), help="folder of the report")
    parser.add_argument("--accelerator", default="auto", help="auto, cpu, gpu, cuda or mps")
    options = parser.parse_intermixed_args(arguments)
    try:
        device = find_device(options.accelerator)
        for path in write_report([measure(run, options.split, device) for run in options.runs], options.out):
            console.print(f"wrote     {path}")
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")


def measure(run: Path, split: str = "test", device: torch.device | str = "cpu") -> dict[str, Any]:
    """Encode the whole clips of a split with a run's tokenizer, and count its codes.

    Raises FileNotFoundError for a folder that holds no finished run, ValueError for one whose latents are no codes.
    """
    tokenizer, cfg = _read(run)
    store = PackedStore.open(open_corpus(cfg))
    counter = CodeUsage(tokenizer.space.classes, tokenizer.space.quantizers).to(device)
    usage = count(tokenizer.to(device), store, split, counter).compute()
    names = ("perplexity", "used", "dead")
    return {
        "run": str(run),
        TOKENIZER: cfg.tokenizer.name,
        "dims": tokenizer.representation.kind,
        "seed": cfg.seed,
        "scale": cfg.scale.name,
        "corpus": {"name": store.name, "hash": store.hash, "split": split},
        "codebook_size": tokenizer.space.codebook_size,
        "codes": int(usage["histogram"][0].sum()),
        **{name: usage[name].item() for name in names},
        "layers": [
            {name: usage[f"layer_{name}"].flatten()[i].item() for name in names} | {"histogram": row.tolist()}
            for i, row in enumerate(usage["histogram"])
        ],
    }


@torch.no_grad()
def count(tokenizer: MotionTokenizer, store: PackedStore, split: str, usage: CodeUsage) -> CodeUsage:
    """Add the codes of every clip of a split that is long enough for one; neighbours in a batch are of like length."""
    clips = [int(i) for i in store.split_clips(split) if store.clips["frames"][i] >= tokenizer.space.whole(1)]
    if not clips:
        raise ValueError(f"corpus {store.name!r} has no clips in its split {split!r}; choose another split")
    clips.sort(key=lambda i: (int(store.clips["frames"][i]), i))
    for start in range(0, len(clips), BATCH):
        items = [Item(store.clip_frames(i), i, 0, store.clip_name(i)) for i in clips[start : start + BATCH]]
        usage.update(tokenizer.encode(collate(items).to(usage.device)))
    return usage


def write_report(results: list[dict[str, Any]], out: Path) -> list[Path]:
    """Write code_usage.json, code_usage.md and, where matplotlib is installed, code_usage.png."""
    results = sorted(results, key=lambda r: (r[TOKENIZER], r["scale"], r["seed"], ORDER.index(r["dims"]), r["run"]))
    write_json(out / "code_usage.json", {"runs": results})
    written = [out / "code_usage.json", write_text(out / "code_usage.md", markdown(results))]
    try:
        return [*written, draw(results, out / "code_usage.png")]
    except ImportError as error:
        console.print(f"[yellow]note[/]      no figure: {error}")
        return written


def markdown(results: list[dict[str, Any]]) -> str:
    """Write one row per run and layer, and the mean where there are several layers."""
    heads = [TOKENIZER, "dims", "layer", "codes", "used", "dead", "perplexity"]
    lines = [f"| {' | '.join(heads)} |", f"|{'---|' * len(heads)}"]
    for result in results:
        start = [label(result), result["dims"]]
        rows = list(enumerate(result["layers"], 1))
        for name, row in rows if len(rows) == 1 else [*rows, ("mean", result)]:
            digits = 1 if name == "mean" else 0
            cells = [f"{row['used']:.{digits}f}", f"{row['dead']:.{digits}f}", f"{row['perplexity']:.1f}"]
            lines.append("| " + " | ".join([*start, str(name), str(result["codebook_size"]), *cells]) + " |")
    places = sorted({f"{r['corpus']['name']} ({r['corpus']['hash']}), split {r['corpus']['split']}" for r in results})
    runs = [f"- {label(r)}, {r['dims']}: `{r['run']}`, {r['codes']} positions" for r in results]
    notes = "Perplexity: about how many codes are used evenly; dead: codes never chosen. Corpus: " + "; ".join(places)
    return "\n".join(["# Code usage (MARDM, Figure 2)", "", *lines, "", f"{notes}.", "", *runs, ""])


def draw(results: list[dict[str, Any]], path: Path) -> Path:
    """Draw each run's shares of use, the most used code first, on a logarithmic axis: redundant left, essential right.

    Raises ImportError without matplotlib.
    """
    rows: dict[str, dict[str, list[dict[str, Any]]]] = {}
    for result in results:
        rows.setdefault(label(result), {kind: [] for kind in ORDER})[result["dims"]].append(result)
    figure = new_figure(9, 1 + 2.6 * len(rows), dpi=120)
    panels = figure.subplots(len(rows), len(ORDER), sharex="row", sharey="row", squeeze=False)
    for line, (name, found) in zip(panels, rows.items(), strict=True):
        for panel, kind in zip(line, ORDER, strict=True):
            panel.set_title(f"{name}, {kind}", fontsize=10)
            for result in found[kind]:
                _histogram(panel, result)
            if not found[kind]:
                panel.text(0.5, 0.5, "no run", transform=panel.transAxes, ha="center", color="grey")
        line[0].set_ylabel("share of use")
    for panel in panels[-1]:
        panel.set_xlabel("codes, the most used first")
    figure.tight_layout()
    with replacing(path) as temporary:
        figure.savefig(temporary)
    return path


def label(result: dict[str, Any]) -> str:
    """Name a tokenizer, whatever dims it reads."""
    return f"{result[TOKENIZER]} ({result['scale']}, seed {result['seed']})"


def _histogram(panel: Axes, result: dict[str, Any]) -> None:
    size, layers = result["codebook_size"], result["layers"]
    for i, layer in enumerate(layers, 1):
        counts = np.array(layer["histogram"])
        share = counts[counts > 0] / counts.sum()
        text = f"layer {i}: " if len(layers) > 1 else ""
        text += f"{layer['used']} of {size}, perplexity {layer['perplexity']:.0f}"
        panel.step(np.arange(1, len(share) + 1), share, where="mid", linewidth=1, label=text)
    panel.axhline(1 / size, color="grey", linewidth=0.8, linestyle="--")  # an even use
    panel.set_yscale("log")
    panel.legend(fontsize=7)


def _read(run: Path) -> tuple[MotionTokenizer, DictConfig]:
    """Read a run's tokenizer and config."""
    folder = RunFolder(run)
    if not (run / "config.yaml").is_file() or not folder.done:
        state = folder.status["state"]
        raise FileNotFoundError(
            f"{run} is no finished run of a tokenizer (its state is {state!r}); give folders of runs/tokenizer"
        )
    tokenizer = read_model(run, TOKENIZER)
    if tokenizer.space.kind != "codes":
        raise ValueError(f"{run} holds {type(tokenizer).__name__}, which has no codes; give a tokenizer of codes")
    return tokenizer, read_config(run, CONFIG)
