"""How colcon builds omm_core."""

from setuptools import find_packages, setup

package_name = "omm_core"

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
    description="Geometry, target detection, estimation and uncertainty of omm. Knows nothing of ROS.",
    license="Apache-2.0",
)
