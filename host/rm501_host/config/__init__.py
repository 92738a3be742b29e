"""The configuration: TOML files to checked, typed values."""

from rm501_host.config.loader import ConfigError, Problem, load_config
from rm501_host.config.schema import JOINT_NAMES, MOTOR_NAMES, Config, JointSection, MotorSection

__all__ = [
    "JOINT_NAMES",
    "MOTOR_NAMES",
    "Config",
    "ConfigError",
    "JointSection",
    "MotorSection",
    "Problem",
    "load_config",
]
