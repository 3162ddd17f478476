"""Generate a corpus of moving, described people: for the first command of the README, and for tests.

Bodies of varied proportions move by forward kinematics; legs reach the footholds by inverse kinematics, so that feet
stand. Results on it say that the machinery works, never how good a method is.
"""

from kinema.data.synthetic.corpus import VERSION, synthetic_catalog, synthetic_clips, synthetic_joints
from kinema.data.synthetic.folders import write_joints_folder, write_official_folder
from kinema.data.synthetic.plan import ACTIONS

__all__ = [
    "ACTIONS",
    "VERSION",
    "synthetic_catalog",
    "synthetic_clips",
    "synthetic_joints",
    "write_joints_folder",
    "write_official_folder",
]
