from setuptools import find_packages, setup

package_name = "np_perception"

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
    description="From images to the keypoints and the pose of the object; cameras played back, rectified and calibrated.",
    license="Apache-2.0",
    entry_points={
        # executable = node name = 'np_perception.nodes.<name>_node:main'
        "console_scripts": [
            "calibrate = np_perception.commands.calibrate:main",
            "calibration_board = np_perception.commands.calibration_board:main",
            "camera_player = np_perception.nodes.camera_player_node:main",
            "keypoint_detector = np_perception.nodes.keypoint_detector_node:main",
            "object_sheet = np_perception.commands.object_sheet:main",
        ],
    },
)
