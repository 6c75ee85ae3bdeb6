from setuptools import find_packages, setup

package_name = "np_sim_bridge"

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
    description="The MuJoCo backend: stands where the drivers of the robot and of the camera stand.",
    license="Apache-2.0",
    entry_points={
        # executable = node name = 'np_sim_bridge.nodes.<name>_node:main'
        "console_scripts": [
            "keypoint_oracle = np_sim_bridge.nodes.keypoint_oracle_node:main",
            "sim_bridge = np_sim_bridge.nodes.sim_bridge_node:main",
        ],
    },
)
