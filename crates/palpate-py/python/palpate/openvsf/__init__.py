"""Fields, data sets and configurations of OpenVSF (`openvsf`, imported as `vsf`).

Files are read and written without OpenVSF and torch; only `to_point_vsf` imports them. A
configuration in YAML needs PyYAML: `pip install 'palpate[openvsf]'`.
"""

from ._configuration import Configuration, read_config
from ._dataset import open_dataset
from ._fields import from_point_vsf, load, save, to_point_vsf

__all__ = [
    "Configuration",
    "from_point_vsf",
    "load",
    "open_dataset",
    "read_config",
    "save",
    "to_point_vsf",
]
