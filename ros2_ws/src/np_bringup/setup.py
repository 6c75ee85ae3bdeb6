from glob import glob

from setuptools import find_packages, setup

package_name = "np_bringup"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={package_name: ["data/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/launch", glob("launch/*.launch.py")),
        (f"share/{package_name}/config", glob("config/*")),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="maintainers",
    maintainer_email="maintainers@example.org",
    description="Launch file, configuration, and the nodes that give a goal and show the robot.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "goal = np_bringup.nodes.goal_node:main",
            "joint_names = np_bringup.nodes.joint_names_node:main",
            "robot_state = np_bringup.nodes.robot_state_node:main",
            "status = np_bringup.commands.status:main",
            "view = np_bringup.commands.view:main",
        ],
    },
)
