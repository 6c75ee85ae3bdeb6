from setuptools import find_packages, setup

package_name = "np_diagnosis"

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
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="maintainers",
    maintainer_email="maintainers@example.org",
    description="The gap doctor: where the arm departs from the nominal simulator, why, and how far it can be closed.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "baselines = np_diagnosis.commands.baselines:main",
            "chain = np_diagnosis.commands.chain:main",
            "clock = np_diagnosis.commands.clock:main",
            "diagnose = np_diagnosis.commands.diagnose:main",
            "excite = np_diagnosis.commands.excite:main",
            "feel = np_diagnosis.commands.feel:main",
            "pushes = np_diagnosis.commands.pushes:main",
            "scatter = np_diagnosis.commands.scatter:main",
            "view = np_diagnosis.commands.view:main",
        ],
    },
)
