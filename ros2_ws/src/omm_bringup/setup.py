"""How colcon builds omm_bringup."""

from glob import glob

from setuptools import find_packages, setup

package_name = "omm_bringup"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package_name]),
        ("share/" + package_name, ["package.xml"]),
        ("share/" + package_name + "/launch", sorted(glob("launch/*.py"))),
        ("share/" + package_name + "/config", sorted(glob("config/*.yaml"))),
        ("share/" + package_name + "/systemd", sorted(glob("systemd/*.service"))),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="omm maintainers",
    maintainer_email="maintainers@omm.invalid",
    description="Starts omm: launch files, configuration, the command line.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "omm = omm_bringup.command_line:main",
        ],
    },
)
