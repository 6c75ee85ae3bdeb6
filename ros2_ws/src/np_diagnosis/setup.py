from setuptools import find_packages, setup

package_name = "np_diagnosis"

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
    description="The ROS side of the sim-to-real diagnosis: the excitation node and the commands.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "diagnose = sim2real.cli.diagnose:main",
            "diagnose_task = sim2real.cli.diagnose_task:main",
            "excite = np_diagnosis.commands.excite:main",
        ],
    },
)
