"""How colcon builds omm_operator."""

from setuptools import find_packages, setup

package_name = "omm_operator"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["page/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package_name]),
        ("share/" + package_name, ["package.xml"]),
        (
            "share/" + package_name + "/layouts",
            ["layouts/omm.rviz", "layouts/omm.foxglove.json"],
        ),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="omm maintainers",
    maintainer_email="maintainers@omm.invalid",
    description="The operator's view of a measurement: progress, result, correction.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "measure_node = omm_operator.measuring:main",
            "operator_node = omm_operator.node:main",
            "overlay_node = omm_operator.overlay_node:main",
            "scene_node = omm_operator.scene_node:main",
        ],
    },
)
