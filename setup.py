"""Put conf/ into the package when a wheel is built; everything else is in pyproject.toml."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithConf(build_py):
    """Copy conf/ to kinema/conf; an editable install reads it where it is."""

    def run(self) -> None:
        """Build the modules, then lay the configurations beside them."""
        super().run()
        if not self.editable_mode:
            inside = Path(self.build_lib) / "kinema" / "conf"
            shutil.rmtree(inside, ignore_errors=True)
            shutil.copytree("conf", inside)


setup(cmdclass={"build_py": BuildWithConf})
