"""Turn files into one packed, memory-mapped corpus and serve it: windows, captioned clips and the test protocol.

`kinema.data.datamodule` is the one module here that imports Lightning; it is not imported by this package.
"""

from kinema.data.captions import AnnotatedCaption, parse_captions, parse_line, swap_sides
from kinema.data.catalog import SPLITS, Catalog, Clip, Dropped, read_joints_folder, read_official
from kinema.data.store import PackedStore

__all__ = [
    "SPLITS",
    "AnnotatedCaption",
    "Catalog",
    "Clip",
    "Dropped",
    "PackedStore",
    "parse_captions",
    "parse_line",
    "read_joints_folder",
    "read_official",
    "swap_sides",
]
