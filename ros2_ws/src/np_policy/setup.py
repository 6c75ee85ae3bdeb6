from setuptools import find_packages, setup

package_name = "np_policy"

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
    description="Pre- and post-contact policies, the approach planner and the episode logic, with their nodes.",
    license="Apache-2.0",
    entry_points={
        # executable = node name = 'np_policy.nodes.<name>_node:main'
        "console_scripts": [
            "check_policy = np_policy.commands.check_policy:main",
            "export_policy = np_policy.commands.export_policy:main",
            "approach = np_policy.nodes.approach_node:main",
            "episode = np_policy.nodes.episode_node:main",
            "post_contact = np_policy.nodes.post_contact_node:main",
            "pre_contact = np_policy.nodes.pre_contact_node:main",
        ],
    },
)
