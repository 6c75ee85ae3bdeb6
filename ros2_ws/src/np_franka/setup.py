from setuptools import find_packages, setup

package_name = "np_franka"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="maintainers",
    maintainer_email="maintainers@example.org",
    description="The hardware backend: a Franka arm and hand over the Franka Control Interface.",
    license="Apache-2.0",
    entry_points={
        # executable = node name = 'np_franka.nodes.<name>_node:main'
        "console_scripts": [
            "franka_driver = np_franka.nodes.franka_driver_node:main",
            "realsense_camera = np_franka.nodes.realsense_camera_node:main",
        ],
    },
)
