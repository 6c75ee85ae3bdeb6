from setuptools import find_packages, setup

package_name = "np_record"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={package_name: ["data/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"], "lerobot": ["pyarrow"]},
    zip_safe=False,
    maintainer="maintainers",
    maintainer_email="maintainers@example.org",
    description="Recordings: the topics, CDR and MCAP, bags, recorder, replay, the pages that reports are made of, LeRobot data sets.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "export_lerobot = np_record.commands.export_lerobot:main",
            "recorder = np_record.nodes.recorder_node:main",
            "replay = np_record.commands.replay:main",
            "report = np_record.commands.report:main",
        ],
    },
)
