"""Packages of the wheel: the rooms of the house, and the experiments of configs/ among the agents.

All else is in pyproject.toml.
"""

from setuptools import find_packages, setup

setup(
    packages=[*find_packages(include=["dynamics*", "flexarm_env*", "agents*"]), "agents.configs"],
    package_dir={"agents.configs": "configs"},
)
