"""Energy-aware path planning for wheeled skid-steer robots.

The public names stand in ``__init__.pyi``. Each is imported when first used, so that ``import
energyplan`` costs nothing.
"""

from __future__ import annotations

import lazy_loader

__version__ = "0.2.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
