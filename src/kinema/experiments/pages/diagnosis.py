"""Carry out the diagnosis of the MARDM paper, section 2: statistics of the corpus first, then what trained runs add."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kinema.data.store import PackedStore
from kinema.experiments.config import compose
from kinema.experiments.corpus import open_corpus, require_captions
from kinema.experiments.instantiate import machine_of
from kinema.experiments.pages import errors, statistics
from kinema.experiments.pages.sections import write_page
from kinema.experiments.pages.subjects import finished, load, load_tokenizer, make, read_motions, want
from kinema.experiments.request import Request
from kinema.experiments.stages.generator import GeneratorStage
from kinema.experiments.stages.tokenizer import TokenizerStage
from kinema.runs.console import console
from kinema.runs.versions import versions


def carry_out(page: dict[str, Any], request: Request) -> list[Path]:
    """Make the missing runs, measure, and write the page; `render_only` measures the runs that are there."""
    overrides = request.shared
    cfg = compose(overrides)
    machine_of(cfg).limit_threads()
    store, split = PackedStore.open(open_corpus(cfg)), page["split"]
    require_captions(store, split)
    if not request.render_only:
        make({TokenizerStage.name: page["tokenizers"], GeneratorStage.name: page["generators"]}, request)
    real = read_motions(store, split, page["motions"])
    generators = finished(want(page["generators"], GeneratorStage.name, overrides))
    tokenizers = finished(want(page["tokenizers"], TokenizerStage.name, overrides))
    subjects = [load(one, real, store, split) for one in generators]
    console.print(f"measure   {len(subjects)} generators, {len(tokenizers)} tokenizers, {len(real.lengths)} motions")
    sections = [statistics.distributions(page, store, subjects), statistics.deviations(store)]
    if subjects:
        made = [subject.generate() for subject in subjects]
        sections += [
            errors.amplification(page, subjects),
            errors.denoising(page, subjects),
            errors.directions(page, subjects),
            errors.samples(store, subjects, made),
            errors.jitter(store, subjects, made),
        ]
    if tokenizers:
        labelled = [(one.label, load_tokenizer(one)) for one in tokenizers]
        sections.append(errors.reconstruction(labelled, real))
    provenance = {
        "command": request.command,
        "corpus": {"name": store.name, "hash": store.hash, "split": split, "motions": len(real.lengths)},
        "runs": {one.label: one.run.path.name for one in (*generators, *tokenizers)},
        "sampling": {subject.label: subject.sampling for subject in subjects},
        "versions": versions(),
    }
    return write_page(page, sections, provenance, request.folder(cfg))
