from setuptools import find_packages, setup

package_name = "np_planning"

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
    description="Collision model, RRT* and time parametrization of the way to the contact.",
    license="Apache-2.0",
)
