from setuptools import find_packages, setup

package_name = "np_evaluation"

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
    description="Demo, evaluation, finetuning, bench, endurance tests and the conformance suite of a backend.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "bench = np_evaluation.commands.bench:main",
            "check_backend = np_evaluation.commands.check_backend:main",
            "demo = np_evaluation.commands.demo:main",
            "evaluate = np_evaluation.commands.evaluate:main",
            "finetune = np_evaluation.commands.finetune:main",
            "table3 = np_evaluation.commands.table3:main",
        ],
    },
)
