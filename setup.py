from catkin_pkg.python_setup import generate_distutils_setup
from setuptools import setup

setup(
    **generate_distutils_setup(
        packages=['field_phenotyping_tools'],
        package_dir={'': 'python'},
    )
)
