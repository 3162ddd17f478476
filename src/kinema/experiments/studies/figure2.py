"""Draw how the tokenizers of MARDM Table 1 use their codes: the runs are found, or made, by what they are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kinema.devices import find_device
from kinema.experiments.figures.code_usage import measure, write_report
from kinema.experiments.stages.tokenizer import TokenizerStage
from kinema.experiments.studies.subjects import finished, make, want


def carry_out(
    study: dict[str, Any],
    overrides: list[str],
    *,
    render_only: bool = False,
    jobs: int | None = None,
    out: Path | None = None,
) -> list[Path]:
    """Train the tokenizers that are missing, count their codes on the test split, and write the report."""
    shared, stage = [o for o in overrides if not o.startswith("launcher=")], TokenizerStage.name
    if not render_only:
        make({stage: study["tokenizers"]}, shared, jobs)
    wanted = want(study["tokenizers"], stage, shared)
    found = [measure(one.run.path, "test", find_device(one.cfg.trainer.accelerator)) for one in finished(wanted)]
    cfg = wanted[0].cfg
    return write_report(found, out or Path("reports") / f"{study['name']}-{cfg.data.name}-{cfg.scale.name}")
