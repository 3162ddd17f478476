"""The golden files in the repository stay small, and what isn't among them is named when a test skips."""

from __future__ import annotations

import tarfile
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "golden"
ARCHIVES = sorted(FOLDER.glob("*.tar.xz"))


def test_the_folder_stays_below_twenty_megabytes():
    assert ARCHIVES
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) <= 20e6


@pytest.mark.parametrize("archive", ARCHIVES, ids=lambda path: path.name)
def test_archives_hold_files_of_their_family_and_no_clips(archive):
    with tarfile.open(archive) as members:
        paths = [Path(name) for name in members.getnames()]
    assert {str(path.parent) for path in paths} == {archive.name.removesuffix(".tar.xz")}
    assert {path.suffix for path in paths} <= {".safetensors", ".json", ".md"}


def test_a_file_that_is_nowhere_skips_and_names_both_folders(golden_file):
    with pytest.raises(
        pytest.skip.Exception, match=r"vq/none is neither in .*tests.golden nor in .*golden; set KINEMA"
    ):
        golden_file("vq/none")
