"""Hold the stages, one file each, and find them: a module put into this package is a stage without another edit."""

from __future__ import annotations

from functools import cache
from graphlib import TopologicalSorter

from kinema.experiments.discovery import discover
from kinema.experiments.stages.base import Stage
from kinema.experiments.stages.judge import JudgeStage


def stages() -> dict[str, Stage]:
    """Return all stages by name, each after those that it reads or has beside it."""
    return dict(_find(tuple(__path__)))


def get_stage(name: str) -> Stage:
    """Find a stage; raises ValueError naming those there are."""
    if name not in stages():
        raise ValueError(f"stage={name!r} is unknown; allowed: {', '.join(stages())}")
    return stages()[name]


def judges() -> dict[str, JudgeStage]:
    """Return the stages whose runs judge every row, by what `evaluators` in the configuration calls them."""
    return {stage.given_as: stage for stage in stages().values() if isinstance(stage, JudgeStage)}


def needs_of(stage: Stage) -> list[Stage]:
    """Return the stages whose runs change a stage's own."""
    return [other for other in stages().values() if other.name in stage.needs or stage.name in other.needed_by]


def companions_of(stage: Stage) -> list[Stage]:
    """Return the stages whose runs a user of a stage's run wants beside it."""
    return [other for other in stages().values() if stage.name in other.companion_of]


def completions_of(stage: Stage) -> list[Stage]:
    """Return the stages that read a stage's run and stand beside it then."""
    return [other for other in stages().values() if stage.name in other.completes]


@cache
def _find(folders: tuple[str, ...]) -> list[tuple[str, Stage]]:
    found = discover(__name__, folders, Stage, "stage")
    order = TopologicalSorter({name: found[name].needs for name in sorted(found)})
    for stage in found.values():
        for reader in (*stage.needed_by, *stage.companion_of):
            order.add(reader, stage.name)
    names = list(order.static_order())
    unknown = [name for name in names if name not in found]
    if unknown:
        raise ValueError(f"a stage names {unknown[0]!r}, which is none; stages: {', '.join(found)}")
    return [(name, found[name]) for name in names]
