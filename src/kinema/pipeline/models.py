"""Find models by what they are called: a folder, `latest:METHOD`, a model of this package, a repository of the hub."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from kinema.pipeline.card import CARD, PAGE, Card
from kinema.pipeline.repertoire import REPERTOIRE
from kinema.runs.folder import RunFolder
from kinema.runs.latest import LATEST, find_run
from kinema.runs.parts import TEXT, UPSTREAM
from kinema.text.files import is_hub_id, require

SHIPPED = Path(__file__).resolve().parents[1] / "models"
DEFAULT = "latent-flow-open-mocap"
"""The model that is taken where none is named."""
WEIGHTS = RunFolder(Path()).weights.name
FILES = (CARD, PAGE, REPERTOIRE, UPSTREAM, TEXT, "status.json", WEIGHTS, f"*/{WEIGHTS}")
"""What is downloaded of a repository: the files of a packed model."""


@dataclass(frozen=True)
class Found:
    """Hold a packed model that is on this machine: what `--run` takes, and its folder."""

    name: str
    folder: Path

    @property
    def card(self) -> Card:
        """Read its card."""
        card = Card.read(self.folder)
        if card is None:
            raise FileNotFoundError(f"{self.folder} is no packed model: it has no {CARD}; `kinema pack RUN` makes one")
        return card

    @property
    def size(self) -> int:
        """Count its bytes."""
        return sum(file.stat().st_size for file in self.folder.rglob("*") if file.is_file())


def find_model(name: str | Path, revision: str | None = None) -> Path:
    """Return the folder of a model.

    A folder that exists comes first, then the models of this package, then `OWNER/NAME` on the Hugging Face hub, of
    which the files of a packed model are downloaded (`revision`: its branch, tag or commit) and kept in the hub's own
    cache; without network, what that holds is taken. Raises FileNotFoundError for a model that is nowhere.
    """
    if str(name).startswith(LATEST):
        return find_run(name)
    path = Path(name)
    if path.exists():
        return path
    for model in shipped():
        if model.name == str(name):
            return model.folder
    if str(name) == DEFAULT:
        raise FileNotFoundError(f"this installation came without the model {DEFAULT}; give --run, a run or a model")
    # `runs/one` beside a folder `runs` is a path that was mistyped: nobody's repository is asked for.
    return _download(str(name), revision) if is_hub_id(str(name)) and not path.parent.is_dir() else path


def shipped() -> list[Found]:
    """Return the models of this package."""
    return [Found(file.parent.name, file.parent) for file in sorted(SHIPPED.glob(f"*/{CARD}"))]


def cached() -> list[Found]:
    """Return the packed models in the cache of the Hugging Face hub, each revision; none without its package."""
    try:
        hub = require("huggingface_hub", "the hub's cache")
    except ImportError:
        return []
    try:
        repositories = hub.scan_cache_dir().repos
    except hub.errors.CacheNotFound:
        return []
    models = sorted((one for one in repositories if one.repo_type == "model"), key=lambda one: one.repo_id)
    return [
        Found(one.repo_id, Path(revision.snapshot_path))
        for one in models
        for revision in sorted(one.revisions, key=lambda found: found.last_modified)
        if (Path(revision.snapshot_path) / CARD).is_file()
    ]


def upload(folder: Path, repository: str, *, private: bool, revision: str | None) -> str:
    """Upload a packed model's files to a repository of the hub, made if it isn't there; gives the commit's address."""
    hub = require("huggingface_hub", "a model on the Hugging Face hub")
    hub.create_repo(repository, private=private, exist_ok=True)
    message = f"{Found(repository, folder).card.name}, packed by kinema"
    commit = hub.upload_folder(
        repo_id=repository, folder_path=folder, revision=revision, allow_patterns=list(FILES), commit_message=message
    )
    return str(commit.commit_url)


def _download(repository: str, revision: str | None) -> Path:
    hub = require("huggingface_hub", "a model from the Hugging Face hub")
    try:
        folder = Path(hub.snapshot_download(repository, revision=revision, allow_patterns=list(FILES)))
    except (OSError, ValueError) as error:  # no such repository or revision, no network and not cached
        told = str(error).strip().splitlines() or [type(error).__name__]
        raise FileNotFoundError(
            f"{repository} is no folder, no model of this package, and the Hugging Face hub did not give it: {told[0]}"
        ) from None
    if not (folder / CARD).is_file():
        raise ValueError(f"{repository} on the Hugging Face hub is no model that `kinema pack` made: it has no {CARD}")
    return folder
