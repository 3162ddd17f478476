"""Examine a corpus before results rest on it: what is missing, wrong, double, or in the wrong split.

`diagnose(path)` takes a packed store, a corpus folder or one file of joints; every finding comes with its fix.
"""

from kinema.data.doctor.examination import diagnose
from kinema.data.doctor.finding import Finding, exit_code, format

__all__ = ["Finding", "diagnose", "exit_code", "format"]
