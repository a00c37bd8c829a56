"""For catkin_python_setup(): not to be run by hand."""

from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(
    **generate_distutils_setup(
        packages=["rodeo_ros1"], package_dir={"": "src"}, package_data={"rodeo_ros1": ["interfaces.json"]}
    )
)
