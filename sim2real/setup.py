"""The package of the workspace, and the distribution for pip, which brings what it imports of the other packages along."""

import sys

from setuptools import find_packages, setup

PACKAGE = "sim2real"
SOURCES = "../ros2_ws/src"
BROUGHT_ALONG = (
    "np_common",
    "np_control",
    "np_control.safety",
    "np_description",
    "np_description.contact",
    "np_description.objects",
    "np_description.weights",
    "np_perception",
    "np_record",
)
"""Packages of the workspace that sim2real imports; none of their modules that it uses imports rclpy or torch."""

REQUIREMENTS = [
    "numpy",
    "scipy",
    "mujoco>=4",
    "pin",
    "PyYAML",
    "rosbags",
    "opencv-python-headless",
    "jsonschema",
    "matplotlib",
    "Jinja2",
    "tqdm",
]
DESCRIPTION = (
    "Sim-to-real diagnosis: which unmodelled effects an arm, a camera or a contact has, how large they are, "
    "and a patch for the simulator."
)

packages = find_packages()
package_dir = {}
requirements = ["setuptools"]
scripts = []
# colcon builds the other packages itself, with the commands `develop` and `build`; pip builds a wheel.
if {"egg_info", "dist_info", "bdist_wheel", "editable_wheel"} & set(sys.argv) and "build" not in sys.argv:
    packages += BROUGHT_ALONG
    package_dir = {name: f"{SOURCES}/{name.split('.')[0]}/{name.replace('.', '/')}" for name in BROUGHT_ALONG}
    requirements = REQUIREMENTS
    scripts = ["sim2real-diagnose = sim2real.cli.diagnose:main"]

setup(
    name=PACKAGE,
    version="0.1.0",
    packages=packages,
    package_dir=package_dir,
    package_data={PACKAGE: ["data/*", "effects/data/*"], "np_description": ["data/*.yaml"], "np_record": ["data/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{PACKAGE}"]),
        (f"share/{PACKAGE}", ["package.xml"]),
    ],
    install_requires=requirements,
    extras_require={"test": ["pytest"]},
    entry_points={"console_scripts": scripts},
    zip_safe=False,
    maintainer="maintainers",
    maintainer_email="maintainers@example.org",
    description=DESCRIPTION,
    license="Apache-2.0",
)
