"""Draw how the tokenizers of MARDM Table 1 use their codes: the runs are found, or made, by what they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kinema.experiments.figures.code_usage import measure, write_report
from kinema.experiments.instantiate import machine_of
from kinema.experiments.pages.subjects import finished, make, want
from kinema.experiments.request import Request
from kinema.experiments.stages.tokenizer import TokenizerStage


def carry_out(page: dict[str, Any], request: Request) -> list[Path]:
    """Train the tokenizers that are missing, count their codes on the test split, and write the report."""
    shared, stage = request.shared, TokenizerStage.name
    if not request.render_only:
        make({stage: page["tokenizers"]}, request)
    wanted = want(page["tokenizers"], stage, shared)
    found = [measure(one.run.path, "test", machine_of(one.cfg).device()) for one in finished(wanted)]
    return write_report(found, request.folder(wanted[0].cfg))
