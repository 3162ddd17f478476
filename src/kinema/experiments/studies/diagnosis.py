"""Carry out the diagnosis of the MARDM paper, section 2: statistics of the corpus first, then what trained runs add."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

from kinema.data.store import PackedStore
from kinema.experiments.config import compose, plain
from kinema.experiments.corpus import open_corpus, require_captions
from kinema.experiments.stages.generator import GeneratorStage
from kinema.experiments.stages.tokenizer import TokenizerStage
from kinema.experiments.studies import errors, statistics
from kinema.experiments.studies.sections import write_page
from kinema.experiments.studies.subjects import finished, load, load_tokenizer, make, read_motions, want
from kinema.runs.console import console
from kinema.runs.versions import versions
from kinema.training.fit import Machine


def carry_out(
    study: dict[str, Any],
    overrides: list[str],
    *,
    render_only: bool = False,
    jobs: int | None = None,
    out: Path | None = None,
) -> list[Path]:
    """Make the missing runs, measure, and write the page; `render_only` measures the runs that are there."""
    overrides = _on_this_machine(overrides)
    cfg = compose(overrides)
    Machine(**plain(cfg.trainer)).limit_threads()
    store, split = PackedStore.open(open_corpus(cfg)), study["split"]
    require_captions(store, split)
    if not render_only:
        make({TokenizerStage.name: study["tokenizers"], GeneratorStage.name: study["generators"]}, overrides, jobs)
    real = read_motions(store, split, study["motions"])
    generators = finished(want(study["generators"], GeneratorStage.name, overrides))
    tokenizers = finished(want(study["tokenizers"], TokenizerStage.name, overrides))
    subjects = [load(one, real, store, split) for one in generators]
    console.print(f"measure   {len(subjects)} generators, {len(tokenizers)} tokenizers, {len(real.lengths)} motions")
    sections = [statistics.distributions(study, store, subjects), statistics.deviations(store)]
    if subjects:
        made = [subject.generate() for subject in subjects]
        sections += [
            errors.amplification(study, subjects),
            errors.denoising(study, subjects),
            errors.directions(study, subjects),
            errors.samples(store, subjects, made),
            errors.jitter(store, subjects, made),
        ]
    if tokenizers:
        labelled = [(one.label, load_tokenizer(one)) for one in tokenizers]
        sections.append(errors.reconstruction(labelled, real))
    provenance = {
        "command": shlex.join(["kinema", "reproduce", study["name"], *overrides]),
        "corpus": {"name": store.name, "hash": store.hash, "split": split, "motions": len(real.lengths)},
        "runs": {one.label: one.run.path.name for one in (*generators, *tokenizers)},
        "sampling": {subject.label: subject.sampling for subject in subjects},
        "versions": versions(),
    }
    out = out or Path("reports") / f"{study['name']}-{cfg.data.name}-{cfg.scale.name}"
    return write_page(study, sections, provenance, out)


def _on_this_machine(overrides: list[str]) -> list[str]:
    launchers = [o for o in overrides if o.startswith("launcher=")]
    if set(launchers) - {"launcher=none"}:
        raise ValueError(
            f"{launchers[-1]}: the diagnosis runs on this machine; train its runs with kinema train -m ..."
        )
    return [o for o in overrides if o not in launchers]
