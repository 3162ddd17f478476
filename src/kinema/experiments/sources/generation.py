"""Score what a method makes: whole motions, edits of the test clips, or motion whose joints are held in space."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import DictConfig, OmegaConf

from kinema.data.store import PackedStore
from kinema.experiments.config import plain, read_config
from kinema.experiments.identity import fingerprint
from kinema.experiments.sampling import build_sampling, sampling_spec
from kinema.experiments.sources.base import ScoredSource
from kinema.experiments.stages.base import asked_for
from kinema.experiments.stages.generator import GeneratorStage
from kinema.motion.skeleton import get_skeleton
from kinema.registry import find_class
from kinema.runs.folder import RunFolder

if TYPE_CHECKING:
    from kinema.evaluation.source import Source
    from kinema.experiments.evaluation import Row
    from kinema.experiments.scoring import Scorer

TASKS = {"editing": "edit", "control": "control"}
"""The group of each task but that of generating whole motions."""


class GenerationSource(ScoredSource):
    """Ask a generator, for the task that `task=` names."""

    name = "generation"
    scores = GeneratorStage.name
    groups = tuple(TASKS.values())

    def check_options(self, cfg: DictConfig) -> None:
        """Lengths and kept motion are of whole motions alone."""
        if cfg.task != "generation" and cfg.keep_motions:
            raise ValueError(f"keep_motions=true with task={cfg.task}; only task=generation keeps motion: leave it out")
        if cfg.task != "generation" and cfg.lengths != cfg.method.lengths:
            raise ValueError(f"lengths={cfg.lengths} with task={cfg.task}, whose motion is as long as the test clip")

    def check_run(self, cfg: DictConfig) -> None:
        """Check that the configuration's method is that of the run: its sampling is the method's."""
        run = GeneratorStage().given(cfg)
        if run is None or not RunFolder(run).weights.is_file():
            return  # its absence is told where it is read
        from kinema.runs.weights import read_meta  # here: --help must not pay for torch

        spec = read_meta(RunFolder(run).weights)["spec"]
        theirs, ours = (find_class(found.get("_target_")) for found in (spec, plain(cfg.generator.model)))
        if theirs is not ours:
            saved = run / "config.yaml"
            method = OmegaConf.select(read_config(run), "method.name") if saved.is_file() else None
            fix = f"add method={method}" if method else f"add the method= whose generator is {theirs.__name__}"
            raise ValueError(
                f"run={run} is of {theirs.__name__}, the configuration of method={cfg.method.name} ({ours.__name__}); "
                f"{fix}"
            )

    def check(self, cfg: DictConfig, store: PackedStore) -> None:
        """Check how it is sampled, and that the joints which are held are there and in space."""
        if cfg.task == "control":
            _check_control(cfg)
        build_sampling(cfg)

    def read_groups(self, cfg: DictConfig) -> tuple[str, ...]:
        """Name the task's."""
        return (TASKS[cfg.task],) if cfg.task in TASKS else ()

    def sampling(self, cfg: DictConfig) -> dict[str, Any]:
        """Return the method's, or that of what completes it."""
        return sampling_spec(cfg)

    def lengths(self, cfg: DictConfig) -> str:
        """Return what is asked for; edits are as long as the clip."""
        return cfg.lengths if cfg.task == "generation" else "real"

    def reads_text(self, cfg: DictConfig) -> bool:
        """A run that is given has its own text encoder."""
        return asked_for(cfg) is None

    def check_text(self, row: Row) -> None:
        """Open the one that stands beside the given run."""
        from kinema.pipeline.folder import open_text_encoder  # here too

        (run,) = row.subject.values()
        if RunFolder(run).weights.is_file():  # its absence is told where it is read
            open_text_encoder(run)

    def label(self, cfg: DictConfig) -> str:
        """Name the task with what it is about."""
        if cfg.task == "editing":
            return f"edit_{cfg.edit.task}"
        return f"control_{'_'.join(cfg.control.joints)}" if cfg.task == "control" else self.name

    def notes(self, cfg: DictConfig) -> tuple[str, ...]:
        """Say where lengths come from unless they are the test clips', and that fewer steps than trained are taken."""
        return (*_lengths_notes(cfg), *_steps_notes(cfg))

    def open(self, scorer: Scorer, row: Row) -> Source:
        """Put the method together, of the parts that the row is named by, whatever the generator's run links to."""
        from kinema.evaluation.controlled import Controlled
        from kinema.evaluation.sources import Edited, Generated
        from kinema.experiments.instantiate import cached, encode_captions
        from kinema.pipeline import TextToMotion

        cfg, (run,) = scorer.cfg, row.subject.values()
        model = TextToMotion.from_run(run, device=scorer.device, **row.beside)
        sampling, size = build_sampling(cfg), cfg.batch_size
        model.generator.check_sampling(sampling)
        model = model.bfloat16() if cfg.precision == "bfloat16" else model
        # The run's own text encoder, which need not be the configuration's (an imported run).
        model.text_encoder = encode_captions(cached(cfg, model.text_encoder), scorer.store, scorer.protocol.split)
        if cfg.task == "editing":
            return Edited(model, task=cfg.edit.task, paste=cfg.edit.paste, sampling=sampling, batch_size=size)
        if cfg.task == "control":
            return Controlled(model, **plain(cfg.control), sampling=sampling, batch_size=size)
        generated = Generated(model, lengths=cfg.lengths, sampling=sampling, batch_size=size)
        return _remembered(cfg, generated) if cfg.keep_motions else generated


def _remembered(cfg: DictConfig, source: Any) -> Source:
    """Keep motions below the cache, by all that they depend on but what is asked."""
    from kinema.evaluation.remembered import Remembered
    from kinema.pipeline.identity import fingerprint as model_fingerprint

    how = [model_fingerprint(source.model), sampling_spec(cfg), cfg.lengths, cfg.precision]
    return Remembered(source, Path(cfg.paths.cache) / "motions" / fingerprint(how))


def _check_control(cfg: DictConfig) -> None:
    """Check that the skeleton has the joints, and that the method can be told where they are."""
    from kinema.experiments.groups import Control  # here: --help must not pay for torch
    from kinema.tokenizers import MotionTokenizer

    Control(**plain(cfg.control)).check_joints(get_skeleton(cfg.data.skeleton))
    kind = find_class(cfg.tokenizer.model._target_)
    if asked_for(cfg) is None and not (issubclass(kind, MotionTokenizer) and kind.holds_joints):
        raise ValueError(
            f"task=control holds joints in space, and the frames of method={cfg.method.name} (tokenizer="
            f"{cfg.tokenizer.name}) hold none; choose a method in XYZ, such as method=msflow"
        )


def _lengths_notes(cfg: DictConfig) -> tuple[str, ...]:
    if cfg.task != "generation":
        return ()
    if cfg.lengths == "real":
        return ("lengths of the test clips",)
    return ("lengths predicted by " + ("the method" if cfg.generator.get("predicts_length") else "an estimator"),)


def _steps_notes(cfg: DictConfig) -> tuple[str, ...]:
    trained = OmegaConf.select(cfg, "generator.model.process.steps")
    taken = OmegaConf.select(cfg, "generator.sampling.solver_steps")
    if trained is None or taken in (None, trained):
        return ()
    chosen = taken if isinstance(taken, int) else f"the steps {taken!r}"
    return (f"sampled in {chosen} of its {trained} diffusion steps",)
