"""What pyproject.toml cannot say: all packages under dressi_edge/, and device_profiles/ installed as one more of them."""
from setuptools import find_namespace_packages, setup

found = find_namespace_packages(include=["dressi_edge", "dressi_edge.*"], exclude=["*.__pycache__"])
setup(packages=[*found, "dressi_edge.device_profiles"], package_dir={"dressi_edge.device_profiles": "device_profiles"})
