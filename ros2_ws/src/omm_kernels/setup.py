"""How colcon builds omm_kernels."""

import os
import subprocess
import sys
from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.develop import develop
from setuptools.command.install import install

package_name = "omm_kernels"


def compile_kernels() -> None:
    """Run after the installation; the packages that hold kernels are dependencies, so they are there."""
    path = [str(Path(__file__).resolve().parent), os.environ.get("PYTHONPATH", "")]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, path))}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # the cache lies beside the bytecode
    # What cannot be compiled ahead is compiled at the first start: the build goes on.
    subprocess.run([sys.executable, "-m", "omm_kernels.compiling"], env=environment, check=False)


class Install(install):
    """Install, then compile the kernels."""

    def run(self) -> None:
        """Run the step."""
        super().run()
        compile_kernels()


class Develop(develop):
    """Link the sources (colcon --symlink-install), then compile the kernels."""

    def run(self) -> None:
        """Run the step."""
        super().run()
        compile_kernels()


setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package_name]),
        ("share/" + package_name, ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="omm maintainers",
    maintainer_email="maintainers@omm.invalid",
    description="Compiles omm's numerical kernels when the workspace is built.",
    license="Apache-2.0",
    cmdclass={"install": Install, "develop": Develop},
)
