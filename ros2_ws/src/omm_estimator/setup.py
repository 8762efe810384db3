"""How colcon builds omm_estimator."""

from setuptools import find_packages, setup

package_name = "omm_estimator"

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
    description="Estimator node of omm: images and spindle poses in, pose of the part out.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "estimator_node = omm_estimator.node:main",
            "stored_result_node = omm_estimator.stored_result_node:main",
        ],
    },
)
