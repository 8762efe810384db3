"""How colcon builds omm_camera_driver."""

from setuptools import find_packages, setup

package_name = "omm_camera_driver"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(exclude=["test"]),
    data_files=[
        ("share/ament_index/resource_index/packages", ["resource/" + package_name]),
        ("share/" + package_name, ["package.xml"]),
        ("share/" + package_name + "/udev", ["udev/70-omm-usb3-vision.rules"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=True,
    maintainer="omm maintainers",
    maintainer_email="maintainers@omm.invalid",
    description="Camera node of omm: GigE Vision, USB3 Vision, V4L2 or simulated.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "camera_node = omm_camera_driver.node:main",
            "gige_simulator_node = omm_camera_driver.drivers.gige.simulator_node:main",
        ],
    },
)
