"""What pyproject.toml cannot say: ``configs/`` travels in the wheel.

It lies at the top of the repository and is installed as ``marouting/configs``, where
:func:`marouting.config.config_file` finds it.
"""

from setuptools import find_namespace_packages, find_packages, setup

CONFIGS = "marouting.configs"

setup(
    packages=[
        *find_packages(include=["marouting*", "policies*"]),
        CONFIGS,
        *(f"{CONFIGS}.{folder}" for folder in find_namespace_packages("configs")),
    ],
    package_dir={CONFIGS: "configs"},
)
