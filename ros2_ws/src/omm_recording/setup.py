"""How colcon builds omm_recording."""

from setuptools import find_packages, setup

package_name = "omm_recording"

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
    description="The file of a run: written, read, sealed, verified, repaired (MCAP). Knows nothing of ROS.",
    license="Apache-2.0",
)
