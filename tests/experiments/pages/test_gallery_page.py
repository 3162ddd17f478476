"""Galleries: every method answers the same sentences, and the page plays what it was given."""

from __future__ import annotations

import json

import pytest

from kinema.experiments import pages
from kinema.experiments.pages import load_page
from kinema.experiments.reproduce import reproduce
from kinema.report.index import write_site

pytestmark = pytest.mark.usefixtures("unchecked")


def test_every_method_answers_every_sentence(micro, tmp_path, monkeypatch):
    small = load_page("figure4")
    small["methods"] = [spec for spec in small["methods"] if spec["key"] in ("mardm_ddpm", "mardm_sit")]
    small["prompts"] = [*small["prompts"][:2], {"text": "</script><b>a person</b> waits", "seconds": 60}]
    monkeypatch.setattr(pages, "load_page", lambda name: small)
    out = tmp_path / "reports" / "figure4"
    reproduce("figure4", micro, jobs=1, out=out)
    told = json.loads((out / "page.json").read_text())
    assert [source["label"] for source in told["motions"]["sources"]] == ["MARDM-DDPM", "MARDM-SiT"]
    for source in told["motions"]["sources"]:
        assert [motion["text"] for motion in source["motions"]] == [prompt["text"] for prompt in small["prompts"]]
        frames = [motion["frames"] for motion in source["motions"]]
        assert frames[:2] == [120, 80]
        assert 180 < frames[2] <= 200  # the longest there is
        assert (out / source["pack"]).is_file()
    page = (out / "index.html").read_text()
    assert "kinema-gallery" in page
    assert "<b>a person" not in page
    write_site(tmp_path / "reports")
    assert f"figure4/{told['motions']['sources'][0]['pack']}" in (tmp_path / "reports/gallery.html").read_text()
