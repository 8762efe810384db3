"""How colcon builds omm_cnc_bridge."""

from glob import glob

from setuptools import find_packages, setup

package_name = "omm_cnc_bridge"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package_name]),
        ("share/" + package_name, ["package.xml"]),
        ("share/" + package_name + "/machines", glob("machines/*")),
        ("share/" + package_name + "/linuxcnc", glob("linuxcnc/*")),
        ("share/" + package_name + "/controls", glob("controls/*")),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="omm maintainers",
    maintainer_email="maintainers@omm.invalid",
    description="CNC bridge node of omm: LinuxCNC, OPC UA, MTConnect or simulated.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "cnc_bridge_node = omm_cnc_bridge.node:main",
        ],
    },
)
