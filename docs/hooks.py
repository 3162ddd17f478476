"""Add to the site what docs/ doesn't hold: pages of the repository's root, and the reference, a page for each room."""

from __future__ import annotations

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "src" / "kinema"
OF_ROOT = {
    "README.md": "index.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "LICENSE": "license.md",
}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Put the pages of a folder where the navigation says FOLDER/*; a folder without pages drops out."""
    nav = [{title: _pages(what) for title, what in entry.items()} for entry in config.nav]
    config.nav = [entry for entry in nav if all(entry.values())]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Generate the pages; links of the root lead to where its files are on the site."""
    for name, page in OF_ROOT.items():
        text = (ROOT / name).read_text(encoding="utf-8").replace("](docs/", "](")
        for other, target in OF_ROOT.items():
            text = text.replace(f"]({other}", f"]({target}")
        content = text if name.endswith(".md") else f"# Licence\n\n```text\n{text}```\n"
        files.append(File.generated(config, page, content=content))
    for room in _rooms():
        content = f"---\ntitle: kinema.{room}\n---\n\n::: kinema.{room}\n"
        files.append(File.generated(config, f"reference/{room}.md", content=content))
    return files


def _pages(what: str | list) -> str | list:
    if not isinstance(what, str) or not what.endswith("/*"):
        return what
    folder = what.removesuffix("/*")
    names = _rooms() if folder == "reference" else sorted(p.stem for p in (ROOT / "docs" / folder).glob("*.md"))
    return [f"{folder}/{name}.md" for name in sorted(names, key=lambda name: name != "README")]


def _rooms() -> list[str]:
    modules = (p for p in PACKAGE.iterdir() if p.suffix == ".py" or (p / "__init__.py").exists())
    return sorted(p.stem for p in modules if not p.stem.startswith("_"))
