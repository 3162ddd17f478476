"""Show the same sentences answered by many methods, in players that run on one clock."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kinema.experiments.config import plain
from kinema.experiments.instantiate import machine_of
from kinema.experiments.pages.sections import write_page
from kinema.experiments.pages.subjects import Wanted, finished, make, want
from kinema.experiments.request import Request
from kinema.experiments.stages.generator import GeneratorStage
from kinema.pipeline import TextToMotion
from kinema.runs.console import console
from kinema.runs.versions import versions
from kinema.types import Motion


def carry_out(page: dict[str, Any], request: Request) -> list[Path]:
    """Train the generators that are missing, ask each, and write the page; `render_only` asks those that are there."""
    stage = GeneratorStage.name
    if not request.render_only:
        make({stage: page["methods"]}, request)
    wanted = want(page["methods"], stage, request.shared)
    asked = finished(wanted)
    motions = {one.label: answers(one, page["prompts"]) for one in asked}
    facts = {
        "command": request.command,
        "runs": {one.label: one.run.path.name for one in asked},
        "sampling": {one.label: plain(one.cfg.generator.sampling) for one in asked},
        "seed": wanted[0].cfg.seed,
        "versions": versions(),
    }
    where = f"{wanted[0].cfg.data.name}, {wanted[0].cfg.scale.name}"
    return write_page(page, [], facts, request.folder(wanted[0].cfg), motions, where)


def answers(one: Wanted, prompts: list[dict[str, Any]]) -> list[Motion]:
    """Generate a motion for each prompt, of its length; a method that makes no motion as long makes its longest."""
    model = TextToMotion.from_run(one.run.path, device=machine_of(one.cfg).device())
    longest = model.max_frames / model.skeleton.fps
    seconds = [min(prompt["seconds"], longest) for prompt in prompts]
    console.print(f"asked     {one.label}")
    return model.generate([prompt["text"] for prompt in prompts], seconds=seconds, seed=one.cfg.seed)
