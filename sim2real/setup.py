from setuptools import find_packages, setup

package_name = "sim2real"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(),
    package_data={package_name: ["data/*", "effects/data/*"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest"]},
    zip_safe=False,
    maintainer="maintainers",
    maintainer_email="maintainers@example.org",
    description="Sim-to-real diagnosis: which unmodelled effects an arm, a camera or a contact has, how large they are, and a patch for the simulator.",
    license="Apache-2.0",
)
