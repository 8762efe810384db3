"""How colcon builds omm_ros."""

from setuptools import find_packages, setup

package_name = "omm_ros"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package_name]),
        ("share/" + package_name, ["package.xml"]),
        ("share/" + package_name + "/config", ["config/fastdds.xml", "config/fastdds_network.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="omm maintainers",
    maintainer_email="maintainers@omm.invalid",
    description="What every omm node shares: parameters, conversions, quality of service, transport, main.",
    license="Apache-2.0",
)
