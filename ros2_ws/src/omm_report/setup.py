"""How colcon builds omm_report."""

from setuptools import find_packages, setup

package_name = "omm_report"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    package_data={package_name: ["languages/*.json"]},
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package_name]),
        ("share/" + package_name, ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="omm maintainers",
    maintainer_email="maintainers@omm.invalid",
    description="Results as people read them: text, pictures, documents. Knows nothing of ROS.",
    license="Apache-2.0",
)
