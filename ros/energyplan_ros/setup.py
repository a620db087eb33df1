"""Builds the package energyplan_ros with ament_python."""

from setuptools import setup

NAME = "energyplan_ros"

setup(
    name=NAME,
    version="0.2.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml", "README.md"]),
        (
            f"share/{NAME}/config",
            ["config/planner.yaml", "config/identifier.yaml", "config/controller.yaml"],
        ),
        (f"share/{NAME}/launch", ["launch/planner.launch.py"]),
    ],
    install_requires=["setuptools"],
    zip_safe=True,
    maintainer="The energyplan developers",
    maintainer_email="energyplan@example.org",
    description="Serves Nav2's planning actions with energyplan's plans",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            f"planner = {NAME}.planner:main",
            f"identifier = {NAME}.identifier:main",
        ]
    },
)
