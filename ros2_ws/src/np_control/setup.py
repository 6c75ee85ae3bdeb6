from setuptools import find_packages, setup

package_name = "np_control"

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
    description="Impedance law, kinematics, trajectories and safety guards as a library; the 500 Hz controller node.",
    license="Apache-2.0",
    entry_points={
        # executable = node name = 'np_control.nodes.<name>_node:main'
        "console_scripts": [
            "joint_impedance = np_control.nodes.joint_impedance_node:main",
            "ros2_control = np_control.nodes.ros2_control_node:main",
        ],
    },
)
