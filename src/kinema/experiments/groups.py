"""Say what the groups of the configuration may hold that describe no model: corpus, machine, dashboards, protocol."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Interval, Len
from omegaconf import DictConfig, OmegaConf

from kinema.data.prepare import LIMITS, READERS, check_reader, prepare_store
from kinema.data.synthetic.corpus import Clips
from kinema.evaluation.settings import EvaluationProtocol
from kinema.experiments.config import (
    DENSITIES,
    EDITS,
    LENGTHS,
    ORACLES,
    PERTURBATIONS,
    SPACES,
    TASKS,
    plain,
)
from kinema.experiments.dashboards import MODES
from kinema.experiments.stages import judges, stages
from kinema.motion.representation import VARIANTS
from kinema.motion.skeleton import DIMS, SKELETONS, Skeleton
from kinema.nn.precision import PRECISIONS
from kinema.options import Count, NonNegative, Number, OneOf, Options, Positive, Seed, Size, Threads, check, make
from kinema.text import tokens, words
from kinema.text.encoders import ENCODERS
from kinema.training.dashboards import NAMES
from kinema.training.machine import Machine


@dataclass(frozen=True)
class Data(Options):
    """Choose the corpus; `options` are its reader's and those of `prepare_store`."""

    name: str
    reader: Annotated[str, OneOf(READERS)]
    source: str | None
    skeleton: Annotated[str, OneOf(SKELETONS)]
    fps: Positive | None
    mirror: bool
    options: dict[str, Any]
    workers: Annotated[int, Interval(ge=0, le=1024)]
    paper: str | None


@dataclass(frozen=True)
class Columns(Options):
    """Choose the columns of motion."""

    kind: Annotated[str, OneOf(DIMS)]
    variant: Annotated[str, OneOf(VARIANTS)]
    width: Size


@dataclass(frozen=True)
class Text(Options):
    """Choose the text encoder."""

    name: Annotated[str, OneOf(ENCODERS)]
    path: str | None
    dim: Size


@dataclass(frozen=True)
class Watching(Options):
    """Choose what is looked at while a model trains."""

    samples_every: Number
    sample_prompts: Number
    sample_films: Number
    score_every: Number
    score_clips: Count | None


@dataclass(frozen=True)
class Logger(Options):
    """Choose the dashboards."""

    names: list[Annotated[str, OneOf(NAMES)]]
    project: str
    mode: Annotated[str, OneOf(MODES)]
    group: str | None
    artifacts: bool


@dataclass(frozen=True)
class Debug(Options):
    """Cut runs short."""

    enabled: bool
    steps: Count | None


@dataclass(frozen=True)
class Paths(Options):
    """Name the folders."""

    runs: str
    stores: str
    cache: str


@dataclass(frozen=True)
class Scale(Options):
    """Choose what goes with a budget."""

    name: str
    clips: Clips
    samples_every: Number
    sample_films: Number
    threads: Threads | None
    protocol: dict[str, Any]


@dataclass(frozen=True)
class Method(Options):
    """Name the method."""

    name: str
    label: str
    citation: str
    lengths: Annotated[str, OneOf(LENGTHS)]
    family: str | None = None


@dataclass(frozen=True)
class Edit(Options):
    """Choose what an editing evaluation regenerates."""

    task: Annotated[str, OneOf(EDITS)]
    paste: bool


@dataclass(frozen=True)
class Control(Options):
    """Choose which joints a control evaluation holds in their places, and in how many frames."""

    joints: Annotated[list[str], Len(1)]
    density: Annotated[str, OneOf(DENSITIES)]

    def check_joints(self, skeleton: Skeleton) -> None:
        """Raise ValueError for a joint that the skeleton hasn't got."""
        if unknown := [name for name in self.joints if name not in skeleton.joint_names]:
            raise ValueError(
                f"control.joints: {unknown[0]!r} is no joint of {skeleton.name}; it has "
                f"{', '.join(skeleton.joint_names)}"
            )


@dataclass(frozen=True)
class Perturb(Options):
    """Choose what `source=perturbed` does to real motion."""

    dims: Annotated[str, OneOf(DIMS)]
    how: Annotated[str, OneOf(PERTURBATIONS)]
    level: NonNegative
    space: Annotated[str, OneOf(SPACES)]


@dataclass(frozen=True)
class Oracle(Options):
    """Choose what `source=oracle` knows of a prompt's motion."""

    knows: Annotated[str, OneOf(ORACLES)]


@dataclass(frozen=True)
class Judges(Options):
    """Name the runs of imported evaluators."""

    t2m: str | None
    clip: str | None


GROUPS: dict[str, type[Options]] = {
    "scale": Scale,
    "scale.protocol": EvaluationProtocol,
    "method": Method,
    "data": Data,
    "representation": Columns,
    "text": Text,
    "trainer": Machine,
    "callbacks": Watching,
    "logger": Logger,
    "debug": Debug,
    "paths": Paths,
    "edit": Edit,
    "control": Control,
    "perturb": Perturb,
    "oracle": Oracle,
    "evaluators": Judges,
}
"""What others take values from stands first, so that errors name where a value was written."""


@dataclass(frozen=True)
class Evaluator(Options):
    """Choose the evaluators' representation, seed and vocabularies."""

    name: str
    representation: Annotated[str, OneOf(DIMS)]
    variant: Annotated[str, OneOf(VARIANTS)]
    seed: Seed
    split: str | None
    words: Annotated[str, OneOf(words.KINDS)]
    words_path: str | None
    tokens: Annotated[str, OneOf(tokens.KINDS)]
    tokens_path: str | None
    unread: list[Annotated[str, OneOf([judge.name for judge in judges().values() if judge.optional])]]


@dataclass(frozen=True)
class Part(Options):
    """Say of a model what other parts of the configuration ask."""

    name: str | None = None
    variant: str | None = None
    reads_tokens: bool = False
    predicts_length: bool = False
    max_frames: Size = 196


@dataclass(frozen=True)
class Request(Options):
    """Choose what is trained or scored: the keys that stand in no group."""

    seed: Seed
    ensure: bool
    tokenizer_run: str | None
    source: str = "generation"
    task: Annotated[str, OneOf(TASKS)] = "generation"
    lengths: Annotated[str, OneOf(LENGTHS)] = "real"
    lift: bool = False
    lock_feet: bool = False
    batch_size: Count = 32
    keep_motions: bool = False
    precision: Annotated[str, OneOf(PRECISIONS)] = "float32"
    replications: Annotated[list[Number], Len(1)] | None = None
    objective: str | None = None
    run: str | None = None


def check_groups(cfg: DictConfig) -> None:
    """Raise ValueError naming a key of the configuration whose value isn't allowed, or that nothing reads.

    Models, recipes and sampling are checked where they are made (`Stage.check`).
    """
    for key, kind in GROUPS.items():
        node = OmegaConf.select(cfg, key)
        if node is not None or key.partition(".")[0] in cfg:
            make(kind, _mapping(node, key), key)
    check(Request, {str(key): value for key, value in plain(cfg).items() if key != "hydra"}, "")
    check(Evaluator, _mapping(cfg.evaluator, "evaluator"), "evaluator")
    for stage in stages().values():
        if stage.present(cfg):
            check(Part, _mapping(stage.config(cfg), stage.node), stage.node)
    check_reader(cfg.data.reader, plain(cfg.data.options), "data.options", *LIMITS)
    check(prepare_store, plain(cfg.data.options), "data.options")


def _mapping(node: Any, key: str) -> dict[str, Any]:
    if not OmegaConf.is_dict(node):
        raise ValueError(f"{key}={node}: must be a mapping; choose one of the group's files")
    return plain(node)
