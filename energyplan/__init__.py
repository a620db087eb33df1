"""Energy-aware path planning for wheeled skid-steer robots.

The public names stand in ``__init__.pyi``. Each is imported when first used, so that ``import
energyplan`` costs nothing.
"""

from __future__ import annotations

import sys
from types import ModuleType

import lazy_loader

__version__ = "0.1.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


class _Package(ModuleType):
    """The package's own module type.

    Three functions share their module's name (`identify`, `diagnose`, `compare`). Importing such a
    module binds its name here and would hide the function; this binds the function instead.
    """

    def __setattr__(self, name: str, value: object) -> None:
        if isinstance(value, ModuleType) and name in ("identify", "diagnose", "compare"):
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
