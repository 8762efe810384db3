"""How colcon builds omm_simulation."""

from glob import glob

from setuptools import find_packages, setup

package_name = "omm_simulation"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package_name]),
        ("share/" + package_name, ["package.xml"]),
        *(
            ("share/" + package_name + "/" + folder.rstrip("/"), glob(folder + "*.yaml"))
            for folder in sorted(glob("scenarios/*/"))
        ),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="omm maintainers",
    maintainer_email="maintainers@omm.invalid",
    description="The simulated cell: a machine that moves, a camera that renders. Knows nothing of ROS.",
    license="Apache-2.0",
)
