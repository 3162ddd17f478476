"""Pack a finished run into one folder that works anywhere: weights, card, and what the model knows."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from dataclasses import replace as replaced
from pathlib import Path
from typing import Any

from omegaconf import DictConfig, OmegaConf

from kinema.data.store import PackedStore
from kinema.experiments.config import CONF, compose, plain, read_config
from kinema.experiments.corpus import corpus_label, open_corpus
from kinema.experiments.listing import EVALUATION, Listed, at, flatten
from kinema.experiments.repertoires import repertoire_of
from kinema.experiments.stages import companions_of, get_stage, needs_of
from kinema.pipeline import TextToMotion
from kinema.pipeline.card import UNKNOWN, Card
from kinema.runs.console import console
from kinema.runs.folder import RunFolder
from kinema.runs.latest import find_run
from kinema.runs.parts import GENERATOR, TOKENIZER
from kinema.runs.versions import versions

SCORES = {"r1": "R@1", "r3": "R@3", "fid": "FID", "clip_score": "CLIP-score", "foot_skating": "foot skating"}
GIVEN = ("representation", "text", "data")
"""What of a configuration all stages share."""
OWN = "custom"
"""The option of data for a corpus that has none of its own; its folder stands for where somebody else has it."""
OWN_FOLDER = "data.source=FOLDER"
NOT_SAID = ("data.source", "data.workers", "data.paper", "text.path")


def pack(run: str | Path, out: str | Path, *, half: bool, licence: str | None, replace: bool = False) -> TextToMotion:
    """Write a generator's run with its parts, card and repertoire as one folder; gives the model.

    The corpus is opened, and prepared where it isn't yet: its licences and captions are read. What configuration files
    of this checkout don't compose (a scale or method of somebody's own) has no command in the card, which is said.
    Raises ValueError or FileNotFoundError for a run that is not finished or was imported, or a folder that exists.
    """
    folder, out = find_run(run), Path(out)
    if out.exists() and not replace:
        raise ValueError(f"{out} exists; choose another folder, or --replace")
    model = TextToMotion.from_run(folder, "cpu")
    if not (folder / "config.yaml").is_file():
        raise ValueError(f"{folder} has no config.yaml: only runs that were trained here can say what they are")
    cfg = read_config(folder)
    train = _command(["kinema", "train", f"stage={GENERATOR}"], cfg, "train", _nodes())
    store = PackedStore.open(_corpus_of(cfg))
    again = ["kinema", "pack", f"runs/{GENERATOR}/{folder.name}", "--out", out.name, *(["--half"] if half else [])]
    sources = _sources(store)
    licence = licence or strictest([one["licence"] for one in sources])
    about: dict[str, Any] = {
        "half": half,
        "licence": licence,
        "sources": sources,
        "commands": [train, shlex.join(again)] if train else [],
    }
    model.card = replaced(_card(cfg, model, store, folder), name=out.name, **about)
    model.repertoire = repertoire_of(store, model.text_encoder)
    model.save(out, half=half, replace=replace)
    return model


def _card(cfg: DictConfig, model: TextToMotion, store: PackedStore, folder: Path) -> Card:
    """Say what a run and its corpus are."""
    body, parts = model.skeleton, {GENERATOR: model.generator, TOKENIZER: model.tokenizer, **model.parts}
    mirrored = " with mirrored clips" if store.manifest["options"].get("mirror") else ""
    return Card(
        name=folder.name,
        method=cfg.method.label,
        citation=cfg.method.citation,
        corpus=f"{corpus_label(cfg)} ({store.manifest['hours']:.1f} hours{mirrored}, content {store.hash})",
        motion=f"{body.num_joints} joints ({body.name}), up to {model.max_frames} frames, {body.fps:g} a second, Y up",
        text_encoder=model.text_encoder.identity,
        parameters={name: sum(p.numel() for p in part.parameters()) for name, part in parts.items()},
        figures=figures(folder),
        settings=_settings(cfg, _nodes()),
        versions=RunFolder(folder).status.get("versions") or versions(),
    )


def _words(cfg: DictConfig) -> list[str]:
    name = cfg.data.name
    data = [f"data={name}"] if _is_option(name) else [f"data={OWN}", f"data.name={name}"]
    data += [OWN_FOLDER] if data[0] == f"data={OWN}" else []
    return [f"method={cfg.method.name}", *data, f"scale={cfg.scale.name}", f"seed={cfg.seed}"]


def _is_option(corpus: str) -> bool:
    return (CONF / "data" / f"{corpus}.yaml").is_file()


def _command(start: list[str], cfg: DictConfig, job: str, nodes: tuple[str, ...]) -> str:
    """Return the command line that composes a configuration again; empty where none does, which is printed."""
    try:
        return shlex.join([*start, *_words(cfg), *changes(cfg, _words(cfg), job, nodes)])
    except ValueError as error:
        console.print(f"[yellow]note[/]      the card will not say how to {job} this again: {error}")
        return ""


def _corpus_of(cfg: DictConfig) -> Path:
    """Open a run's corpus in the folder that the run read, or, where that is gone, in this machine's."""
    usual = compose([f"data={cfg.data.name}" if _is_option(cfg.data.name) else f"data={OWN}"])
    own = OmegaConf.select(cfg, "data.source", throw_on_missing=False)
    there = own is not None and Path(own).is_dir()
    source = own if there or OmegaConf.is_missing(usual.data, "source") else usual.data.source
    here = cfg.copy()
    here.paths, here.data.source = usual.paths, source
    return open_corpus(here)


def _nodes() -> tuple[str, ...]:
    """Name what of a configuration a generator rests on: its own part, and those of the stages that stand by it."""
    stage = get_stage(GENERATOR)
    others = [*needs_of(stage), *companions_of(stage)]
    return (*GIVEN, *dict.fromkeys(one.node for one in (stage, *others)))


def changes(cfg: DictConfig, words: list[str], job: str, nodes: tuple[str, ...]) -> list[str]:
    """Return the overrides that, behind `words`, compose what a configuration holds under some of its nodes.

    Raises ValueError naming what they can't: a run of an earlier configuration.
    """
    options = [f"{node}={name}" for node in nodes if (name := _option(cfg, node)) is not None]
    given = [one for one in options if _differs(cfg, words, job, one.split("=")[0])]
    usual, mine = _settings(compose([*words, *given], job), nodes), _settings(cfg, nodes)
    given += [f"{key}={_written(value)}" for key, value in mine.items() if usual.get(key) != value]
    again = _settings(compose([*words, *given], job), nodes)
    if unlike := sorted(key for key in {*again, *mine} if again.get(key) != mine.get(key)):
        raise ValueError(f"no overrides of {' '.join(words)} give the run's {', '.join(unlike[:5])}; train it again")
    return given


def figures(folder: Path) -> list[dict[str, Any]]:
    """Return the scores of a generator's run on each split, with its own sampling: of several, the last."""
    found: dict[str, dict[str, Any]] = {}
    files = (folder.parents[1] / EVALUATION).glob("generation-*/replications.jsonl")
    for file in sorted(files, key=lambda one: one.stat().st_mtime_ns):
        one = Listed(RunFolder(file.parent))
        rests = one.provenance if one.damage is None else {}
        own = plain(read_config(folder)).get(GENERATOR, {}).get("sampling")
        same = at(rests, f"runs.{GENERATOR}") == folder.name and at(rests, "sampling") == own
        if same and one.usual:
            found[rests["protocol"]["split"]] = _figure(one)
    return list(found.values())


def strictest(licences: list[str]) -> str:
    """Return the licence that binds most of those of the sources: the one non-commercial, else the only one."""
    kinds = set(licences)
    bound = {one for one in kinds if "NC" in one.upper().replace("-", " ").split()} or kinds
    return bound.pop() if len(bound) == 1 else UNKNOWN


def _figure(one: Listed) -> dict[str, Any]:
    cfg, split = read_config(one.folder.path), one.provenance["protocol"]["split"]
    nodes = (*_nodes(), "evaluator", "scale.protocol", "replications")
    scores = {label: value.text(3) for name, label in SCORES.items() if (value := one.scores().get(name)) is not None}
    scores["replications"] = str(len(one.lines))
    return {
        "split": split,
        "scores": scores,
        "command": _command(["kinema", "evaluate", "source=generation"], cfg, "evaluate", nodes),
    }


def _sources(store: PackedStore) -> list[dict[str, Any]]:
    if "licence" not in store.fields:
        return []
    clips = [clip for clip in store.split_clips("train") if not store.clips[clip]["mirrored"]]
    source = "source" if "source" in store.fields else "licence"
    counts = Counter((store.clip_field(clip, source), store.clip_field(clip, "licence")) for clip in clips)
    return [{"source": of, "licence": licence, "clips": n} for (of, licence), n in counts.most_common()]


def _option(cfg: DictConfig, node: str) -> str | None:
    """Name the file of a group of the configuration that a node was composed from."""
    value = at(plain(cfg), node)
    name = (value.get("name") or value.get("kind")) if isinstance(value, dict) else None
    return name if name is not None and (CONF / node / f"{name}.yaml").is_file() else None


def _differs(cfg: DictConfig, words: list[str], job: str, node: str) -> bool:
    return _option(compose(words, job), node) != _option(cfg, node)


def _settings(cfg: DictConfig, nodes: tuple[str, ...]) -> dict[str, Any]:
    found = {key: value for node in nodes for key, value in flatten(at(plain(cfg), node), node).items()}
    return {key: value for key, value in found.items() if value != {} and key not in NOT_SAID}


def _written(value: Any) -> str:
    """Write a value as Hydra reads it."""
    return value if isinstance(value, str) else json.dumps(value, separators=(",", ":"))
