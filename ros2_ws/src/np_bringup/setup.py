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
    description="Launch files, the demo, evaluation and bench.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "bench = np_bringup.commands.bench:main",
            "calibration_trial = np_bringup.commands.calibration_trial:main",
            "check_backend = np_bringup.commands.check_backend:main",
            "demo = np_bringup.commands.demo:main",
            "echo = np_bringup.nodes.echo_node:main",
            "evaluate = np_bringup.commands.evaluate:main",
            "fuzz = np_bringup.commands.fuzz:main",
            "goal = np_bringup.nodes.goal_node:main",
            "joint_names = np_bringup.nodes.joint_names_node:main",
            "robot_state = np_bringup.nodes.robot_state_node:main",
            "rehearse = np_bringup.commands.rehearse:main",
            "round_trip = np_bringup.nodes.round_trip_node:main",
            "table3 = np_bringup.commands.table3:main",
            "soak = np_bringup.commands.soak:main",
            "view = np_bringup.commands.view:main",
        ],
    },
)
