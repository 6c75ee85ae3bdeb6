from setuptools import find_packages, setup

package_name = "np_physx_bridge"

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
    description="The PhysX backend: the robot of np_sim_bridge in a second engine.",
    license="Apache-2.0",
    entry_points={
        # executable = node name = 'np_physx_bridge.nodes.<name>_node:main'
        "console_scripts": ["physx_bridge = np_physx_bridge.nodes.physx_bridge_node:main"],
    },
)
