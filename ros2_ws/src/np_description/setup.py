from setuptools import find_packages, setup

package_name = "np_description"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={"np_description": ["data/*.yaml"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="maintainers",
    maintainer_email="maintainers@example.org",
    description="The Panda, the objects, the three domains and the camera: MJCF and frozen dataclasses, no rclpy.",
    license="Apache-2.0",
)
