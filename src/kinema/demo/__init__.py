"""Try a model in the browser: `serve` opens a page that generates, edits and exports (gradio; a Space runs it too)."""

from kinema.demo.server import serve

__all__ = ["serve"]
